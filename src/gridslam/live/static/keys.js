// The keyboard: what each key does, and the list of them.

const NAMES = { " ": "space", ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", Escape: "Esc", "?": "?" };

const TEXT = "input:not([type=range], [type=checkbox], [type=radio])"; // fields that are typed into

// Whether a key is meant for the part that has the focus. One that was clicked loses it at the next key (see `Keys`).
function isForPart(part, key) {
  if (part.matches(`select, ${TEXT}`)) return true;
  if (part.matches("input[type='range']")) return key.startsWith("Arrow") || key === "Home" || key === "End";
  if (part.matches("#messages ol")) return /^(Arrow(Up|Down)|Home|End|Page(Up|Down))$/.test(key);
  return key === " " && part.matches("button, input, summary");
}

export class Keys {
  // `bindings`: [keys, what they do, function of the event] each, or without a function where it is only listed.
  constructor(bindings, dialog) {
    this.actions = new Map();
    this.dialog = dialog;
    const list = dialog.querySelector("dl");
    for (const [keys, what, action] of bindings) {
      for (const key of action ? keys : []) this.actions.set(key, action);
      if (what) list.append(this.term(keys), Object.assign(document.createElement("dd"), { textContent: what }));
    }
    addEventListener("keydown", (event) => this.pressed(event));
    addEventListener("pointerdown", () => { this.isPointed = true; });
  }

  term(keys) {
    const term = document.createElement("dt");
    for (const key of keys) term.append(Object.assign(document.createElement("kbd"), { textContent: NAMES[key] ?? key }), " ");
    return term;
  }

  pressed(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.dialog.open) return;
    if (event.key === "Tab") this.isPointed = false;
    else if (this.isPointed && document.activeElement.matches(`button, summary, input:not(${TEXT})`)) document.activeElement.blur();
    const action = this.actions.get(event.key);
    if (!action || isForPart(document.activeElement, event.key)) return;
    event.preventDefault();
    action(event);
  }
}
