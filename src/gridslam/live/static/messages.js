// What the run has reported: the list of all, newest first, and the worst one over the map until it is put away.

const $ = (selector) => document.querySelector(selector);
const LEVELS = ["info", "warning", "error"];

const AWAY = "put away", MOST = 1000;

// Names a message for as long as it is the same, however often it comes; a worse level is another one.
const nameOf = ({ first_s, level }) => `${first_s} ${level}`;

const when = (seconds) => new Date(1000 * seconds).toLocaleTimeString();

export class Messages {
  constructor() {
    this.list = [];
    this.away = new Set(JSON.parse(sessionStorage.getItem(AWAY) ?? "[]")); // those that were put away in this tab
    this.interruption = "";
    $("#notice button").onclick = () => {
      for (const message of this.list) this.away.add(nameOf(message));
      sessionStorage.setItem(AWAY, JSON.stringify([...this.away].slice(-MOST)));
      this.draw();
    };
  }

  show(list) {
    this.list = list;
    const items = list.map((message) => {
      const item = document.createElement("li"), time = document.createElement("time");
      item.dataset.level = message.level;
      time.textContent = when(message.last_s);
      time.title = `first at ${when(message.first_s)}`;
      item.append(time, ` ${message.level}${message.count > 1 ? ` (${message.count} times)` : ""}: ${message.text}`);
      return item;
    });
    $("#messages ol").replaceChildren(...items);
    $("#messages").hidden = !list.length;
    $("#messages summary b").textContent = list.length;
    this.draw();
  }

  // Shows a text about the connection instead of messages; none if it is empty.
  interrupt(text) {
    this.interruption = text;
    this.draw();
  }

  // Of those of the worst level the one that began last: two that last do not alternate. A state stands in the bar
  // already, and is over when the next one comes.
  get worst() {
    const open = this.list.filter((message) => message.level !== "info" && !message.state && !this.away.has(nameOf(message)));
    return open.sort((a, b) => LEVELS.indexOf(b.level) - LEVELS.indexOf(a.level) || b.first_s - a.first_s)[0];
  }

  draw() {
    const notice = $("#notice"), worst = this.interruption ? null : this.worst;
    notice.hidden = !this.interruption && !worst;
    notice.dataset.level = worst?.level ?? "warning";
    notice.querySelector("span").textContent = this.interruption || (worst ? worst.text : "");
    notice.querySelector("button").hidden = !worst;
    $("#messages").dataset.level = LEVELS.findLast((level) => this.list.some((message) => message.level === level)) ?? "info";
  }
}
