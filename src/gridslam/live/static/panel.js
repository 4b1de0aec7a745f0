// The texts and controls around the map.

import { COLUMNS } from "./chart.js";
import { Messages } from "./messages.js";
import { Player } from "./player.js";

const $ = (selector) => document.querySelector(selector);
const CONTROLS = ["#pause", "#step", "#speed", "#line"];
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
  constructor(world, ask) {
    Object.assign(this, { world, ask });
    this.messages = new Messages();
    this.player = new Player((at) => this.show(world, at));
    for (const factor of SPEEDS) $("#speed").add(new Option(`${factor} ×`, factor));
    $("#speed").onchange = ({ target }) => { this.player.speed = Number(target.value); };
    $("#pause").onclick = () => this.toggle();
    $("#step").onclick = () => this.seekBy(1);
    $("#line").oninput = ({ target }) => this.seek(Number(target.value));
    $("#sheet").onclick = () => {
      const open = document.body.toggleAttribute("data-sheet");
      $("#sheet").setAttribute("aria-expanded", open);
      dispatchEvent(new Event("resize"));
    };
  }

  // Begins with the end of a run; a page that was disconnected goes back to where it was.
  setRunInfo(runInfo) {
    if (runInfo.session !== this.run) {
      this.player.stop();
      this.at = Infinity;
      this.speed(runInfo.speed ?? this.player.speed);
    } else if (Number.isFinite(this.at)) this.ask({ do: "seek", at: this.at });
    this.run = runInfo.session;
    document.body.dataset.mode = runInfo.mode; // the style sheet hides what does not apply
    document.title = `${runInfo.title} · gridslam`;
    $("#title").textContent = runInfo.title;
    for (const part of document.querySelectorAll("[data-layer]")) part.hidden = !runInfo.layers.includes(part.dataset.layer);
    $("#latency-of").textContent = `Time per ${runInfo.step}`;
  }

  // Whether there is a time line to move on: of a finished run.
  get hasTime() { return !$("#line").disabled; }

  toggle() {
    if (!this.hasTime) return;
    if (this.player.playing) this.player.stop();
    else this.player.start(this.world, this.at);
    this.show(this.world);
  }

  seek(at) {
    if (!this.hasTime) return;
    const chosen = Math.min(Math.max(at, 0), this.world.status.last);
    this.player.moveTo(this.world, chosen);
    this.show(this.world, chosen);
  }

  seekBy(steps) { this.seek(this.at + steps); }

  // Takes the next speed of the list, up or down.
  accelerate(direction) {
    const options = [...$("#speed").options], next = options[$("#speed").selectedIndex + direction];
    if (next) this.speed(Number(next.value));
  }

  // Shows whether there is a connection; `why` is the reason if the server has refused it.
  connected(is, why, finished) {
    this.messages.interrupt(is || finished ? "" : why ? `Refused by the server: ${why}.` : "Connection lost; trying again…");
    if (is) return;
    this.player.stop();
    document.body.dataset.stage = finished ? "finished" : "offline";
    $("#stage").textContent = finished ? "finished, server closed" : "offline";
    for (const id of CONTROLS) $(id).disabled = true;
  }

  // Shows what there is; with a key scan this one, once the server has sent it.
  show(world, at) {
    const { status, runInfo } = world, isReplay = runInfo.mode === "replay", { playing } = this.player;
    if (isReplay) this.at = Math.min(at ?? this.at, status.last);
    if (at !== undefined) this.ask({ do: "seek", at: this.at });
    const stage = !isReplay ? status.stage : playing ? "running" : this.at === status.last ? "finished" : "paused";
    Object.assign(document.body.dataset, { stage, mode: isReplay && !status.last ? "still" : runInfo.mode });
    document.body.toggleAttribute("data-held", !playing);
    for (const id of CONTROLS) $(id).disabled = !isReplay || !status.last;
    $("#stage").textContent = playing ? "playing" : status.state || (WORDS[stage] ?? stage);
    $("#pause").setAttribute("aria-label", playing ? "Pause" : "Play");
    $("#summary").textContent = this.summarize(world).join(" · ");
    this.robot(status);
    this.particles(world);
    this.time(world);
  }

  // Plays at a speed, which is added to the list where it lacks.
  speed(factor) {
    const list = $("#speed"), options = [...list.options];
    if (!options.some(({ value }) => Number(value) === factor)) {
      list.add(new Option(`${factor} ×`, factor), options.find(({ value }) => Number(value) > factor) ?? null);
    }
    list.value = factor;
    this.player.speed = factor;
  }

  summarize({ status, runInfo: { step } }) {
    const parts = [];
    for (const [count, what] of [[status.scans, "scan"], [status.keys, step], [status.closures, "loop closure"]]) if (count) parts.push(`${count} ${what}${count > 1 ? "s" : ""}`);
    if (status.real_time_factor) parts.push(`${twoDigits(status.real_time_factor)} × real time`);
    if (status.bytes) parts.push(`maps ${(status.bytes / 1e6).toFixed(0)} MB`);
    return parts;
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
    $("#shown").textContent = status.past ? "map as it was" : ["writing", "finished"].includes(status.stage) ? "final map"
      : status.best === undefined ? "" : `map of the best particle, ${status.best}`;
  }

  // The time line of a finished run, or how long a running one has come.
  time({ status, runInfo }) {
    if (runInfo.mode === "replay") Object.assign($("#line"), { max: status.last, value: this.at });
    const total = status.total_s ? ` / ${clock(status.total_s)}` : status.progress ? ` · ${percent(status.progress)}` : "";
    $("#time output").textContent = status.time_s === undefined ? "" : clock(status.time_s) + total;
  }
}
