// The map: tiles of levels, kept as bitmaps of many tiles each.

const TILES = 8; // along a bitmap's side
const SMALL = 4; // times fewer pixels along a side has a bitmap for maps that are seen from afar
let changes = 0;
const STRAY = 0.05; // share of the fullest row below which an outer one is left out

function rgb(css) {
  const probe = new OffscreenCanvas(1, 1).getContext("2d");
  probe.fillStyle = css;
  probe.fillRect(0, 0, 1, 1);
  return [...probe.getImageData(0, 0, 1, 1).data.slice(0, 3)];
}

// Colours of the levels: 0 unknown, 1 to 7 free, 8 even odds, 9 to 15 occupied.
export function palette(unknown, free, occupied) {
  const [u, f, o] = [unknown, free, occupied].map(rgb);
  const mix = (a, b, share) => a.map((value, k) => Math.round(value + share * (b[k] - value)));
  return Array.from({ length: 16 }, (_, level) => {
    if (level === 0) return u;
    if (level <= 8) return mix(u, f, Math.min((9 - level) / 4, 1));
    return mix(f, o, Math.min((level - 8) / 6, 1));
  });
}

// The first and the last row (or column) of tiles, by how many cells are known in each: outer ones that hold few cells
// are beams through windows and doors, and do not count.
function trim(sums) {
  const keys = [...sums.keys()].sort((a, b) => a - b), most = Math.max(...sums.values());
  const isStray = (key) => sums.get(key) < STRAY * most;
  return [keys.find((key) => !isStray(key)), keys.findLast((key) => !isStray(key))];
}

export class TileMap {
  constructor() {
    this.side = 32;
    this.place(0.05, [0, 0]);
    this.clear();
  }

  clear() {
    this.tiles = new Map(); // "row,column" to the tile's levels, two in a byte
    this.sheets = new Map();
    this.known = new Map(); // "row,column" to the number of known cells, of tiles that have some
    this.version = ++changes; // another one where it looks otherwise
  }

  // Sets the side of a cell, m, and the corner of tile (0, 0).
  place(resolution, offset) {
    Object.assign(this, { resolution, offset, version: ++changes });
  }

  // Sets the colours of the levels, [red, green, blue] or with alpha.
  colour(colours) {
    this.unknown = colours[0].length === 3 && `rgb(${colours[0]})`;
    this.colours = new Uint32Array(colours.map(([r, g, b, alpha = 255]) => (alpha << 24) | (b << 16) | (g << 8) | r));
    this.sheets.clear();
    this.version = ++changes;
    for (const [key, tile] of this.tiles) this.paint(...key.split(",").map(Number), tile);
  }

  // Stores tiles: rows and columns, and half a byte for each cell.
  put(at, data) {
    const bytes = (this.side * this.side) / 2;
    for (let k = 0; 2 * k < at.length; k++) {
      const [row, column] = [at[2 * k], at[2 * k + 1]];
      const tile = data.slice(k * bytes, (k + 1) * bytes);
      this.tiles.set(`${row},${column}`, tile);
      this.paint(row, column, tile);
      let known = 0;
      for (const pair of tile) known += (pair & 15 ? 1 : 0) + (pair >> 4 ? 1 : 0);
      if (known) this.known.set(`${row},${column}`, known); else this.known.delete(`${row},${column}`);
    }
    this.box = undefined;
  }

  // The known tiles without strays: [row0, column0, row1, column1], or null.
  findBox() {
    if (this.box !== undefined) return this.box;
    const rows = new Map(), columns = new Map(), add = (sums, key, count) => sums.set(key, (sums.get(key) ?? 0) + count);
    for (const [key, count] of this.known) {
      const [row, column] = key.split(",").map(Number);
      add(rows, row, count);
      add(columns, column, count);
    }
    const [[r0, r1], [c0, c1]] = [trim(rows), trim(columns)];
    this.box = this.known.size ? [r0, c0, r1, c1] : null;
    return this.box;
  }

