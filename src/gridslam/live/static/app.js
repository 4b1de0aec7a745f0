// Puts the page together: messages change the world, and what has changed is drawn.

import { Camera } from "./camera.js";
import { Chart, COLUMNS, Strip } from "./chart.js";
import { Drawing } from "./drawing.js";
import { Panel } from "./panel.js";
import { Line } from "./socket.js";
import { palette, TileMap } from "./tilemap.js";

const $ = (selector) => document.querySelector(selector);
const NONE = new Float32Array(), NO_NUMBERS = new Int32Array();

const world = { map: new TileMap() };
const camera = new Camera($("#map"));
const drawing = new Drawing($("#map"), world, camera);
const panel = new Panel((command) => line.send(command));
const charts = [
  new Chart($("#n_eff"), 1, { share: true }),
  new Chart($("#latency"), 2, { unit: " ms" }),
];
const strip = new Strip($("#weights"), choose);
let colours = {}, wanted = false;

function forget() {
  world.map.clear();
  Object.assign(world, {
    hello: {}, status: {}, path: NONE, plan: NONE, tree: NONE, parents: NO_NUMBERS, leaves: NO_NUMBERS,
    particles: NONE, scan: NONE, closures: NONE, landmarks: NONE, series: NONE, steps: 0,
  });
}

// A copy of the first `kept` items and then others.
function spliced(before, kept, added) {
  const joined = new Float32Array(kept + added.length);
  joined.set(before.subarray(0, kept));
  joined.set(added, kept);
  return joined;
}

function receive({ header, arrays }) {
  if (header.hello && header.hello.session !== world.hello.session) forget();
  if (header.hello) greet(header.hello);
  if (header.status) world.status = header.status;
  if (header.clear) world.map.clear();
  if (arrays.tiles) world.map.put(arrays.tiles_at, arrays.tiles);
  if (arrays.path) world.path = spliced(world.path, 2 * header.path, arrays.path);
  if (arrays.series) {
    world.series = spliced(world.series, COLUMNS * header.series, arrays.series);
    world.steps = world.series.length / COLUMNS;
  }
  for (const name of ["particles", "scan", "closures", "plan", "landmarks"]) world[name] = arrays[name] ?? world[name];
  if (arrays.tree) [world.tree, world.parents, world.leaves] = [arrays.tree, arrays.tree_parents, arrays.tree_leaves];
  panel.show(world);
  Object.assign(document.body.dataset, { tiles: world.map.tiles.size, keys: world.steps, watched: world.status.watched ?? "" });
  redraw();
}

function greet(hello) {
  world.hello = hello;
  world.map.place(hello.resolution_m ?? 0.05, hello.offset_m);
  document.body.dataset.session = hello.session;
  panel.greet(hello);
  resize();
}

function redraw() {
  if (wanted) return;
  wanted = true;
  requestAnimationFrame(() => {
    wanted = false;
    look();
    drawing.draw(colours);
    for (const chart of [...charts, strip]) chart.draw(world, colours);
    rule();
  });
}

// Moves the camera to what it is to show.
function look() {
  const pose = world.status.pose;
  if (camera.mode === "follow" && pose && camera.approach(pose[0], pose[1])) redraw();
  const extent = world.map.extent() ?? drawing.extent();
  if (camera.mode === "fit" && extent) camera.fit(extent);
  document.body.dataset.view = [camera.x, camera.y, camera.scale, ...camera.middle].map((value) => value.toFixed(3)).join(" ");
  $("#fit").setAttribute("aria-pressed", camera.mode === "fit");
  $("#follow").setAttribute("aria-pressed", camera.mode === "follow");
}

// The scale bar: a round length of about 100 px.
function rule() {
  const power = 10 ** Math.floor(Math.log10(100 / camera.scale));
  const metres = power * [5, 2, 1].find((step) => step * power * camera.scale <= 120);
  $("#scale").style.width = `${metres * camera.scale}px`;
  $("#scale span").textContent = metres >= 1 ? `${metres} m` : `${Math.round(100 * metres)} cm`;
}

// Whether particles have maps or pasts of their own.
const choosable = () => world.hello.shows?.includes("weights");

function choose(particle) {
  if (!choosable()) return;
  line.send({ do: "watch", particle: particle === world.status.watched ? null : particle });
}

function set(mode) {
  camera.mode = mode;
  if (mode === "follow") camera.scale = Math.max(camera.scale, 30);
  redraw();
}

function resize() {
  drawing.resize();
  const box = (selector) => $(selector).getBoundingClientRect(), wide = !matchMedia("(max-width: 720px), (max-height: 480px)").matches;
  document.documentElement.style.setProperty("--foot", `${box("#transport").height}px`);
  const panelBox = box("#panel"), gap = 16;
  camera.margin = {
    left: gap, right: wide ? innerWidth - panelBox.left + gap : gap, top: box("#bar").bottom + gap,
    bottom: innerHeight - (wide || !panelBox.height ? box("#transport").top : panelBox.top) + gap,
  };
  redraw();
}

function dress() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["unknown", "free", "occupied", "text", "faint", "rule", "path", "pasts", "particle", "chosen", "scan", "closure", "landmark", "bad"]) {
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
  const name = (world.hello.title ?? "map").replace(/[^\w.-]+/g, "_");
  Object.assign(document.createElement("a"), { href: address, download: `${name}.${suffix}` }).click();
}

forget();
dress();
resize();
const line = new Line(receive, (is, why) => panel.connected(is, why, world.status.stage === "done"));
camera.moved = redraw;
camera.clicked = (u, v) => {
  const particle = drawing.particleAt(u, v);
  if (particle >= 0) choose(particle);
};
camera.hovered = (u, v) => $("#map").classList.toggle("over", choosable() && drawing.particleAt(u, v) >= 0);
for (const chart of charts) chart.again = redraw;
$("#fit").onclick = () => set("fit");
$("#follow").onclick = () => set(camera.mode === "follow" ? "free" : "follow");
$("#save-picture").onclick = savePicture;
$("#save-map").onclick = saveMap;
$("#layers").onchange = ({ target }) => { drawing.shown[target.name] = target.checked; redraw(); };
addEventListener("resize", resize);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", dress);
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, button") || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = {
    " ": () => panel.toggle(), ".": () => panel.step(false), ">": () => panel.step(true), f: () => $("#follow").click(),
    0: () => set("fit"), "+": () => camera.zoom(1.25, ...camera.middle), "-": () => camera.zoom(0.8, ...camera.middle),
    Escape: () => line.send({ do: "watch", particle: null }),
  };
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});
