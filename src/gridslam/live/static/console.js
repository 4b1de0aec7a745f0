// What viewers may make a robot do: set its pose by a drag, locate it, reset it, save, and change sessions.

const $ = (selector) => document.querySelector(selector);
const SESSION = ["serialize", "go_on"];
const SURE_MS = 4000, SHORTEST = 8; // px of a drag that sets a heading, too

export class Console {
  // `ask` sends a command to the server; `redraw` is called when the arrow has changed.
  constructor(camera, ask, redraw) {
    Object.assign(this, { camera, ask, redraw, pose: null });
    $("#set_pose").onclick = () => this.toggle();
    $("#locate").onclick = () => this.command("locate");
    $("#save-robot").onclick = () => this.command("save");
    $("#reset").onclick = () => this.reset();
    for (const name of SESSION) $(`#${name}`).onclick = () => this.command(name, { session: $("#session-name").value.trim() });
  }

  setRunInfo({ commands = [] }) {
    $("#console").hidden = !commands.some((name) => name !== "save");
    for (const name of ["set_pose", "locate", "reset", ...SESSION]) $(`#${name}`).hidden = !commands.includes(name);
    $("#robot-session").hidden = !commands.includes("serialize");
    $("#save-robot").hidden = !commands.includes("save");
    if (!commands.includes("set_pose") && $("#set_pose").getAttribute("aria-pressed") === "true") this.toggle(false);
  }

  command(command, more = {}) { this.ask({ do: "robot", command, ...more }); }

  // A map is lost by a reset: that is asked for twice.
  reset() {
    const button = $("#reset"), sure = button.hasAttribute("data-sure");
    clearTimeout(this.timer);
    if (sure) this.command("reset");
    button.toggleAttribute("data-sure", !sure);
    button.textContent = sure ? "reset" : "really reset?";
    if (!sure) this.timer = setTimeout(() => { button.removeAttribute("data-sure"); button.textContent = "reset"; }, SURE_MS);
  }

  // While a pose is set, a drag on the map goes from the place of the robot to where it looks.
  toggle(active = !this.camera.takes) {
    $("#set_pose").setAttribute("aria-pressed", active);
    $("#map").classList.toggle("measuring", active);
    if (active && document.body.hasAttribute("data-sheet")) $("#sheet").click(); // it covers the map of a phone
    this.pose = null;
    this.camera.takes = active ? (kind, u, v) => this.drag(kind, u, v) : null;
    this.redraw();
  }

  drag(kind, u, v) {
    const [x, y] = this.camera.toWorld(u, v);
    if (kind === "down") this.pose = { from: [u, v], x, y, theta: 0 };
    if (!this.pose) return;
    const [du, dv] = [u - this.pose.from[0], v - this.pose.from[1]];
    if (Math.hypot(du, dv) > SHORTEST) this.pose.theta = Math.atan2(y - this.pose.y, x - this.pose.x);
    if (kind === "up") {
      this.command("set_pose", { pose: [this.pose.x, this.pose.y, this.pose.theta] });
      this.toggle(false);
    }
    this.redraw();
  }

  // Draws the pose that is being set as an arrow.
  draw(context, camera, colours) {
    if (!this.pose) return;
    const [u, v] = camera.toScreen(this.pose.x, this.pose.y);
    context.save();
    context.translate(u, v);
    context.rotate(-this.pose.theta - camera.angle);
    Object.assign(context, { strokeStyle: colours.selected, fillStyle: colours.selected, lineWidth: 3 });
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(44, 0);
    context.moveTo(34, -8);
    context.lineTo(46, 0);
    context.lineTo(34, 8);
    context.stroke();
    context.beginPath();
    context.arc(0, 0, 5, 0, 7);
    context.fill();
    context.restore();
  }
}
