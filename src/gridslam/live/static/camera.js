// The camera: metres to pixels, and the gestures that move it.

const CLOSEST = 400, FARTHEST = 0.2; // px per m

export class Camera {
  constructor(canvas) {
    this.canvas = canvas;
    this.x = 0; this.y = 0; // of the middle of the free part of the screen, m
    this.scale = 20; // px per m
    this.angle = 0; // by which the map is turned counterclockwise, rad
    this.margin = { left: 0, right: 0, top: 0, bottom: 0 }; // px covered by other elements
    this.mode = "fit"; // or "follow", or "free"
    this.moved = () => {};
    this.clicked = () => {};
    this.hovered = () => {};
    this.left = () => {};
    this.listen();
  }

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }
  get middle() {
    const { left, right, top, bottom } = this.margin;
    return [(left + this.width - right) / 2, (top + this.height - bottom) / 2];
  }

  // Turns a vector of the map, m, to the directions of the screen, y upwards; back with `sign` -1.
  turned(x, y, sign = 1) {
    const [c, s] = [Math.cos(this.angle), sign * Math.sin(this.angle)];
    return [c * x - s * y, s * x + c * y];
  }

  toScreen(x, y) {
    const [u, v] = this.middle, [dx, dy] = this.turned(x - this.x, y - this.y);
    return [u + dx * this.scale, v - dy * this.scale];
  }

  toWorld(u, v) {
    const [mu, mv] = this.middle, [dx, dy] = this.turned((u - mu) / this.scale, (mv - v) / this.scale, -1);
    return [this.x + dx, this.y + dy];
  }

  // Fits a rectangle [x0, y0, x1, y1].
  fit([x0, y0, x1, y1]) {
    const { left, right, top, bottom } = this.margin;
    const [c, s] = [Math.abs(Math.cos(this.angle)), Math.abs(Math.sin(this.angle))], [w, h] = [x1 - x0, y1 - y0];
    const scale = Math.min((this.width - left - right) / (c * w + s * h), (this.height - top - bottom) / (s * w + c * h));
    this.scale = Math.min(Math.max(scale, FARTHEST), 80);
    this.x = (x0 + x1) / 2;
    this.y = (y0 + y1) / 2;
  }

  // Moves one step towards a position; true while it is still far.
  approach(x, y) {
    const [dx, dy] = [x - this.x, y - this.y];
    const far = Math.hypot(dx, dy) * this.scale > 0.5;
    this.x += far ? 0.25 * dx : dx;
    this.y += far ? 0.25 * dy : dy;
    return far;
  }

  pan(du, dv) {
    const [dx, dy] = this.turned(du / this.scale, -dv / this.scale, -1);
    this.x -= dx;
    this.y -= dy;
    this.setFree();
  }

  turn(angle) {
    this.angle = Math.atan2(Math.sin(angle), Math.cos(angle));
    this.moved();
  }

  zoom(factor, u, v) {
    const [x, y] = this.toWorld(u, v);
    this.scale = Math.min(Math.max(this.scale * factor, FARTHEST), CLOSEST);
    if (this.mode !== "follow") {
      const [x1, y1] = this.toWorld(u, v);
      this.x += x - x1;
      this.y += y - y1;
      this.mode = "free";
    }
    this.moved();
  }

  setFree() {
    this.mode = "free";
    this.moved();
  }

  listen() {
    const canvas = this.canvas;
    const held = new Map();
    let travelled = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      if (!held.size) travelled = 0;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.classList.add("grabbed");
    });
    canvas.addEventListener("pointermove", (event) => {
      const at = [event.clientX, event.clientY], before = held.get(event.pointerId);
      if (!before) return this.hovered(...at);
      const [du, dv] = [at[0] - before[0], at[1] - before[1]];
      travelled += Math.hypot(du, dv);
      held.set(event.pointerId, at);
      if (held.size === 1 && travelled > 4) this.pan(du, dv);
      if (held.size === 2) this.pinch([...held.entries()].find(([id]) => id !== event.pointerId)[1], before, at);
    });
    const release = (event) => {
      const at = held.get(event.pointerId);
      held.delete(event.pointerId);
      if (!held.size) canvas.classList.remove("grabbed");
      if (at && event.type === "pointerup" && travelled <= 4) this.clicked(...at);
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("pointerleave", () => this.left());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.zoom(Math.exp(-0.0016 * lines * event.deltaY), event.clientX, event.clientY);
    }, { passive: false });
  }

  // Two fingers: one stays at `still`, the other went from `before` to `at`.
  pinch(still, before, at) {
    const apart = (p) => Math.hypot(p[0] - still[0], p[1] - still[1]);
    if (this.mode !== "follow") this.pan((at[0] - before[0]) / 2, (at[1] - before[1]) / 2);
    this.zoom(apart(at) / Math.max(apart(before), 1), (still[0] + at[0]) / 2, (still[1] + at[1]) / 2);
  }
}
