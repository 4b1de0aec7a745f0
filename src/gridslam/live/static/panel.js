// The words and buttons about the map.

import { COLUMNS } from "./chart.js";

const $ = (selector) => document.querySelector(selector);
const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 30, 100];

function clock(seconds) {
  const whole = Math.floor(seconds), pad = (value) => String(value).padStart(2, "0");
  const minutes = `${Math.floor(whole / 60) % 60}:${pad(whole % 60)}`;
  return whole < 3600 ? minutes : `${Math.floor(whole / 3600)}:${minutes.padStart(5, "0")}`;
}

const WORDS = { "final refinement": "finding the final map", writing: "writing the results", done: "finished" };
const put = (name, text) => { $(`[data-value="${name}"]`).textContent = text; };
const share = (value) => `${(100 * value).toFixed(0)} %`;
const few = (value) => value.toFixed(value < 100 ? 1 : 0);
const short = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2));

export class Panel {
  // `ask` sends a command to the server.
  constructor(ask) {
    this.ask = ask;
    for (const times of SPEEDS) $("#speed").add(new Option(`${times} ×`, times));
    $("#speed").onchange = ({ target }) => ask({ do: "speed", times: target.value === "" ? null : Number(target.value) });
    $("#pause").onclick = () => this.toggle();
    $("#step").onclick = (event) => ask({ do: "step", to_key_scan: !event.shiftKey });
    $("#line").oninput = ({ target }) => ask({ do: "seek", at: Number(target.value) });
    $("#best").onclick = () => ask({ do: "watch", particle: null });
    $("#sheet").onclick = () => {
      const open = document.body.toggleAttribute("data-sheet");
      $("#sheet").setAttribute("aria-expanded", open);
      dispatchEvent(new Event("resize"));
    };
  }

  greet(hello) {
    this.mode = hello.mode;
    document.title = `${hello.title} · gridslam`;
    $("#title").textContent = hello.title;
    const replay = this.mode === "replay", unlimited = $("#speed option[value='']");
    for (const shown of document.querySelectorAll("[data-shows]")) shown.hidden = !hello.shows.includes(shown.dataset.shows);
    $("#latency-of").textContent = `Time per ${hello.step}`;
    document.body.dataset.mode = hello.mode; // of which the style sheet knows what there is to hold
    if (!replay && !unlimited) $("#speed").add(new Option("max", ""));
    if (replay) unlimited?.remove();
  }

  get held() { return document.body.hasAttribute("data-held"); }

  toggle() {
    if (!$("#pause").disabled) this.ask({ do: this.held ? "resume" : "pause" });
  }

  step(shift) {
    if (!$("#step").disabled) this.ask({ do: "step", to_key_scan: !shift });
  }

  // Shows whether there is a connection; `why` is the reason if the server has refused it.
  connected(is, why, finished) {
    const notice = $("#notice");
    notice.hidden = is || finished;
    this.online = is;
    notice.textContent = why ? `The server says: ${why}.` : "The connection is lost; trying again…";
    if (is) return;
    document.body.dataset.stage = finished ? "done" : "offline";
    $("#stage").textContent = finished ? "finished, server closed" : "offline";
    for (const id of ["#pause", "#step", "#speed", "#line"]) $(id).disabled = true;
  }

  show(world) {
    const { status } = world;
    if (this.online) [$("#notice").hidden, $("#notice").textContent] = [!status.says, status.says ?? ""];
    document.body.dataset.stage = status.lost && status.stage === "running" ? "lost" : status.stage;
    $("#stage").textContent = document.body.dataset.stage === "lost" ? "running, the robot is lost" : WORDS[status.stage] ?? status.stage;
    document.body.toggleAttribute("data-held", status.stage === "paused");
    const going = ["running", "paused", "waiting"].includes(status.stage) && this.mode !== "still";
    $("#pause").disabled = !going;
    for (const id of ["#step", "#speed"]) $(id).disabled = !going || this.mode === "robot";
    $("#pause").setAttribute("aria-label", this.held ? "Go on" : "Pause");
    if (document.activeElement !== $("#speed")) this.speed(status.speed ?? "");
    $("#facts").textContent = this.facts(world).join(" · ");
    this.robot(status);
    this.particles(world);
    this.time(world);
  }

  speed(times) {
    $("#speed").value = times;
    if ($("#speed").value !== String(times)) $("#speed").add(new Option(`${times} ×`, times, false, true), 0);
  }

  facts({ status, hello: { step } }) {
    const facts = status.size_m ? [status.size_m.map((side) => `${side.toFixed(1)} m`).join(" × ")] : [];
    const counts = [[status.scans, "scan"], [status.keys, step], [status.landmarks, "landmark"], [status.closures, "loop closure"]];
    for (const [count, what] of counts) if (count) facts.push(`${count} ${what}${count > 1 ? "s" : ""}`);
    if (status.times && status.stage === "running" && this.mode === "live") facts.push(`${short(status.times)} × real time`);
    if (status.bytes) facts.push(`maps ${(status.bytes / 1e6).toFixed(0)} MB`);
    return facts;
  }

  robot({ pose, covariance, doubt, agreement }) {
    if (!pose) return;
    if (doubt !== undefined) [put("doubt", share(doubt)), put("agreement", share(agreement))];
    put("position", `${pose[0].toFixed(2)} m, ${pose[1].toFixed(2)} m`);
    put("heading", `${((pose[2] * 180) / Math.PI).toFixed(1)}°`);
    for (const row of document.querySelectorAll(".deviation")) row.hidden = !covariance;
    if (!covariance) return;
    const deviation = Math.sqrt(covariance[0][0] + covariance[1][1]), turn = Math.sqrt(covariance[2][2]);
    const length = deviation < 1 ? `${(100 * deviation).toFixed(1)} cm` : `${deviation.toFixed(1)} m`;
    put("deviation", `${length}, ${few((turn * 180) / Math.PI)}°`);
  }

  particles({ status, hello, series, steps }) {
    const now = status.at ?? steps - 1, [, , latency, , count] = series.subarray(COLUMNS * now, COLUMNS * (now + 1));
    put("n_eff", status.n_eff == null ? "" : `${few(status.n_eff)} of ${count}`);
    put("latency", steps ? `${short(latency)} ms` : "");
    put("particles", status.particles || "");
    const replay = hello.mode === "replay", what = replay ? "past" : "map";
    $("#watched span").textContent = ["writing", "done"].includes(status.stage) ? "final map"
      : status.watched < 0 ? "the chosen one has died out"
      : status.watched != null ? `${what} of number ${status.watched}`
      : replay ? "final map" : status.best === undefined ? "" : `map of the best, number ${status.best}`;
    $("#best").hidden = status.watched == null;
  }

  time({ status, hello }) {
    const slider = $("#line"), replay = hello.mode === "replay";
    slider.disabled = !replay;
    if (replay) {
      slider.max = Math.max(status.last, 0);
      if (document.activeElement !== slider || !slider.matches(":active")) slider.value = status.at;
    } else {
      slider.max = 1000;
      slider.value = 1000 * (status.share ?? 0);
    }
    const total = replay ? ` / ${clock(status.total_s)}` : "";
    $("#time output").textContent = status.time_s === undefined ? "" : clock(status.time_s) + total;
  }
}
