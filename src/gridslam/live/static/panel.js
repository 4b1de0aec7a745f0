// The texts and controls around the map.

import { COLUMNS } from "./chart.js";
import { Messages } from "./messages.js";

const $ = (selector) => document.querySelector(selector);
const PATIENCE_MS = 2000; // with the answer to a wish
const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 30, 100];

function clock(seconds) {
  const whole = Math.floor(seconds), pad = (value) => String(value).padStart(2, "0");
  const minutes = `${Math.floor(whole / 60) % 60}:${pad(whole % 60)}`;
  return whole < 3600 ? minutes : `${Math.floor(whole / 3600)}:${minutes.padStart(5, "0")}`;
}

const WORDS = {
  "final refinement": "finding the final map", writing: "writing results",
  lost: "running, robot lost", looking: "looking for the robot in the whole map",
};
const put = (name, text) => { $(`[data-value="${name}"]`).textContent = text; };
const percent = (value) => `${(100 * value).toFixed(0)} %`;
const oneDecimal = (value) => value.toFixed(value < 100 ? 1 : 0);
const twoDigits = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2));

export class Panel {
  // `ask` sends a command to the server.
  constructor(ask) {
    this.ask = ask;
    this.messages = new Messages();
    this.pauses = false; // whether the run is paused by this page: the server ends the pause with the connection
    for (const factor of SPEEDS) $("#speed").add(new Option(`${factor} ×`, factor));
    $("#speed").onchange = ({ target }) => ask({ do: "speed", factor: target.value === "" ? null : Number(target.value) });
    $("#pause").onclick = () => this.toggle();
    $("#step").onclick = (event) => this.step(event.shiftKey);
    $("#line").oninput = ({ target }) => this.seek(Number(target.value));
    $("#sheet").onclick = () => {
      const open = document.body.toggleAttribute("data-sheet");
      $("#sheet").setAttribute("aria-expanded", open);
      dispatchEvent(new Event("resize"));
    };
  }

  setRunInfo(runInfo) {
    this.pauses &&= runInfo.session === this.run;
    this.run = runInfo.session;
    if (this.pauses) this.ask({ do: "pause" }); // the connection was lost
    this.mode = runInfo.mode;
    document.title = `${runInfo.title} · gridslam`;
    $("#title").textContent = runInfo.title;
    const replay = this.mode === "replay", unlimited = $("#speed option[value='']");
    for (const part of document.querySelectorAll("[data-layer]")) part.hidden = !runInfo.layers.includes(part.dataset.layer);
    $("#latency-of").textContent = `Time per ${runInfo.step}`;
    document.body.dataset.mode = runInfo.mode; // the style sheet hides the controls that do not apply
    if (!replay && !unlimited) $("#speed").add(new Option("max", ""));
    if (replay) unlimited?.remove();
  }

  get held() { return document.body.hasAttribute("data-held"); }

  toggle() {
    if ($("#pause").disabled) return;
    this.pauses = !this.held;
    this.ask({ do: this.held ? "resume" : "pause" });
  }

  step(shift) {
    if ($("#step").disabled) return;
    this.pauses = true;
    this.ask({ do: "step", to_key_scan: !shift });
  }

  // Whether there is a time line to move on.
  get hasTime() { return !$("#line").disabled; }

  seek(at) {
    if (!this.hasTime) return;
    const from = Number($("#line").value);
    $("#line").value = Math.min(Math.max(at, 0), Number($("#line").max));
    this.wish = { at: Number($("#line").value), from, untilMs: performance.now() + PATIENCE_MS };
    this.ask({ do: "seek", at: this.wish.at });
  }

  // Whether a status at `at` is as the viewer wished; what plays has continued from there.
  isReached(at) {
    if (!this.wish || this.held) return at === this.wish?.at;
    return at >= this.wish.at && (this.wish.at >= this.wish.from || at < this.wish.from);
  }

  seekBy(steps) { this.seek(Number($("#line").value) + steps); }

  // Takes the next speed of the list, up or down.
  accelerate(direction) {
    const options = [...$("#speed").options], at = options.findIndex((option) => option.selected) + direction;
    if ($("#speed").disabled || !options[at]) return;
    options[at].selected = true;
    $("#speed").onchange({ target: $("#speed") });
  }

  // Shows whether there is a connection; `why` is the reason if the server has refused it.
  connected(is, why, finished) {
    this.messages.interrupt(is || finished ? "" : why ? `Refused by the server: ${why}.` : "Connection lost; trying again…");
    if (is) return;
    document.body.dataset.stage = finished ? "finished" : "offline";
    document.body.toggleAttribute("data-over", finished);
    $("#stage").textContent = finished ? "finished, server closed" : "offline";
    for (const id of ["#pause", "#step", "#speed", "#line"]) $(id).disabled = true;
  }

