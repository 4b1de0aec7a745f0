// Plays a finished run: shows the key scan of the time that has passed.

import { COLUMNS, findStep } from "./chart.js";

const TICK_MS = 100;

export class Player {
  // `show` is called with a key scan.
  constructor(show) {
    Object.assign(this, { show, speed: 10, timer: null });
  }

  get playing() { return this.timer !== null; }

  // Plays from a key scan on; at the last one the run begins again.
  start(world, at) {
    const from = at >= world.steps - 1 ? 0 : at;
    this.timer = setInterval(() => this.tick(world), TICK_MS);
    this.moveTo(world, from);
    this.show(from);
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
  }

  // Goes on from a key scan.
  moveTo({ series }, at) {
    this.time = series[COLUMNS * at];
    this.since = performance.now();
  }

  tick({ series, steps }) {
    const now = performance.now();
    this.time += (this.speed * (now - this.since)) / 1000;
    this.since = now;
    const at = findStep(series, steps, this.time);
    if (at === steps - 1) this.stop();
    this.show(at);
  }
}
