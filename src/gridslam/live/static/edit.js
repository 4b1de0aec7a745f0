// Edits of the map: walls, areas, rooms and zones are drawn, selected, moved, undone, and saved beside the map.

const NEAR = 9, TRAVEL = 4; // px: of a corner or a line that is hit; of a drag
const SAVE_MS = 300;
const LAYERS = {
  walls: { key: "w", name: "wall", type: "LineString", colour: "occupied", width: 0.1 },
  erased: { key: "e", name: "erase", type: "Polygon", colour: "faint" },
  keep_out: { key: "k", name: "keep-out", type: "Polygon", colour: "bad" },
  no_go: { key: "o", name: "no-go", type: "LineString", colour: "bad", width: 0.1 },
  speed: { key: "v", name: "speed", type: "Polygon", colour: "particle" },
  rooms: { key: "r", name: "room", type: "Point", colour: "path", named: true },
};
const HINTS = {
  select: "Click to select, drag to move; Delete removes.",
  LineString: "Click from place to place; Enter ends the line.",
  Polygon: "Click corners and Enter, or drag a rectangle.",
  Point: "Enter a name, and click into the room.",
};

// A history of states that share what has not changed.
export class History {
  constructor(state) { Object.assign(this, { state, before: [], after: [] }); }

  put(state) {
    this.before.push(this.state);
    this.after = [];
    this.state = state;
  }

  // Goes back, or on again; false at the end.
  move(from, to) {
    if (!from.length) return false;
    to.push(this.state);
    this.state = from.pop();
    return true;
  }

  undo() { return this.move(this.before, this.after); }
  redo() { return this.move(this.after, this.before); }
}

// The places of a feature, of a polygon without the repeated one; and a feature with others.
const placesOf = ({ geometry: { type, coordinates } }) => ({ Point: [coordinates], LineString: coordinates, Polygon: coordinates[0]?.slice?.(0, -1) })[type];

function withPlaces(feature, places) {
  const { properties, geometry: { type } } = feature;
  const coordinates = { Point: places[0], LineString: places, Polygon: [[...places, places[0]]] }[type];
  return { ...feature, properties, geometry: { type, coordinates } };
}

export class Editor {
  constructor(camera, redraw) {
    Object.assign(this, { camera, redraw, tool: null, drawn: [], selected: -1, drag: null, head: {}, tag: "", history: new History([]) });
  }

  get features() { return this.history.state; }

  async start() {
    if (this.section) return;
    this.build();
    const answer = await fetch("edits.geojson");
    if (!answer.ok) return this.tell(await answer.text(), true);
    const { features, ...head } = await answer.json();
    Object.assign(this, { head, tag: answer.headers.get("etag") ?? "", history: new History(features) });
    this.choose("select");
    this.changed(false);
  }

  // Builds the tools before the other parts of the panel.
  build() {
    document.head.append(Object.assign(document.createElement("link"), { rel: "stylesheet", href: "edit.css" }));
    const make = (tag, more, ...parts) => {
      const part = Object.assign(document.createElement(tag), more);
      part.append(...parts);
      return part;
    };
    const tool = (id, name, key) => make("button", { id: `edit-${id}`, textContent: name, title: `${name} (${key})`, ariaPressed: "false", onclick: () => this.choose(id) });
    const field = (id, name, value, more) => make("label", { id: `edit-for-${id}` }, name, make("input", { id: `edit-${id}`, value, ...more }));
    const tools = Object.entries(LAYERS).map(([id, { name, key }]) => tool(id, name, key));
    this.section = make("section", { id: "edit" }, make("h2", { textContent: "Edit the map" }),
      make("div", { className: "tools" }, tool("select", "select", "s"), ...tools),
      field("width", "width, m", "0.1", { type: "number", min: 0.01, max: 10, step: 0.05 }),
      field("limit", "limit, %", "50", { type: "number", min: 1, max: 100 }),
      field("name", "name", "room", { maxLength: 100 }),
      make("div", { className: "steps" },
        make("button", { id: "edit-undo", textContent: "undo", title: "Ctrl Z", onclick: () => this.step("undo") }),
        make("button", { id: "edit-redo", textContent: "redo", title: "Ctrl Shift Z", onclick: () => this.step("redo") }),
        make("button", { id: "edit-delete", textContent: "delete", title: "Delete", onclick: () => this.remove() })),
      make("p", { id: "edit-status", role: "status" }));
    document.querySelector("#panel").prepend(this.section);
    addEventListener("keydown", (event) => this.pressed(event), true); // before the keys of the page
  }

  value(id) { return this.section.querySelector(`#edit-${id}`).value; }

  tell(text, bad = false) {
    const status = this.section.querySelector("#edit-status");
    status.textContent = text;
    status.classList.toggle("bad", bad);
    document.body.dataset.edits = text;
  }

