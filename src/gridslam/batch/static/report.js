"use strict";

const CHUNK = 60; // rows added at a time, as the end of the view comes near

const { runs, columns } = JSON.parse(document.getElementById("data").textContent);
const byId = (name) => document.getElementById(name);

const FORMS = {
  m: (x) => (x < 0.1 ? x.toFixed(4) : x < 10 ? x.toFixed(3) : x.toFixed(0)) + " m",
  rad: (x) => ((x * 180) / Math.PI).toFixed(2) + "°",
  s: (x) => (x < 1 ? x.toFixed(2) : x < 100 ? x.toFixed(1) : x.toFixed(0)) + " s",
  ms: (x) => (1e3 * x).toFixed(x < 0.01 ? 2 : 1) + " ms",
  bytes: (x) => (x / 1e6).toFixed(0) + " MB",
  count: (x) => String(Math.round(x)),
};

const texts = runs.map((run) =>
  [run.log, run.folder, run.error, run.message, ...run.findings.map((finding) => finding[1])].join(" ").toLowerCase());

function make(name, className, ...content) {
  const element = document.createElement(name);
  if (className) element.className = className;
  element.append(...content);
  return element;
}

const url = (...names) => names.join("/").split("/").map(encodeURIComponent).join("/");

// What a column sorts by: numbers by size, others by their text; undefined comes last in both directions.
const SORTS = {
  status: (run) => (run.failed ? 0 : 1),
  log: (run) => run.log.toLowerCase(),
  findings: (run) => -run.findings.reduce((sum, finding) => sum + (finding[0] === "error" ? 1000 : 1), 0),
};
const sortValue = (run, name) => (SORTS[name] ? SORTS[name](run) : run.figures[name]);

function compare(a, b) {
  if (a === undefined || b === undefined) return (a === undefined) - (b === undefined);
  return a < b ? -1 : a > b ? 1 : 0;
}

const state = { sort: "status", descending: false, status: "all", error: "", shown: [] };

function select() {
  const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const chosen = [];
  runs.forEach((run, i) => {
    if (state.status === "failed" && !run.failed) return;
    if (state.status === "done" && run.failed) return;
    if (state.status === "findings" && !run.findings.length) return;
    if (state.error && run.error !== state.error) return;
    if (words.every((word) => texts[i].includes(word))) chosen.push(i);
  });
  const values = runs.map((run) => sortValue(run, state.sort));
  const sign = state.descending ? -1 : 1;
  chosen.sort((i, j) => {
    const known = values[i] !== undefined && values[j] !== undefined;
    return (known ? sign : 1) * compare(values[i], values[j]) || i - j;
  });
  state.shown = chosen;
}

function picture(run) {
  if (!run.picture) return make("span", "none");
  const image = make("img");
  image.loading = "lazy";
  image.decoding = "async";
  image.alt = `Map of ${run.log}`;
  image.src = url(run.folder, run.picture);
  const link = make("a", "", image);
  link.href = url(run.folder, run.picture);
  return link;
}

function describe(run) {
  const name = make("div", "log", run.folder);
  name.title = run.log;
  const text = make("div", "", name, make("div", "message note", `${run.note} · ${run.name}`));
  if (run.failed) text.append(make("div", "message", make("span", "error", run.error), run.message ? `: ${run.message}` : ""));
  if (run.tail) text.append(make("details", "", make("summary", "", "Output"), make("pre", "", run.tail)));
  return text;
}

function findings(run) {
  const cell = make("td", "text findings");
  for (const [severity, code, sentence] of run.findings) {
    const item = make("span", severity, code.replaceAll("_", " "));
    item.title = sentence;
    cell.append(item);
  }
  return cell;
}

function row(run) {
  const head = make("th", "", make("div", "run", picture(run), describe(run)));
  head.scope = "row";
  const cells = columns.map(([name, , form]) => {
    if (name === "findings") return findings(run);
    const value = run.figures[name];
    return make("td", "", value === undefined ? "" : FORMS[form](value));
  });
  return make("tr", run.failed ? "failed" : "", head, ...cells);
}

