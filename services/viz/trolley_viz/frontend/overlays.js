// The overlays. What they hold is made, and made safe, by the viewer; this puts it in its place, and
// says what was clicked.
import { fill } from "./html.js";

const COLUMNS = [["top-left", "left", "bottom-left"], ["top", "bottom"],
  ["top-right", "right", "bottom-right"]];

export class Overlays {
  constructor(root, line) {
    this.root = root;
    this.line = line;
    this.cards = new Map(); // by the overlay's name: its elements
    this.isPressed = false;
    this.waiting = null;
    for (const [index, places] of COLUMNS.entries()) {
      const column = document.createElement("div");
      column.className = "ov-column";
      column.dataset.column = ["left", "middle", "right"][index];
      for (const place of places) {
        const slot = document.createElement("div");
        slot.className = "ov-slot";
        slot.dataset.place = place;
        column.append(slot);
      }
      root.append(column);
    }
    root.addEventListener("click", (event) => this.clicked(event));
    root.addEventListener("pointerdown", () => (this.isPressed = true));
    for (const name of ["pointerup", "pointercancel", "blur"]) {
      addEventListener(name, () => this.released());
    }
  }

  // A card that is replaced between press and release would lose the click.
  take(told) {
    if (this.isPressed && this.waiting !== null) {
      Object.assign(told.cards, { ...this.waiting.cards, ...told.cards });
    }
    if (this.isPressed) {
      this.waiting = told;
      return;
    }
    for (const [name, card] of Object.entries(told.cards)) this.put(name, card);
    this.arrange(told.order);
    this.root.dataset.note = told.note;
    this.root.dataset.choose = String(told.may_choose);
  }

  put(name, wanted) {
    if (!this.cards.has(name)) this.cards.set(name, newCard(name));
    const { card, head, body } = this.cards.get(name);
    card.dataset.kind = wanted.kind;
    card.dataset.place = wanted.place;
    card.style.cssText = wanted.style;
    fill(head, wanted.head);
    fill(body, wanted.body);
    card.classList.toggle("ov-troubled", body.querySelector("[data-trouble]") !== null);
  }

  arrange(order) {
    for (const [name, { card }] of this.cards) {
      if (order.includes(name)) continue;
      card.remove();
      this.cards.delete(name);
    }
    for (const slot of this.root.querySelectorAll(".ov-slot")) {
      const mine = order.map((name) => this.cards.get(name).card)
        .filter((card) => card.dataset.place === slot.dataset.place);
      const here = [...slot.children];
      if (mine.length !== here.length || mine.some((card, i) => card !== here[i])) {
        slot.replaceChildren(...mine);
      }
    }
  }

  clicked(event) {
    const card = event.target.closest(".ov-card");
    if (card === null) return;
    const id = card.dataset.name, item = event.target.closest("[data-index]");
    if (item !== null) this.line.say("say", { overlay: { id, index: Number(item.dataset.index) } });
    else if (event.target.closest(".ov-csv") !== null) {
      this.line.say("say", { overlay: { id, csv: true } });
    }
  }

  released() {
    this.isPressed = false;
    const late = this.waiting;
    this.waiting = null;
    // After the click, which comes after the release.
    if (late !== null) setTimeout(() => this.take(late), 0);
  }

  lose() {
    for (const { card } of this.cards.values()) card.classList.add("ov-troubled");
  }
}

function newCard(name) {
  const card = document.createElement("div");
  const head = document.createElement("div"), body = document.createElement("div");
  card.className = "ov-card";
  card.dataset.name = name;
  card.append(head, body);
  return { card, head, body };
}
