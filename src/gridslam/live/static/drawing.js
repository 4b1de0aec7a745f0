// Draws the map, the trajectory, the scan and the particles.

import { drawGrid } from "./tools.js";

const ROBOT = 9; // px

// Draws a line through points, interrupted at NaN.
function line(context, points, camera) {
  let broken = true;
  context.beginPath();
  for (let k = 0; k + 1 < points.length; k += 2) {
    const [u, v] = camera.toScreen(points[k], points[k + 1]);
    if (broken) context.moveTo(u, v); else context.lineTo(u, v);
    broken = Number.isNaN(u);
  }
  context.stroke();
}

export class Drawing {
  constructor(canvas, world, camera) {
    Object.assign(this, { canvas, world, camera });
    this.shown = { map: true, path: true, particles: true, scan: true, closures: true, truth: true, grid: false };
    this.opacity = 1;
  }

  resize() {
    this.canvas.width = Math.round(this.canvas.clientWidth * devicePixelRatio);
    this.canvas.height = Math.round(this.canvas.clientHeight * devicePixelRatio);
  }

  draw(colours) {
    const { world, camera, shown } = this, context = this.canvas.getContext("2d");
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, camera.width, camera.height);
    if (shown.map) this.map(context);
    if (shown.grid) drawGrid(context, camera, colours);
    Object.assign(context, { lineJoin: "round", lineCap: "round" });
    if (shown.truth) this.truth(context, colours.truth);
    if (shown.path) this.path(context, colours);
    if (shown.closures) this.closures(context, colours);
    if (shown.scan) this.scan(context, colours.scan);
    this.robot(context, colours);
    if (shown.particles) this.particles(context, colours);
    this.measure?.draw(context, camera, colours);
  }

  // Paints the map, from a copy where it has not changed.
  map(context) {
    const { camera, world, opacity, canvas } = this;
    const { x, y, scale, angle, middle } = camera, ratio = devicePixelRatio;
    const seen = JSON.stringify([x, y, scale, angle, middle, ratio, canvas.width, canvas.height, opacity, world.map.version]);
    if (seen !== this.seen) {
      this.seen = seen;
      this.layer = new OffscreenCanvas(Math.max(canvas.width, 1), Math.max(canvas.height, 1)).getContext("2d");
      this.layer.setTransform(ratio, 0, 0, ratio, 0, 0);
      this.layer.globalAlpha = opacity;
      world.map.draw(this.layer, camera);
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.layer.canvas, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  truth(context, colour) {
    Object.assign(context, { strokeStyle: colour, lineWidth: 2.4 });
    context.setLineDash([6, 4]);
    line(context, this.world.truth, this.camera);
    context.setLineDash([]);
  }

  closures(context, colours) {
    const { closures } = this.world;
    Object.assign(context, { strokeStyle: colours.closure, fillStyle: colours.closure, lineWidth: 1.2 });
    for (let k = 0; k < closures.length; k += 4) {
      line(context, closures.subarray(k, k + 4), this.camera);
      for (const end of [k, k + 2]) this.dot(context, closures.subarray(end, end + 2), 2.5);
    }
  }

  dot(context, [x, y], radius) {
    context.beginPath();
    context.arc(...this.camera.toScreen(x, y), radius, 0, 7);
    context.fill();
  }

  path(context, colours) {
    const { world, camera } = this;
    if (world.plan.length) {
      Object.assign(context, { strokeStyle: colours.plan, lineWidth: 1, globalAlpha: 0.6 });
      line(context, world.plan, camera);
      context.globalAlpha = 1;
    }
    Object.assign(context, { strokeStyle: colours.path, lineWidth: Math.min(Math.max(camera.scale / 8, 1.2), 2.2) });
    const { plan, status } = world, isMapping = status.best !== undefined && !plan.length && !status.past;
    const now = isMapping ? status.pose.slice(0, 2) : []; // since the last key scan
    line(context, [...world.path, ...now], camera);
  }

  // Draws the current scan at the pose of the robot.
  scan(context, colour) {
    const { world } = this, pose = world.status.scan_pose ?? world.status.pose;
    if (pose && world.scan.length) this.points(context, world.scan, pose, colour);
  }

  // Draws points of a frame at a pose.
  points(context, points, [px, py, theta], colour) {
    const { camera } = this, [c, s] = [Math.cos(theta), Math.sin(theta)];
    const size = Math.min(Math.max(0.06 * camera.scale, 1.5), 5);
    context.fillStyle = colour;
    for (let k = 0; k < points.length; k += 2) {
      const [x, y] = points.subarray(k, k + 2);
      const [u, v] = camera.toScreen(px + c * x - s * y, py + s * x + c * y);
      context.fillRect(u - size / 2, v - size / 2, size, size);
    }
  }

  particles(context, colours) {
    const { world, camera } = this, count = world.particles.length / 4;
    let most = 0;
    for (let k = 0; k < count; k++) most = Math.max(most, world.particles[4 * k + 3]);
    const headed = camera.scale > 60, dot = Math.min(Math.max(camera.scale / 30, 1.4), 3.2);
    for (let k = 0; k < count; k++) {
      const [x, y, theta, weight] = world.particles.subarray(4 * k, 4 * k + 4);
      const [u, v] = camera.toScreen(x, y);
      context.globalAlpha = 0.25 + 0.65 * Math.sqrt(weight / most);
      context.fillStyle = context.strokeStyle = colours.particle;
      context.lineWidth = 1.5;
      context.beginPath();
      context.arc(u, v, dot, 0, 7);
      context.fill();
      if (headed) {
        context.beginPath();
        context.moveTo(u, v);
        context.lineTo(u + 14 * Math.cos(theta + camera.angle), v - 14 * Math.sin(theta + camera.angle));
        context.stroke();
      }
    }
    context.globalAlpha = 1;
  }

  robot(context, colours) {
    const { status } = this.world;
    if (!status.pose) return;
    const [x, y, theta] = status.pose, [u, v] = this.camera.toScreen(x, y);
    context.save();
    context.translate(u, v);
    if (status.covariance) this.ellipse(context, ...status.covariance[0].slice(0, 2), status.covariance[1][1], colours.path, !status.lost);
    context.rotate(-theta - this.camera.angle);
    context.beginPath();
    context.moveTo(1.3 * ROBOT, 0);
    context.lineTo(-ROBOT, 0.8 * ROBOT);
    context.lineTo(-0.55 * ROBOT, 0);
    context.lineTo(-ROBOT, -0.8 * ROBOT);
    context.closePath();
    Object.assign(context, { fillStyle: status.lost ? colours.bad : colours.path, strokeStyle: colours.free, lineWidth: 2 });
    context.stroke();
    context.fill();
    context.restore();
  }

  // Draws the ellipse of two standard deviations if it is large enough to be visible.
  ellipse(context, a, b, c, colour, filled = true) {
    const mean = (a + c) / 2, spread = Math.hypot((a - c) / 2, b);
    const radii = [mean + spread, Math.max(mean - spread, 0)].map((variance) => 2 * Math.sqrt(variance) * this.camera.scale);
    if (radii[0] < 4) return;
    context.beginPath();
    context.ellipse(0, 0, radii[0], radii[1], -0.5 * Math.atan2(2 * b, a - c) - this.camera.angle, 0, 7);
    Object.assign(context, { fillStyle: colour, strokeStyle: colour, lineWidth: 1, globalAlpha: 0.15 });
    if (filled) context.fill();
    context.globalAlpha = 0.6;
    context.stroke();
    context.globalAlpha = 1;
  }

  // The bounding box of paths: [x0, y0, x1, y1], or null.
  extent() {
    let box = null;
    for (const points of [this.world.plan, this.world.path]) {
      for (let k = 0; k < points.length; k += 2) {
        const [x, y] = [points[k], points[k + 1]];
        if (Number.isNaN(x)) continue;
        box ??= [x, y, x, y];
        box = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
      }
    }
    return box && [box[0] - 1, box[1] - 1, box[2] + 1, box[3] + 1];
  }
}
