// A pose graph: the list of its edges, both scans of one of them, and its edits: reject, put a scan elsewhere, add, undo.

const $ = (selector) => document.querySelector(selector);
const LISTED = 50, NEAR = 9, TRAVEL = 4; // edges; px of an edge that is hit; px of a drag

const twoDigits = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2));
const percent = (value) => `${(100 * value).toFixed(0)} %`;

export class Graph {
  // `ask` sends a command to the server.
  constructor(world, camera, ask, redraw) {
    Object.assign(this, { world, camera, ask, redraw, listed: null, base: null, drag: null });
    $("#reject").onclick = () => ask({ do: "edit", edit: this.world.status.residuals[this.world.chosen].slice(0, 2) });
    $("#add").onclick = () => ask({ do: "edit", edit: "add" });
    $("#undo").onclick = () => ask({ do: "edit", edit: "undo" });
    $("#put").onclick = () => this.toggle(!this.isPutting);
  }

  get isPutting() { return $("#put").getAttribute("aria-pressed") === "true"; }

  setRunInfo({ edits_graph: edits }) {
    $("#edits").hidden = !edits;
  }

  show() {
    const { residuals, chi2, rejected, added, overlay, scan_pose: pose } = this.world.status;
    $("#residuals").hidden = !residuals;
    if (!residuals) return;
    $("#edits span").textContent = [[rejected, "rejected"], [added, "added"]].filter(([pairs]) => pairs?.length).map(([pairs, what]) => `${pairs.length} ${what}`).join(", ");
    $("#undo").disabled = !rejected?.length && !added?.length;
    $("#add").disabled = !overlay?.proposed;
    this.tell(overlay);
    this.base = overlay?.score == null && overlay ? pose : null;
    if (this.base && this.drag) this.move();
    if (JSON.stringify(this.listed) === JSON.stringify(residuals)) return;
    this.listed = residuals;
    this.mark(null);
    $('[data-value="chi2"]').textContent = `chi2 ${twoDigits(chi2)}`;
    $("#residuals ol").replaceChildren(...residuals.slice(0, LISTED).map(([from, to, off], number) => {
      const item = document.createElement("li"), button = document.createElement("button");
      button.textContent = `${from} – ${to}: chi2 ${twoDigits(off)}`;
      button.onclick = () => this.choose(number);
      item.append(button);
      return item;
    }));
  }

  tell(overlay) {
    const [from, to] = overlay?.pair ?? [];
    $("#overlay").textContent = !overlay ? "" : overlay.score == null ? `key scan ${from}`
      : `scans ${from} and ${to}: ${percent(overlay.score)} of the beams agree${overlay.proposed ? ", not added yet" : ""}`;
  }

  // Chooses an edge, looks at its scans and moves there; chosen again, it is none.
  choose(number) {
    this.mark(this.world.chosen === number ? null : number);
    if ($("#edits").hidden === false) this.ask({ do: "look", edge: this.world.chosen });
    if (this.world.chosen != null) {
      const [x0, y0, x1, y1] = this.world.closures.subarray(4 * number, 4 * number + 4);
      this.camera.mode = "free";
      this.camera.fit([Math.min(x0, x1) - 3, Math.min(y0, y1) - 3, Math.max(x0, x1) + 3, Math.max(y0, y1) + 3]);
    }
    this.redraw();
  }

  mark(number) {
    this.world.chosen = number;
    $("#reject").disabled = number == null;
    document.querySelectorAll("#residuals li button").forEach((button, at) => button.setAttribute("aria-pressed", at === number));
  }

  // Chooses the edge under a place of the screen, if there is one.
  pick(u, v) {
    const { closures, status } = this.world;
    const away = (k) => {
      const [[x, y], [x2, y2]] = [0, 2].map((end) => this.camera.toScreen(closures[4 * k + end], closures[4 * k + end + 1]));
      const [dx, dy] = [x2 - x, y2 - y], t = Math.min(Math.max(((u - x) * dx + (v - y) * dy) / (dx * dx + dy * dy || 1), 0), 1);
      return Math.hypot(u - x - t * dx, v - y - t * dy);
    };
    const near = (status.residuals ?? []).map((_, k) => [away(k), k]).filter(([px]) => px < NEAR).sort(([a], [b]) => a - b);
    if (near.length) this.choose(near[0][1]);
  }

  // While a scan is put elsewhere, a drag takes the scan nearest to where it begins.
  toggle(active) {
    $("#put").setAttribute("aria-pressed", active);
    $("#map").classList.toggle("measuring", active);
    if (active && document.body.hasAttribute("data-sheet")) $("#sheet").click(); // it covers the map of a phone
    this.drag = null;
    this.camera.takes = active ? (kind, u, v) => this.take(kind, u, v) : null;
    this.mark(null);
    this.redraw();
  }

  take(kind, u, v) {
    const at = this.camera.toWorld(u, v);
    if (kind === "down") {
      this.drag = { start: [u, v], from: at, to: at };
      this.ask({ do: "grab", at });
    }
    if (!this.drag) return;
    this.drag.to = at;
    this.move();
    if (kind !== "up" && kind !== "cancel") return;
    const { start, from, to } = this.drag;
    this.drag = null;
    if (kind === "up" && Math.hypot(u - start[0], v - start[1]) > TRAVEL) {
      this.ask({ do: "put", from, to });
      this.toggle(false);
    }
  }

  // Shows the scan where the pointer is.
  move() {
    const { from, to } = this.drag;
    if (!this.base) return;
    this.world.status.scan_pose = [this.base[0] + to[0] - from[0], this.base[1] + to[1] - from[1], this.base[2]];
    this.redraw();
  }
}