  show(world) {
    const { status } = world;
    document.body.dataset.stage = status.stage;
    const stage = status.state || (WORDS[status.stage] ?? (this.mode === "replay" && status.stage === "running" ? "playing" : status.stage));
    $("#stage").textContent = status.past && this.mode !== "replay" ? `${stage}, seen as it was` : stage;
    if (this.held && status.stage !== "paused") this.pauses = false; // another has ended the pause
    document.body.toggleAttribute("data-held", ["paused", "finished"].includes(status.stage));
    const over = ["final refinement", "writing", "failed"].includes(status.stage) || (status.stage === "finished" && this.mode !== "replay"), going = !over && this.mode !== "still";
    document.body.toggleAttribute("data-over", over);
    for (const id of ["#pause", "#step", "#speed"]) $(id).disabled = !going || this.mode === "robot";
    $("#pause").setAttribute("aria-label", this.held ? "Resume" : "Pause");
    if (document.activeElement !== $("#speed")) this.speed(status.speed ?? "");
    $("#summary").textContent = this.summarize(world).join(" · ");
    this.session(status);
    this.robot(status);
    this.particles(world);
    this.time(world);
  }

  speed(factor) {
    const list = $("#speed");
    list.value = factor;
    if (list.value === String(factor)) return;
    const faster = [...list.options].find((option) => option.value === "" || Number(option.value) > factor);
    list.add(new Option(`${factor} ×`, factor, false, true), faster ?? null);
  }

  summarize({ status, runInfo: { step } }) {
    const parts = status.size_m ? [status.size_m.map((side) => `${side.toFixed(1)} m`).join(" × ")] : [];
    const counts = [[status.scans, "scan"], [status.keys, step], [status.poses, "pose"], [status.edges, "edge"], [status.landmarks, "landmark"], [status.closures, "loop closure"]];
    for (const [count, what] of counts) if (count) parts.push(`${count} ${what}${count > 1 ? "s" : ""}`);
    if (status.real_time_factor && status.stage !== "paused" && this.mode === "live") parts.push(`${twoDigits(status.real_time_factor)} × real time`);
    if (status.bytes) parts.push(`maps ${(status.bytes / 1e6).toFixed(0)} MB`);
    return parts;
  }

  // Which session goes on, and where the robot was found again in it.
  session({ goes_on, searches, found }) {
    const part = $("#goes-on"), [session, state] = part.querySelectorAll("p");
    part.hidden = !goes_on && !found && !searches;
    if (part.hidden) return;
    const drives = goes_on?.drives ?? [];
    session.hidden = !goes_on;
    session.querySelector("b").textContent = goes_on?.name ?? "";
    session.querySelector("span").textContent = drives.length ? `${drives.length} drive${drives.length > 1 ? "s" : ""}` : "";
    session.title = drives.join(", ");
    state.textContent = found ? `found again after ${found.way_m.toFixed(1)} m, at ${found.pose[0].toFixed(2)} m, ${found.pose[1].toFixed(2)} m`
      : searches ? "looking for the robot in its map" : goes_on ? "goes on" : "";
  }

  robot({ pose, covariance, lost_probability, inlier_ratio }) {
    if (!pose) return;
    if (lost_probability !== undefined) {
      put("lost_probability", percent(lost_probability));
      put("inlier_ratio", percent(inlier_ratio));
    }
    put("position", `${pose[0].toFixed(2)} m, ${pose[1].toFixed(2)} m`);
    put("heading", `${((pose[2] * 180) / Math.PI).toFixed(1)}°`);
    for (const row of document.querySelectorAll(".deviation")) row.hidden = !covariance;
    if (!covariance) return;
    const deviation = Math.sqrt(covariance[0][0] + covariance[1][1]), turn = Math.sqrt(covariance[2][2]);
    const length = deviation < 1 ? `${(100 * deviation).toFixed(1)} cm` : `${deviation.toFixed(1)} m`;
    put("deviation", `${length}, ${oneDecimal((turn * 180) / Math.PI)}°`);
  }

  particles({ status, series, steps }) {
    const now = status.at ?? steps - 1, [, , latency, , count] = series.subarray(COLUMNS * now, COLUMNS * (now + 1));
    put("n_eff", status.n_eff == null ? "" : `${oneDecimal(status.n_eff)} of ${count}`);
    put("latency", steps ? `${twoDigits(latency)} ms` : "");
    put("particles", status.particles || "");
    $("#shown").textContent = ["writing", "finished"].includes(status.stage) ? "final map" : status.past ? "map as it was"
      : status.best === undefined ? "" : `map of the best particle, ${status.best}`;
  }

  // The time line: of a finished run its time, of a running one its key scans so far.
  time({ status, runInfo }) {
    const slider = $("#line"), replay = runInfo.mode === "replay";
    slider.disabled = !(replay || status.last > 0);
    if (runInfo.mode !== "still") {
      slider.max = Math.max(status.last ?? 0, 0);
      const at = status.at ?? Number(slider.max);
      if (this.isReached(at) || performance.now() > this.wish?.untilMs) this.wish = null; // until then `at` is older than the wish
      if (!this.wish && !slider.matches(":active")) slider.value = at;
    }
    const total = replay ? ` / ${clock(status.total_s)}` : status.progress ? ` · ${percent(status.progress)}` : "";
    $("#time output").textContent = status.time_s === undefined ? "" : clock(status.time_s) + total;
  }
}
