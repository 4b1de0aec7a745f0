// Entry of the page: applies messages to the displayed state and redraws.

import { Camera } from "./camera.js";
import { Chart, COLUMNS } from "./chart.js";
import { Drawing } from "./drawing.js";
import { Panel } from "./panel.js";
import { Connection } from "./socket.js";
import { Keys } from "./keys.js";
import { palette, TileMap } from "./tilemap.js";
import { inMetres, Measure, roundLength } from "./tools.js";

const $ = (selector) => document.querySelector(selector);
const NONE = new Float32Array();

const MOVE = 80; // px that an arrow key moves the map

const world = { map: new TileMap() };
const camera = new Camera($("#map"));
const drawing = new Drawing($("#map"), world, camera);
const panel = new Panel(world, (command) => connection.send(command));
const charts = [
  new Chart($("#n_eff"), 1, { share: true }),
  new Chart($("#latency"), 2, { unit: " ms" }),
];
const measure = drawing.measure = new Measure();
let colours = {}, redrawPending = false;

function reset() {
  world.map.clear();
  Object.assign(world, {
    runInfo: {}, status: {}, path: NONE, plan: NONE, particles: NONE, scan: NONE, closures: NONE, truth: NONE,
    series: NONE, steps: 0,
  });
}

// Returns the first `kept` items followed by new ones.
function splice(before, kept, added) {
  const joined = new Float32Array(kept + added.length);
  joined.set(before.subarray(0, kept));
  joined.set(added, kept);
  return joined;
}

function receive({ header, arrays }) {
  if (header.run_info && header.run_info.session !== world.runInfo.session) reset();
  if (header.run_info) setRunInfo(header.run_info);
  if (header.status) world.status = header.status;
  if (header.messages) panel.messages.show(header.messages);
  if (header.clear) world.map.clear();
  if (arrays.tiles) world.map.put(arrays.tiles_at, arrays.tiles);
  if (arrays.path) world.path = splice(world.path, 2 * header.path, arrays.path);
  if (arrays.series) {
    world.series = splice(world.series, COLUMNS * header.series, arrays.series);
    world.steps = world.series.length / COLUMNS;
  }
  for (const name of ["particles", "scan", "closures", "plan", "truth"]) world[name] = arrays[name] ?? world[name];
  panel.show(world);
  Object.assign(document.body.dataset, { tiles: world.map.tiles.size, at: world.status.at ?? "", keys: world.steps });
  redraw();
}

function setRunInfo(runInfo) {
  world.runInfo = runInfo;
  world.map.place(runInfo.resolution_m ?? 0.05, runInfo.offset_m);
  document.body.dataset.session = runInfo.session;
  panel.setRunInfo(runInfo);
  resize();
}

function redraw() {
  if (redrawPending) return;
  redrawPending = true;
  requestAnimationFrame(() => {
    redrawPending = false;
    moveCamera();
    drawing.draw(colours);
    for (const chart of charts) chart.draw(world, colours);
    drawScaleBar();
  });
}

// Moves the camera as its mode demands.
function moveCamera() {
  const pose = world.status.pose;
  if (camera.mode === "follow" && pose && camera.approach(pose[0], pose[1])) redraw();
  const extent = world.map.extent(drawing.extent()) ?? drawing.extent();
  if (camera.mode === "fit" && extent) camera.fit(extent);
  document.body.dataset.view = [camera.x, camera.y, camera.scale, ...camera.middle].map((value) => value.toFixed(3)).join(" ");
  $("#fit").setAttribute("aria-pressed", camera.mode === "fit");
  $("#follow").setAttribute("aria-pressed", camera.mode === "follow");
}

// Draws the scale bar: a round length of about 60 to 120 px.
function drawScaleBar() {
  const metres = roundLength(60, camera.scale);
  $("#scale").style.width = `${metres * camera.scale}px`;
  $("#scale span").textContent = metres >= 1 ? `${metres} m` : inMetres(metres);
}

// Shows the place under the pointer, and what is measured.
function showPlace(place) {
  const where = place && place.map((value) => value.toFixed(2));
  $("#cursor").textContent = [where && `x ${where[0]} m, y ${where[1]} m`, measure.text()].filter(Boolean).join(" · ");
}

function toggleMeasure() {
  measure.toggle();
  $("#measure").setAttribute("aria-pressed", measure.active);
  $("#map").classList.toggle("measuring", measure.active);
  if (measure.active && document.body.hasAttribute("data-sheet")) $("#sheet").click(); // it covers the map of a phone
  showPlace(null);
  redraw();
}

