// Small charts over time.

function prepare(canvas) {
  const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio];
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

// A round number at or above a value.
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)));
  return power * [1, 2, 5, 10].find((step) => step * power >= value);
}

export const COLUMNS = 5; // of the series: time, effective sample size, latency, flags, number of particles
const FLAGS = 3, PARTICLES = 4;
const LOST = 1, CORRECTED = 8;

// The first step at or after a time.
export function findStep(series, steps, time) {
  let [low, high] = [0, steps - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (series[COLUMNS * middle] < time) low = middle + 1; else high = middle;
  }
  return low;
}

// A chart of one column of the series; key scans on the same pixel are drawn as their range.
export class Chart {
  // `column` of the series; `share`: as a ratio of the number of particles, with a line at one half.
  constructor(canvas, column, { share = false, unit = "" } = {}) {
    Object.assign(this, { canvas, column, share, unit, pointer: null });
    canvas.addEventListener("pointermove", (event) => { this.pointer = event.offsetX; this.again?.(); });
    canvas.addEventListener("click", ({ offsetX }) => this.world?.steps && this.chosen?.(this.stepAt(offsetX)));
    canvas.addEventListener("pointerleave", () => { this.pointer = null; this.again?.(); });
  }

  draw(world, colours) {
    const [context, width, height] = prepare(this.canvas), { series, steps } = world;
    this.world = world;
    if (!steps) return;
    const first = series[0], last = Math.max(series[COLUMNS * (steps - 1)], first + 1);
    const toX = (time) => ((time - first) / (last - first)) * (width - 1);
    const columns = new Map();
    let greatest = 0;
    this.drawMarks(context, series, steps, toX, height, colours);
    for (let k = 0; k < steps; k++) {
      const value = this.value(series, k), x = Math.round(toX(series[COLUMNS * k]));
      if (Number.isNaN(value)) continue;
      greatest = Math.max(greatest, value);
      const [low, high] = columns.get(x) ?? [value, value];
      columns.set(x, [Math.min(low, value), Math.max(high, value)]);
    }
    const top = this.share ? 1 : roundUp(greatest), toY = (value) => height - 1 - (value / top) * (height - 12);
    this.drawAxes(context, width, height, toY(0.5), this.share ? "100 %" : `${+top.toPrecision(3)}${this.unit}`, colours);
    context.beginPath();
    let before = null;
    for (const [x, [low, high]] of [...columns].sort(([a], [b]) => a - b)) {
      if (before === null) context.moveTo(x, toY(high));
      context.lineTo(x, toY(before !== null && before > high ? high : low));
      context.lineTo(x, toY(before !== null && before > high ? low : high));
      before = high;
    }
    Object.assign(context, { strokeStyle: colours.path, lineWidth: 1.2, lineJoin: "round" });
    context.stroke();
    if (world.status.at !== undefined) this.drawCursor(context, toX(world.status.time_s ?? 0), height, colours.text);
    if (this.pointer !== null) this.drawReading(context, world, first + (this.pointer / width) * (last - first), toX, toY, width, colours);
  }

  // The step at a place of the chart, px from its left.
  stepAt(x) {
    const { series, steps } = this.world, first = series[0], last = series[COLUMNS * (steps - 1)];
    return findStep(series, steps, first + (x / this.canvas.clientWidth) * (last - first));
  }

  value(series, k) {
    const value = series[COLUMNS * k + this.column];
    return this.share ? value / series[COLUMNS * k + PARTICLES] : value;
  }

  // Marks where the robot was lost, and where a correction happened.
  drawMarks(context, series, steps, toX, height, colours) {
    context.globalAlpha = 0.4;
    const flag = (k) => series[COLUMNS * k + FLAGS], x = (k) => Math.round(toX(series[COLUMNS * Math.min(k, steps - 1)]));
    for (let k = 0; k < steps; k++) {
      const first = k;
      while (flag(k) & LOST) k++;
      if (k > first) this.drawMark(context, x(first), x(k), height, colours.bad);
      if (flag(k) & CORRECTED) this.drawMark(context, x(k), x(k), height, colours.closure);
    }
    context.globalAlpha = 1;
  }

  drawMark(context, first, end, height, colour) {
    context.fillStyle = colour;
    context.fillRect(first, 12, Math.max(end - first, 1), height - 12);
  }

  drawAxes(context, width, height, half, top, colours) {
    context.fillStyle = colours.rule;
    context.fillRect(0, height - 1, width, 1);
    if (this.share) for (let x = 0; x < width; x += 6) context.fillRect(x, Math.round(half), 3, 1);
    context.fillStyle = colours.faint;
    context.font = "10px system-ui, sans-serif";
    context.fillText(top, 0, 8);
  }

  drawCursor(context, x, height, colour) {
    context.fillStyle = colour;
    context.fillRect(Math.round(x), 10, 1, height - 10);
  }

  // Draws the value at the time under the pointer.
  drawReading(context, { series, steps }, time, toX, toY, width, colours) {
    let low = findStep(series, steps, time);
    while (low > 0 && Number.isNaN(series[COLUMNS * low + this.column])) low--;
    const [at, value, particles] = [0, this.column, PARTICLES].map((column) => series[COLUMNS * low + column]), x = toX(at);
    if (Number.isNaN(value)) return;
    const text = `${at.toFixed(1)} s: ${+value.toPrecision(3)}${this.share ? ` of ${particles}` : this.unit}`;
    context.fillStyle = colours.text;
    context.beginPath();
    context.arc(x, toY(this.value(series, low)), 2.5, 0, 7);
    context.fill();
    context.fillText(text, width - context.measureText(text).width, 8);
  }
}