  choose(tool) {
    const layer = LAYERS[tool];
    Object.assign(this, { tool, drawn: [], drag: null });
    if (layer) this.selected = -1;
    for (const button of this.section.querySelectorAll(".tools button")) button.setAttribute("aria-pressed", button.id === `edit-${tool}`);
    for (const [id, shown] of [["width", layer?.width], ["limit", tool === "speed"], ["name", layer?.named]]) this.section.querySelector(`#edit-for-${id}`).hidden = !shown;
    if (layer?.width) this.section.querySelector("#edit-width").value = layer.width;
    this.camera.takes = (kind, u, v) => this.take(kind, u, v);
    this.tell(HINTS[layer?.type ?? tool]);
    this.redraw();
  }

  pressed(event) {
    if (event.target.matches?.("input:not([type=range])") || document.querySelector("dialog[open]")) return;
    const key = event.key.toLowerCase(), command = event.ctrlKey || event.metaKey;
    const found = Object.keys(LAYERS).find((id) => LAYERS[id].key === key);
    const action = command
      ? { z: () => this.step(event.shiftKey ? "redo" : "undo"), y: () => this.step("redo") }[key]
      : found ? () => this.choose(found)
      : { s: () => this.choose("select"), enter: () => this.finish(), escape: () => this.cancel(), delete: () => this.remove(), backspace: () => this.remove() }[key];
    const idle = (key === "enter" && !this.drawn.length) || (key === "escape" && this.tool === "select" && this.selected < 0);
    if (!action || event.altKey || idle) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    action();
  }

  cancel() {
    if (this.drawn.length) this.drawn = [];
    else if (this.selected >= 0) this.selected = -1;
    else this.choose("select");
    this.redraw();
  }

  // A pointer on the map: draws with a tool; otherwise selects, moves what is hit, or moves the map.
  take(kind, u, v) {
    if (kind === "down") this.drag = { from: [u, v], at: [u, v], far: false, hit: this.tool === "select" ? this.find(u, v) : null, feature: null };
    const { drag } = this;
    if (!drag) return;
    const [du, dv] = [u - drag.at[0], v - drag.at[1]];
    drag.at = [u, v];
    drag.far ||= Math.hypot(u - drag.from[0], v - drag.from[1]) > TRAVEL;
    if (this.tool === "select") this.takeSelecting(kind, du, dv);
    else if (kind === "up") this.takeDrawing();
    if (kind === "up" || kind === "cancel") this.drag = null;
    this.redraw();
  }

  takeSelecting(kind, du, dv) {
    const { drag, camera } = this;
    if (kind === "down") this.selected = drag.hit?.number ?? -1;
    if (!drag.far && kind === "up" && !drag.hit) camera.clicked(...drag.at);
    if (!drag.far) return;
    if (!drag.hit) return camera.pan(du, dv);
    const [from, to] = [camera.toWorld(...drag.from), camera.toWorld(...drag.at)], feature = this.features[drag.hit.number];
    const moved = placesOf(feature).map(([x, y], k) => (drag.hit.corner < 0 || drag.hit.corner === k ? [x + to[0] - from[0], y + to[1] - from[1]] : [x, y]));
    drag.feature = withPlaces(feature, moved);
    if (kind === "up") this.put(this.features.with(drag.hit.number, drag.feature));
  }

  takeDrawing() {
    const { drag, camera } = this, layer = LAYERS[this.tool], at = camera.toWorld(...drag.at);
    if (drag.far && layer.type === "Polygon") {
      this.drawn = this.rectangle();
      return this.finish();
    }
    if (drag.far && layer.type === "LineString" && !this.drawn.length) this.drawn.push(camera.toWorld(...drag.from));
    const near = (place) => place && Math.hypot(...camera.toScreen(...place).map((value, k) => value - drag.at[k])) < NEAR;
    if (this.drawn.length > 1 && (near(this.drawn.at(-1)) || (layer.type === "Polygon" && near(this.drawn[0])))) return this.finish();
    this.drawn.push(at);
    if (layer.type === "Point" || (drag.far && layer.type === "LineString")) this.finish();
  }

  // The rectangle of a drag, with the sides of the screen.
  rectangle() {
    const [[u, v], [w, z]] = [this.drag.from, this.drag.at];
    return [[u, v], [w, v], [w, z], [u, z]].map((place) => this.camera.toWorld(...place));
  }

  finish() {
    const layer = LAYERS[this.tool], places = this.drawn;
    if (!layer || places.length < { Point: 1, LineString: 2, Polygon: 3 }[layer.type]) return;
    const properties = { layer: this.tool };
    if (layer.width) properties.width_m = Number(this.value("width"));
    if (this.tool === "speed") properties.limit_percent = Number(this.value("limit"));
    if (layer.named) properties.name = this.value("name");
    this.drawn = [];
    this.put([...this.features, withPlaces({ type: "Feature", properties, geometry: { type: layer.type } }, places)]);
  }