function turn(angle) {
  camera.turn(angle);
  const degrees = Math.round((camera.angle * 180) / Math.PI);
  [$("#turn").value, $("#turn + output").textContent] = [degrees, `${degrees}°`];
}

function arrow({ key, shiftKey }) {
  const [u, v] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
  if (shiftKey || !panel.hasTime) camera.pan(u * MOVE, v * MOVE);
  else if (u) panel.seekBy(-u);
  else panel.accelerate(v);
}

function setMode(mode) {
  camera.mode = mode;
  if (mode === "follow") camera.scale = Math.max(camera.scale, 30);
  redraw();
}

function resize() {
  drawing.resize();
  const box = (selector) => $(selector).getBoundingClientRect(), wide = !matchMedia("(max-width: 720px), (max-height: 480px)").matches;
  for (const [name, part] of [["--foot", "#transport"], ["--head", "#bar"]]) document.documentElement.style.setProperty(name, `${box(part).height}px`);
  const panelBox = box("#panel"), gap = 16;
  camera.margin = {
    left: gap, right: wide ? innerWidth - panelBox.left + gap : gap, top: box("#bar").bottom + gap,
    bottom: innerHeight - (wide || !panelBox.height ? box("#transport").top : panelBox.top) + gap,
  };
  redraw();
}

function applyColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["unknown", "free", "occupied", "text", "faint", "rule", "path", "plan", "particle", "selected", "scan", "closure", "truth", "good", "bad"]) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
  world.map.colour(palette(colours.unknown, colours.free, colours.occupied));
  redraw();
}

reset();
applyColours();
resize();
const connection = new Connection(receive, (is, why) => panel.connected(is, why, world.status.stage === "finished"));
camera.moved = redraw;
camera.clicked = (u, v) => {
  if (!measure.active) return;
  measure.add(...camera.toWorld(u, v));
  showPlace(camera.toWorld(u, v));
  redraw();
};
camera.hovered = (u, v) => {
  if (measure.active) {
    measure.pointer = camera.toWorld(u, v);
    redraw();
  }
  showPlace(camera.toWorld(u, v));
};
camera.left = () => {
  measure.pointer = null;
  showPlace(null);
  redraw();
};
for (const chart of charts) {
  chart.again = redraw;
  chart.chosen = (step) => panel.seek(step);
}
$("#fit").onclick = () => setMode("fit");
$("#follow").onclick = () => setMode(camera.mode === "follow" ? "free" : "follow");
$("#measure").onclick = toggleMeasure;
$("#help-button").onclick = () => $("#help").showModal();
$("#turn").oninput = ({ target }) => turn((target.value * Math.PI) / 180);
$("#opacity").oninput = ({ target }) => {
  drawing.opacity = target.value / 100;
  $("#opacity + output").textContent = `${target.value} %`;
  redraw();
};
$("#layers").onchange = ({ target }) => { drawing.shown[target.name] = target.checked; redraw(); };
addEventListener("resize", resize);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", applyColours);

new Keys([
  [[" "], "play, pause", () => panel.toggle()],
  [["."], "to the next key scan", () => panel.seekBy(1)],
  [["ArrowLeft", "ArrowRight"], "back and on in time; with Shift, or without a time line, move the map", arrow],
  [["ArrowUp", "ArrowDown"], "faster, slower; with Shift, or without a time line, move the map", arrow],
  [["Home", "End"], "to the beginning, to the end", ({ key }) => panel.seek(key === "Home" ? 0 : Infinity)],
  [["0"], "all of the map", () => setMode("fit")],
  [["f"], "follow the robot", () => $("#follow").click()],
  [["+", "-"], "closer, farther", ({ key }) => camera.zoom(key === "+" ? 1.25 : 0.8, ...camera.middle)],
  [["[", "]"], "turn the map by 15°", ({ key }) => turn(camera.angle + (key === "[" ? Math.PI : -Math.PI) / 12)],
  [["n"], "not turned", () => turn(0)],
  [["g"], "grid in metres", () => $("#layers input[name='grid']").click()],
  [["m"], "measure", () => toggleMeasure()],
  [["Escape"], "end measuring", () => measure.active && toggleMeasure()],
  [["?"], "this list", () => $("#help").showModal()],
], $("#help"));