const box = byId("table");
const list = document.querySelector("tbody");
let observer;

// Rows are added in chunks when the last one comes near the visible part.
function extend() {
  const from = list.childElementCount;
  list.append(...state.shown.slice(from, from + CHUNK).map((i) => row(runs[i])));
  observer?.disconnect();
  if (list.childElementCount < state.shown.length) {
    observer = new IntersectionObserver((seen) => seen.some((entry) => entry.isIntersecting) && extend(), { root: box, rootMargin: "800px" });
    observer.observe(list.lastElementChild);
  }
}

function show() {
  select();
  list.replaceChildren();
  box.scrollTop = 0;
  extend();
  if (!state.shown.length) {
    const cell = make("td", "empty", "No run matches.");
    cell.colSpan = columns.length + 1;
    list.append(make("tr", "", cell));
  }
  byId("count").textContent = state.shown.length === runs.length ? `${runs.length} runs` : `${state.shown.length} of ${runs.length} runs`;
  byId("sort").value = state.sort;
  byId("direction").textContent = state.descending ? "↓" : "↑";
  for (const cell of document.querySelectorAll("thead th")) {
    cell.removeAttribute("aria-sort");
    if (cell.dataset.name === state.sort) cell.setAttribute("aria-sort", state.descending ? "descending" : "ascending");
  }
  for (const button of document.querySelectorAll("#errors button")) button.setAttribute("aria-pressed", String(button.dataset.error === state.error));
}

function sortBy(name, descending) {
  state.descending = descending ?? (state.sort === name && !state.descending);
  state.sort = name;
  show();
}

function makeHead() {
  const cells = [["log", "log", "text"], ...columns].map(([name, label, form]) => {
    const button = make("button", "", label);
    button.type = "button";
    button.addEventListener("click", () => sortBy(name));
    const cell = make("th", form === "text" ? "text" : "", button);
    cell.scope = "col";
    cell.dataset.name = name;
    return cell;
  });
  document.querySelector("thead").append(make("tr", "", ...cells));
  const options = [["status", "failures first"], ["log", "log"], ...columns.map(([name, label]) => [name, label])];
  byId("sort").append(...options.map(([name, label]) => new Option(label, name)));
}

function makeTools() {
  const failed = runs.filter((run) => run.failed);
  const found = runs.filter((run) => run.findings.length);
  const choices = [["all", `all (${runs.length})`], ["failed", `failed (${failed.length})`],
    ["done", `done (${runs.length - failed.length})`], ["findings", `with findings (${found.length})`]];
  byId("status").append(...choices.map(([name, label]) => new Option(label, name)));
  const counts = new Map();
  for (const run of failed) counts.set(run.error, (counts.get(run.error) ?? 0) + 1);
  for (const [error, count] of [...counts].sort((a, b) => b[1] - a[1]).slice(0, 12)) {
    const button = make("button", "", `${error} ${count}`);
    button.type = "button";
    button.dataset.error = error;
    button.addEventListener("click", () => {
      state.error = state.error === error ? "" : error;
      show();
    });
    byId("errors").append(button);
  }
  const cpu = runs.reduce((sum, run) => sum + (run.figures.cpu_s ?? 0), 0);
  const hours = cpu >= 3600 ? `${(cpu / 3600).toFixed(1)} h` : `${cpu.toFixed(0)} s`;
  byId("summary").textContent = `${runs.length - failed.length} done, ${failed.length} failed, ${hours} of CPU time`;
}

makeTools();
makeHead();
byId("filter").addEventListener("input", show);
byId("status").addEventListener("change", (event) => {
  state.status = event.target.value;
  show();
});
byId("sort").addEventListener("change", (event) => sortBy(event.target.value, false));
byId("direction").addEventListener("click", () => sortBy(state.sort, !state.descending));
show();
requestAnimationFrame(() => setTimeout(() => (document.body.dataset.readyMs = performance.now().toFixed(0))));