  paint(row, column, tile) {
    const side = this.side, image = new ImageData(side, side), pixels = new Uint32Array(image.data.buffer);
    for (let k = 0; k < tile.length; k++) {
      const cell = 2 * k, y = side - 1 - Math.floor(cell / side), x = cell % side;
      pixels[y * side + x] = this.colours[tile[k] & 15];
      pixels[y * side + x + 1] = this.colours[tile[k] >> 4];
    }
    const [sheetRow, sheetColumn] = [Math.floor(row / TILES), Math.floor(column / TILES)];
    const key = `${sheetRow},${sheetColumn}`;
    let sheet = this.sheets.get(key);
    if (!sheet) {
      const canvas = new OffscreenCanvas(TILES * side, TILES * side);
      sheet = { row: sheetRow, column: sheetColumn, context: canvas.getContext("2d") };
      if (this.unknown) { // missing tiles must not shine through where a sheet is scaled
        sheet.context.fillStyle = this.unknown;
        sheet.context.fillRect(0, 0, canvas.width, canvas.height);
      }
      this.sheets.set(key, sheet);
    }
    sheet.small = null;
    this.version = ++changes;
    sheet.context.putImageData(image, (column - TILES * sheetColumn) * side, (TILES - 1 - row + TILES * sheetRow) * side);
  }

  // The bitmap of a sheet for a number of pixels of the screen a cell: from afar a small one, drawn once.
  bitmap(sheet, pixels) {
    if (pixels * SMALL > 1) return sheet.context.canvas;
    if (!sheet.small) {
      const side = (TILES * this.side) / SMALL, context = new OffscreenCanvas(side, side).getContext("2d");
      context.imageSmoothingQuality = "high";
      context.drawImage(sheet.context.canvas, 0, 0, side, side);
      sheet.small = context.canvas;
    }
    return sheet.small;
  }

  // Draws all bitmaps in the frame of a map that is turned.
  drawTurned(context, camera) {
    const metres = TILES * this.side * this.resolution, [x0, y0] = this.offset, bleed = 0.5 / camera.scale; // hides seams
    context.save();
    context.imageSmoothingEnabled = true;
    context.translate(...camera.middle);
    context.rotate(-camera.angle);
    context.scale(camera.scale, camera.scale);
    for (const sheet of this.sheets.values()) {
      const [x, y] = [x0 + sheet.column * metres - camera.x, camera.y - y0 - (sheet.row + 1) * metres];
      context.drawImage(this.bitmap(sheet, camera.scale * this.resolution * devicePixelRatio), x, y, metres + bleed, metres + bleed);
    }
    context.restore();
  }

  // Edges lie on whole pixels, so that there are no seams between bitmaps.
  draw(context, camera) {
    if (camera.angle) return this.drawTurned(context, camera);
    const metres = TILES * this.side * this.resolution, ratio = devicePixelRatio, [x0, y0] = this.offset;
    const pixels = camera.scale * this.resolution * ratio; // a cell
    context.imageSmoothingEnabled = pixels < 2;
    context.imageSmoothingQuality = pixels * SMALL > 1 ? "high" : "low";
    for (const sheet of this.sheets.values()) {
      const [left, bottom] = camera.toScreen(x0 + sheet.column * metres, y0 + sheet.row * metres);
      const [right, top] = camera.toScreen(x0 + (sheet.column + 1) * metres, y0 + (sheet.row + 1) * metres);
      if (right < 0 || bottom < 0 || left > camera.width || top > camera.height) continue;
      const whole = (value) => Math.round(value * ratio) / ratio;
      const [x, y] = [whole(left), whole(top)];
      context.drawImage(this.bitmap(sheet, pixels), x, y, whole(right) - x, whole(bottom) - y);
    }
  }

  // The known part without strays, with what is in `other`, in metres: [x0, y0, x1, y1], or null.
  extent(other = null) {
    const box = this.findBox();
    if (!box) return null;
    const metres = this.side * this.resolution, [r0, c0, r1, c1] = box, [x, y] = this.offset;
    const own = [x + c0 * metres, y + r0 * metres, x + (c1 + 1) * metres, y + (r1 + 1) * metres];
    return other ? own.map((value, k) => (k < 2 ? Math.min(value, other[k]) : Math.max(value, other[k]))) : own;
  }
}
