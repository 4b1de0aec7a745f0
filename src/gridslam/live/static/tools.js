// What helps to look: a grid in metres, the place under the pointer, and a measuring line.

const APART = 60; // px between two lines of the grid, at least

// A round number of metres that is at least `px` long.
export function roundLength(px, scale) {
  const power = 10 ** Math.floor(Math.log10(px / scale));
  return power * [1, 2, 5, 10].find((step) => step * power * scale >= px);
}

export const inMetres = (metres) => (metres < 1 ? `${(100 * metres).toFixed(0)} cm` : `${metres.toFixed(2)} m`);

const tidy = (value, step) => value.toFixed(step < 1 ? 1 : 0).replace(/^-(0(\.0)?)$/, "$1");

// Draws lines of whole multiples of a round length, with their coordinates where the map is not turned.
export function drawGrid(context, camera, colours) {
  const step = roundLength(APART, camera.scale), { left, top, bottom } = camera.margin, { width, height } = camera;
  const corners = [[0, 0], [width, 0], [0, height], [width, height]].map(([u, v]) => camera.toWorld(u, v));
  const range = (k) => {
    const values = corners.map((corner) => corner[k]), first = Math.ceil(Math.min(...values) / step);
    return Array.from({ length: Math.max(Math.floor(Math.max(...values) / step) - first + 1, 0) }, (_, n) => (first + n) * step);
  };
  const [xs, ys] = [range(0), range(1)], far = 2 * Math.hypot(width, height) / camera.scale;
  Object.assign(context, { strokeStyle: colours.text, fillStyle: colours.text, lineWidth: 1, font: "11px system-ui, sans-serif" });
  const stroke = (values, ends) => {
    for (const value of values) {
      context.globalAlpha = value === 0 ? 0.5 : 0.2;
      context.beginPath();
      for (const end of ends(value)) context.lineTo(...camera.toScreen(...end));
      context.stroke();
    }
  };
  stroke(xs, (x) => [[x, camera.y - far], [x, camera.y + far]]);
  stroke(ys, (y) => [[camera.x - far, y], [camera.x + far, y]]);
  context.globalAlpha = 1;
  if (camera.angle) return;
  for (const x of xs) context.fillText(tidy(x, step), camera.toScreen(x, 0)[0] + 3, height - bottom - 28);
  for (const y of ys) {
    const v = camera.toScreen(0, y)[1] - 3;
    if (v > top && v < height - bottom - 50) context.fillText(tidy(y, step), left, v);
  }
}

// A line through points that are clicked, and how long it is.
export class Measure {
  constructor() {
    this.active = false;
    this.points = []; // [x, y], m
    this.pointer = null;
  }

  toggle(active = !this.active) {
    this.active = active;
    this.points = [];
    this.pointer = null;
  }

  add(x, y) { this.points.push([x, y]); }

  // The length of the last segment that is none of 0, and of all of them, m.
  lengths() {
    const points = this.pointer && this.points.length ? [...this.points, this.pointer] : this.points;
    const parts = points.slice(1).map(([x, y], k) => Math.hypot(x - points[k][0], y - points[k][1]));
    return [parts.findLast((part) => part > 0) ?? 0, parts.reduce((sum, part) => sum + part, 0)];
  }

  text() {
    if (!this.active) return "";
    if (!this.points.length) return "click where to measure from";
    const [last, all] = this.lengths();
    return all > last ? `${inMetres(last)}, ${inMetres(all)} in all` : inMetres(last);
  }

  draw(context, camera, colours) {
    if (!this.active || !this.points.length) return;
    const points = (this.pointer ? [...this.points, this.pointer] : this.points).map(([x, y]) => camera.toScreen(x, y));
    Object.assign(context, { strokeStyle: colours.selected, fillStyle: colours.selected, lineWidth: 2 });
    context.beginPath();
    for (const point of points) context.lineTo(...point);
    context.stroke();
    for (const [u, v] of points) {
      context.beginPath();
      context.arc(u, v, 3.5, 0, 7);
      context.fill();
    }
    this.label(context, points.at(-1), colours);
  }

  label(context, [u, v], colours) {
    const text = inMetres(this.lengths()[1]);
    context.font = "600 13px system-ui, sans-serif";
    Object.assign(context, { strokeStyle: colours.free, lineWidth: 4, fillStyle: colours.text });
    context.strokeText(text, u + 10, v - 8);
    context.fillText(text, u + 10, v - 8);
  }
}