  remove() {
    if (this.selected < 0) return;
    const features = this.features.filter((_, number) => number !== this.selected);
    this.selected = -1;
    this.put(features);
  }

  put(features) {
    this.history.put(features);
    this.changed();
  }

  step(way) {
    this.drawn = [];
    if (!this.history[way]()) return;
    this.selected = -1;
    this.changed();
  }

  changed(unsaved = true) {
    const { before, after } = this.history;
    for (const [id, off] of [["undo", !before.length], ["redo", !after.length]]) this.section.querySelector(`#edit-${id}`).disabled = off;
    document.body.dataset.features = this.features.length;
    this.redraw();
    if (!unsaved) return;
    this.tell("saving");
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.save(), SAVE_MS);
  }

  // Saves one state after the other: the server knows by the tag which one this page has seen.
  async save() {
    if (this.saving) return (this.again = true);
    this.saving = true;
    const { features } = this;
    try {
      const answer = await fetch("edits.geojson", {
        method: "PUT", headers: { "if-match": this.tag }, body: JSON.stringify({ ...this.head, features }),
      });
      this.tag = answer.ok ? answer.headers.get("etag") : this.tag;
      const text = await answer.text();
      if (features === this.features) this.tell(answer.ok ? "saved" : `not saved: ${text}`, !answer.ok); // else a later one is due
    } catch {
      this.tell("not saved: the server has gone", true);
    }
    this.saving = false;
    if (this.again) {
      this.again = false;
      this.save();
    }
  }

  // The feature, and its corner or -1, under a place of the screen; the newest first.
  find(u, v) {
    for (let number = this.features.length - 1; number >= 0; number--) {
      const feature = this.features[number], places = placesOf(feature).map((place) => this.camera.toScreen(...place));
      const corner = number === this.selected ? places.findIndex(([x, y]) => Math.hypot(x - u, y - v) < NEAR) : -1;
      if (corner >= 0 || isHit(places, feature.geometry.type, u, v)) return { number, corner };
    }
    return null;
  }

  draw(context, camera, colours) {
    if (!this.section) return;
    context.save();
    this.features.forEach((feature, number) => {
      const shown = number === this.drag?.hit?.number && this.drag.feature ? this.drag.feature : feature;
      paint(context, camera, colours, shown, number === this.selected);
    });
    const layer = LAYERS[this.tool], rectangle = layer?.type === "Polygon" && this.drag?.far;
    const places = rectangle ? this.rectangle() : this.drawn;
    if (places.length) {
      const type = places.length < 2 ? "Point" : rectangle ? "Polygon" : "LineString";
      paint(context, camera, colours, withPlaces({ properties: { layer: this.tool }, geometry: { type } }, places), true);
    }
    context.restore();
  }
}

function isHit(places, type, u, v) {
  let inside = false;
  for (let k = 0; k < places.length; k++) {
    const [x, y] = places[k], [x2, y2] = places[(k + 1) % places.length];
    if ((y > v) !== (y2 > v) && u < x + ((v - y) / (y2 - y)) * (x2 - x)) inside = !inside;
    if (type !== "Polygon" && k === places.length - 1 && k > 0) break;
    const along = [x2 - x, y2 - y], t = Math.min(Math.max(((u - x) * along[0] + (v - y) * along[1]) / (along[0] ** 2 + along[1] ** 2 || 1), 0), 1);
    if (Math.hypot(u - x - t * along[0], v - y - t * along[1]) < NEAR) return true;
  }
  return inside && type === "Polygon";
}

function paint(context, camera, colours, feature, selected) {
  const { layer, width_m: width, name, limit_percent: percent } = feature.properties, { type } = feature.geometry;
  const places = placesOf(feature).map((place) => camera.toScreen(...place)), colour = colours[LAYERS[layer].colour];
  Object.assign(context, { strokeStyle: selected ? colours.selected : colour, fillStyle: colour, lineWidth: type === "LineString" && width ? Math.max(2, width * camera.scale) : 2 });
  context.setLineDash(layer === "no_go" ? [8, 6] : []);
  context.beginPath();
  for (const place of places) context.lineTo(...place);
  if (type === "Polygon") {
    context.closePath();
    context.globalAlpha = layer === "erased" ? 0.5 : 0.25;
    context.fill();
    context.globalAlpha = 1;
  }
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
  const label = name ?? (percent ? `${percent} %` : "");
  const [u, v] = places.reduce(([a, b], [x, y]) => [a + x / places.length, b + y / places.length], [0, 0]);
  if (label) {
    Object.assign(context, { font: "600 13px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", fillStyle: colours.text, strokeStyle: colours.free, lineWidth: 3 });
    context.strokeText(label, u, v);
    context.fillText(label, u, v);
  }
  if (!selected) return;
  context.fillStyle = colours.selected;
  for (const [x, y] of places) context.fillRect(x - 4, y - 4, 8, 8);
}
