// Keys, and the list of all commands.
import { t } from "./words.js";

const ARROWS = { arrowup: "↑", arrowdown: "↓", arrowleft: "←", arrowright: "→" };

export class Keys {
  constructor(status, controls, joystick) {
    this.status = status;
    this.controls = controls;
    this.joystick = joystick;
    this.commands = [];
    this.pointedFrom = null; // what had the focus when arrow keys moved the point, and has it still
    this.palette = document.getElementById("palette");
    this.find = document.getElementById("palette-find");
    this.list = document.getElementById("palette-list");
    this.find.addEventListener("input", () => this.fill());
    this.find.addEventListener("keydown", (event) => event.key === "Enter" && this.first());
    this.palette.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation(); // it cancels nothing else
      this.palette.close();
    });
    // Not modal: Stop can be pressed while it is open, like anything else.
    addEventListener("pointerdown", ({ target }) =>
      this.palette.contains(target) || this.palette.close());
  }

  listenTo(target, options) {
    target.addEventListener("keydown", (event) => this.typed(event), options);
    target.addEventListener("focusin", () => { this.pointedFrom = null; }, options);
  }

  typed(event) {
    const into = event.target;
    const isField = into.isContentEditable
      || ["INPUT", "TEXTAREA", "SELECT"].includes(into.tagName)
      && !["checkbox", "range"].includes(into.type);
    if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "k") {
      event.preventDefault();
      this.open();
      return;
    }
    if (isField || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.toLowerCase();
    // Who speaks to a computer types letters without meaning to press keys.
    if (key.length === 1 && key !== " " && this.status.state?.has_letters === false) return;
    if (key === " " || (key === "s" && event.shiftKey)) {
      // Space presses what has the focus, too: Stop comes first.
      event.preventDefault();
      if (!event.repeat) this.status.stop();
      return;
    }
    // Arrow keys move a slider that has the focus.
    if (this.palette.contains(into) || (into.type === "range" && key in ARROWS)) return;
    if (this.points(event, key)) return;
    if (event.repeat || event.shiftKey) return;
    if (key === "j") return this.joystick.toggle();
    // Enter and the like belong to a control that has the focus. Space is Stop, so Enter ticks.
    if (key === "enter" && into.closest("button, summary, a")) return;
    if (key === "enter" && into.type === "checkbox") return into.click();
    const command = this.commands.find((one) => one.key === key);
    if (command !== undefined) {
      event.preventDefault();
      this.controls.press(command.id);
    }
  }

  // While something is to be pointed out, arrow keys move the point; Enter takes it once they have,
  // but presses a button that the focus has gone to since, such as one that cancels.
  points(event, key) {
    const state = this.status.state, arrow = ARROWS[key], into = event.target;
    const isForButton = into !== this.pointedFrom && into.closest("button, summary, a, input") !== null;
    const isTaken = key === "enter" && state?.has_cursor && !event.repeat && !isForButton;
    if (event.defaultPrevented || !state?.is_pointing || !(arrow || isTaken)) return false;
    const wanted = arrow ? (event.shiftKey ? "⇧" : "") + arrow : "⏎";
    const command = this.commands.find((one) => one.key === wanted);
    if (command === undefined) return false;
    event.preventDefault();
    event.stopPropagation();
    if (arrow) this.pointedFrom = into;
    this.controls.press(command.id);
    return true;
  }

  open() {
    this.find.value = "";
    this.fill();
    this.palette.show();
    this.find.focus();
  }

  fill() {
    const wanted = this.find.value.trim().toLowerCase();
    const stop = { title: t("Stop the robot"), key: "space", act: () => this.status.stop() };
    const all = [stop, ...this.commands].filter((one) => one.title.toLowerCase().includes(wanted));
    this.list.replaceChildren(...all.map((one) => this.row(one)));
  }

  row(command) {
    const item = document.createElement("li"), button = document.createElement("button");
    const key = document.createElement("kbd");
    button.type = "button";
    button.append(command.title, " ");
    key.textContent = t(command.key);
    button.append(key);
    button.addEventListener("click", () => {
      this.palette.close();
      if (command.act) command.act();
      else this.controls.press(command.id);
    });
    item.append(button);
    return item;
  }

  first() {
    const button = this.list.querySelector("button");
    if (button !== null) button.click();
  }
}
