// A pose graph: the list of its edges.

const $ = (selector) => document.querySelector(selector);
const LISTED = 50, NEAR = 9; // edges; px of an edge that is hit

const twoDigits = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2));

export class Graph {
  constructor(world, camera, redraw) {
    Object.assign(this, { world, camera, redraw, listed: null });
  }

  show() {
    const { residuals, chi2 } = this.world.status;
    $("#residuals").hidden = !residuals;
    if (!residuals) return;
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

  // Chooses an edge and moves there; chosen again, it is none.
  choose(number) {
    this.mark(this.world.chosen === number ? null : number);
    if (this.world.chosen != null) {
      const [x0, y0, x1, y1] = this.world.closures.subarray(4 * number, 4 * number + 4);
      this.camera.mode = "free";
      this.camera.fit([Math.min(x0, x1) - 3, Math.min(y0, y1) - 3, Math.max(x0, x1) + 3, Math.max(y0, y1) + 3]);
    }
    this.redraw();
  }

  mark(number) {
    this.world.chosen = number;
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
}
