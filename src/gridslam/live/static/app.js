// Entry of the page: applies messages to the displayed state and redraws.

import { Camera } from "./camera.js";
import { Chart, COLUMNS, WeightBars } from "./chart.js";
import { Drawing } from "./drawing.js";
import { Panel } from "./panel.js";
import { Connection } from "./socket.js";
import { palette, TileMap } from "./tilemap.js";

const $ = (selector) => document.querySelector(selector);
const NONE = new Float32Array(), NO_NUMBERS = new Int32Array();

const world = { map: new TileMap() };
const camera = new Camera($("#map"));
const drawing = new Drawing($("#map"), world, camera);
const panel = new Panel((command) => connection.send(command));
const charts = [
  new Chart($("#n_eff"), 1, { share: true }),
  new Chart($("#latency"), 2, { unit: " ms" }),
];
const weightBars = new WeightBars($("#weights"), selectParticle);
let colours = {}, redrawPending = false;

function reset() {
  world.map.clear();
  Object.assign(world, {
    runInfo: {}, status: {}, path: NONE, selected: NONE, plan: NONE, tree: NONE, parents: NO_NUMBERS, leaves: NO_NUMBERS,
    particles: NONE, scan: NONE, closures: NONE, landmarks: NONE, series: NONE, steps: 0,
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
  if (header.clear) world.map.clear();
  if (arrays.tiles) world.map.put(arrays.tiles_at, arrays.tiles);
  for (const name of ["path", "selected"]) if (arrays[name]) world[name] = splice(world[name], 2 * header[name], arrays[name]);
  if (arrays.series) {
    world.series = splice(world.series, COLUMNS * header.series, arrays.series);
    world.steps = world.series.length / COLUMNS;
  }
  for (const name of ["particles", "scan", "closures", "plan", "landmarks"]) world[name] = arrays[name] ?? world[name];
  if (arrays.tree) [world.tree, world.parents, world.leaves] = [arrays.tree, arrays.tree_parents, arrays.tree_leaves];
  panel.show(world);
  Object.assign(document.body.dataset, { tiles: world.map.tiles.size, keys: world.steps, selected: world.status.selected_particle ?? "" });
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
    for (const chart of [...charts, weightBars]) chart.draw(world, colours);
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

// Draws the scale bar: a round length of about 100 px.
function drawScaleBar() {
  const power = 10 ** Math.floor(Math.log10(100 / camera.scale));
  const metres = power * [5, 2, 1].find((step) => step * power * camera.scale <= 120);
  $("#scale").style.width = `${metres * camera.scale}px`;
  $("#scale span").textContent = metres >= 1 ? `${metres} m` : `${Math.round(100 * metres)} cm`;
}

// Whether particles can be selected.
const isSelectable = () => world.runInfo.layers?.includes("weights");

function selectParticle(particle) {
  if (!isSelectable()) return;
  connection.send({ do: "select", particle: particle === world.status.selected_particle ? null : particle });
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
  for (const name of ["unknown", "free", "occupied", "text", "faint", "rule", "path", "ancestry", "particle", "selected", "scan", "closure", "landmark", "bad"]) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
  world.map.colour(palette(colours.unknown, colours.free, colours.occupied));
  redraw();
}

async function savePicture() {
  const canvas = new OffscreenCanvas($("#map").width, $("#map").height), context = canvas.getContext("2d");
  context.fillStyle = colours.unknown;
  context.fillRect(0, 0, canvas.width, canvas.height);
  drawing.draw(colours);
  context.drawImage($("#map"), 0, 0);
  save(URL.createObjectURL(await canvas.convertToBlob()), "png");
}

function saveMap() {
  const address = new URL("map.zip", location.href);
  address.search = location.search;
  address.searchParams.set("channel", world.status.channel ?? 0);
  save(address, "zip");
}

function save(address, suffix) {
  const name = (world.runInfo.title ?? "map").replace(/[^\w.-]+/g, "_");
  Object.assign(document.createElement("a"), { href: address, download: `${name}.${suffix}` }).click();
}

reset();
applyColours();
resize();
const connection = new Connection(receive, (is, why) => panel.connected(is, why, world.status.stage === "done"));
camera.moved = redraw;
camera.clicked = (u, v) => {
  const particle = drawing.particleAt(u, v);
  if (particle >= 0) selectParticle(particle);
};
camera.hovered = (u, v) => $("#map").classList.toggle("over", isSelectable() && drawing.particleAt(u, v) >= 0);
for (const chart of charts) chart.again = redraw;
$("#fit").onclick = () => setMode("fit");
$("#follow").onclick = () => setMode(camera.mode === "follow" ? "free" : "follow");
$("#save-picture").onclick = savePicture;
$("#save-map").onclick = saveMap;
$("#layers").onchange = ({ target }) => { drawing.shown[target.name] = target.checked; redraw(); };
addEventListener("resize", resize);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", applyColours);
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, button") || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = {
    " ": () => panel.toggle(), ".": () => panel.step(false), ">": () => panel.step(true), f: () => $("#follow").click(),
    0: () => setMode("fit"), "+": () => camera.zoom(1.25, ...camera.middle), "-": () => camera.zoom(0.8, ...camera.middle),
    Escape: () => connection.send({ do: "select", particle: null }),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});
