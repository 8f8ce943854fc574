// The controls, drawn as the viewer says. What is pressed goes there with its time; what is refused
// is said, and a field shows again what holds.
import { letMove } from "./dragging.js";
import { fill } from "./html.js";
import { keepScreenOn } from "./screen.js";
import { t } from "./words.js";

const TYPING_MS = 300, HOLD_MS = 200, OVER_MAP = ["bar", "card", "strip"];

export class Controls {
  constructor(root, over, line, notices) {
    this.root = root;
    this.over = over;
    this.line = line;
    this.notices = notices;
    this.all = new Map(); // by id: what is drawn
    this.told = new Map(); // by id: how the viewer said last that it looks
    this.unsent = new Map(); // by id: what was typed and not said yet, and its timer
    this.opened = () => {}; // is given what has opened over the map
  }

  // The next changes bring everything anew.
  forget() {
    this.isNew = true;
  }

  // Names that the page gives by itself follow its language.
  speak() {
    for (const drawn of this.all.values()) drawn.speak?.();
  }

  take({ looks = {}, gone = [] }) {
    if (this.isNew) {
      for (const id of this.all.keys()) if (!(id in looks)) this.drop(id);
      this.isNew = false;
    }
    for (const id of gone) this.drop(String(id));
    const opening = Object.keys(looks).filter((id) => OVER_MAP.includes(looks[id].kind)
      && !looks[id].is_hidden && (this.all.get(id)?.look.is_hidden ?? true));
    for (const [id, look] of Object.entries(looks)) this.put(id, look);
    for (const [id, look] of Object.entries(looks)) this.place(id, look);
    for (const id of opening) this.opened(this.all.get(id).element);
  }

  drop(id) {
    const drawn = this.all.get(id);
    if (drawn === undefined) return;
    this.all.delete(id);
    this.told.delete(id);
    clearTimeout(this.unsent.get(id)?.timer);
    this.unsent.delete(id);
    drawn.element.remove();
    if (drawn.tab) drawn.tab.remove();
  }

  put(id, look) {
    let drawn = this.all.get(id);
    if (drawn !== undefined && drawn.look.kind !== look.kind) {
      this.drop(id); // another viewer's, whose number means something else
      drawn = undefined;
    }
    if (drawn === undefined) {
      drawn = MAKERS[look.kind](this, id);
      drawn.element.classList.add("control", look.kind);
      drawn.speak?.();
      this.all.set(id, drawn);
    }
    const before = drawn.look || {};
    this.told.set(id, look);
    // What comes before its answer was said before the press was heard, which holds against it.
    if (drawn.numAsked > 0) look = { ...look, value: before.value };
    drawn.look = look;
    drawn.element.hidden = Boolean(look.is_hidden);
    drawn.show(look, before);
  }

  // Among its brothers by order, then by id: in the order in which they were made.
  place(id, look) {
    const drawn = this.all.get(id);
    const parent = this.all.get(String(look.parent || 0));
    const box = parent?.box ?? (OVER_MAP.includes(look.kind) ? this.over : this.root);
    const rank = [look.order || 0, Number(id)];
    drawn.element.rank = rank;
    const next = [...box.children].find((one) => one !== drawn.element && one.rank
      && (one.rank[0] > rank[0] || (one.rank[0] === rank[0] && one.rank[1] > rank[1])));
    if (drawn.element.parentElement !== box || drawn.element.nextElementSibling !== (next || null)) {
      box.insertBefore(drawn.element, next || null);
    }
    if (parent?.added) parent.added(drawn, id);
  }

  async press(id, value = null) {
    this.sendTyped();
    const drawn = this.all.get(String(id));
    // What is there from now on: what is told later is compared with it.
    const holdsValue = drawn !== undefined && "value" in drawn.look;
    if (holdsValue) {
      drawn.look = { ...drawn.look, value };
      drawn.numAsked = (drawn.numAsked || 0) + 1;
    }
    const answer = await this.line.ask("press", { control: Number(id), value });
    if (holdsValue) drawn.numAsked -= 1;
    if (answer.is_done) {
      // What it has taken holds until it tells something else.
      const told = this.told.get(String(id));
      if (told !== undefined && "value" in told) this.told.set(String(id), { ...told, value });
      return;
    }
    const title = answer.is_unknown ? t("No answer") : t("Not done");
    this.notices.show({ title, text: t(answer.text), tone: "warn" });
    if (this.all.has(String(id))) this.put(String(id), this.told.get(String(id)));
  }

  // What is typed is said when the typing pauses, and before anything else that is pressed.
  typed(id, value) {
    clearTimeout(this.unsent.get(id)?.timer);
    const timer = setTimeout(() => this.sendOne(id), TYPING_MS);
    this.unsent.set(id, { value, timer });
  }

  sendTyped() {
    for (const id of [...this.unsent.keys()]) this.sendOne(id);
  }

  sendOne(id) {
    const unsent = this.unsent.get(id);
    if (unsent === undefined) return;
    clearTimeout(unsent.timer);
    this.unsent.delete(id);
    this.press(id, unsent.value);
  }
}

function make(tag, attributes = {}, ...children) {
  const element = Object.assign(document.createElement(tag), attributes);
  element.append(...children);
  return element;
}

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function setIcon(icon, name) {
  icon.hidden = !name;
  if (name) icon.style.setProperty("--icon", `url("/page/icon/${encodeURIComponent(name)}.svg")`);
}

// The options of a list with what stands for each, in the language of the page.
function named({ options = [], shown = [] }) {
  return options.map((option, i) => [option, shown[i] ?? option]);
}

function haveChanged(look, before) {
  return String(named(before)) !== String(named(look));
}

// The value of a slider, which a screen reader tells of the slider itself.
const newOutput = () => make("output", { ariaLive: "off" });

const newIcon = () => make("i", { className: "icon", ariaHidden: "true" });

// A field with its label before it, and what says more behind.
function field(id, input) {
  const label = make("label", { htmlFor: `control-${id}` });
  const hint = make("small", { id: `hint-${id}`, hidden: true });
  input.id = `control-${id}`;
  input.setAttribute("aria-describedby", hint.id);
  const element = make("div", {}, label, input, hint);
  return {
    element,
    name(look) {
      setText(label, look.label || "");
      setText(hint, look.hint || "");
      hint.hidden = !look.hint;
      input.disabled = Boolean(look.is_disabled);
    },
  };
}

function plainBox() {
  const element = make("div");
  return { element, box: element, show: () => {} };
}

const MAKERS = {
  html(controls, id) {
    const element = make("div");
    element.addEventListener("click", (event) => {
      const lead = event.target.closest("button[data-press]");
      if (lead !== null) controls.press(id, lead.dataset.press);
    });
    return { element, show: (look) => fill(element, look.content || "") };
  },

  button(controls, id) {
    const icon = newIcon(), text = make("span");
    const grip = make("span", { className: "grip", ariaHidden: "true", hidden: true });
    const element = make("button", { type: "button" }, icon, text, grip);
    element.addEventListener("click", () => controls.press(id));
    letMove(element, grip, (by) => controls.press(id, by));
    return {
      element,
      show(look) {
        setIcon(icon, look.icon);
        setText(text, look.label || "");
        text.translate = !look.is_name;
        grip.hidden = !look.can_move;
        if (look.can_move) element.setAttribute("aria-keyshortcuts", "Alt+ArrowUp Alt+ArrowDown");
        element.dataset.colour = look.colour || "grey";
        // What is cut off, or not shown at all, can be read there.
        if (look.is_name || element.parentElement?.matches(".bar, .strip")) element.title = look.label;
        element.disabled = Boolean(look.is_disabled);
      },
    };
  },

  // Says that the page is in sight; who locks the screen or looks at something else has let go.
  hold(controls, id) {
    const element = make("div"), timer = setInterval(() => {
      const isInSight = element.isConnected && !document.hidden
        && element.closest("[hidden]") === null;
      if (isInSight) controls.line.hold(Number(id));
      keepScreenOn(isInSight && controls.line.isOpen);
      if (!element.isConnected) clearInterval(timer);
    }, HOLD_MS);
    return { element, show: () => {} };
  },

  choice(controls, id) {
    const label = make("span", { className: "label", id: `control-${id}` }), row = make("div");
    const element = make("div", { role: "group" }, label, row);
    element.setAttribute("aria-labelledby", label.id);
    return {
      element,
      show(look, before) {
        setText(label, look.label || "");
        if (haveChanged(look, before)) {
          row.replaceChildren(...named(look).map(([option, text]) => {
            const button = make("button", { type: "button", textContent: text });
            button.addEventListener("click", () => controls.press(id, option));
            return button;
          }));
        }
        const { options = [], off = [] } = look;
        for (const [i, button] of [...row.children].entries()) {
          button.disabled = Boolean(look.is_disabled) || off.includes(options[i]);
        }
      },
    };
  },

  check(controls, id) {
    const input = make("input", { type: "checkbox" }), text = make("span");
    const element = make("label", {}, input, text);
    input.addEventListener("change", () => controls.press(id, input.checked));
    return {
      element,
      show(look, before) {
        setText(text, look.label || "");
        element.title = look.hint || "";
        input.disabled = Boolean(look.is_disabled);
        if (before.value !== look.value) input.checked = Boolean(look.value);
      },
    };
  },

  text(controls, id) {
    const input = make("input", { type: "text", autocomplete: "off", maxLength: 10000 });
    const { element, name } = field(id, input);
    input.addEventListener("input", () => controls.typed(id, input.value));
    input.addEventListener("change", () => controls.sendOne(id));
    return {
      element,
      show(look, before) {
        name(look);
        if (before.value !== look.value) input.value = look.value || "";
      },
    };
  },

  number(controls, id) {
    // Between two steps it is no less valid.
    const input = make("input", { type: "number", inputMode: "decimal", ariaInvalid: "false" });
    const { element, name } = field(id, input);
    const send = () => Number.isFinite(input.valueAsNumber)
      && controls.typed(id, input.valueAsNumber);
    input.addEventListener("input", send);
    input.addEventListener("change", () => controls.sendOne(id));
    return { element, show: (look, before) => showNumber(input, name, look, before) };
  },

  slider(controls, id) {
    const input = make("input", { type: "range" }), output = newOutput();
    const { element, name } = field(id, input);
    element.append(output);
    input.addEventListener("input", () => {
      setText(output, input.value);
      controls.typed(id, input.valueAsNumber);
    });
    return {
      element,
      show(look, before) {
        showNumber(input, name, look, before);
        setText(output, input.value);
      },
    };
  },

  list(controls, id) {
    const input = make("select");
    const { element, name } = field(id, input);
    input.addEventListener("change", () => controls.press(id, input.value));
    return {
      element,
      show(look, before) {
        name(look);
        if (haveChanged(look, before)) {
          input.replaceChildren(...named(look).map(([option, text]) =>
            make("option", { value: option, textContent: text })));
          input.value = look.value;
        } else if (before.value !== look.value) {
          input.value = look.value;
        }
      },
    };
  },

  folder(controls, id) {
    const summary = make("summary"), box = make("div", { className: "inside" });
    const element = make("details", {}, summary, box);
    let isOpen = null; // as it was last said, by either side
    element.addEventListener("toggle", () => {
      if (element.open === isOpen || element.classList.contains("bare")) return;
      isOpen = element.open;
      controls.press(id, isOpen);
    });
    return {
      element,
      box,
      show(look, before) {
        setText(summary, look.label || "");
        element.classList.toggle("bare", !look.label);
        if (!look.label) element.open = true;
        else if (before.kind === undefined || before.is_open !== look.is_open) {
          isOpen = Boolean(look.is_open);
          element.open = isOpen;
        }
      },
    };
  },

  bar() {
    const element = make("div", { role: "toolbar" });
    const speak = () => { element.ariaLabel = t("View"); };
    return { element, box: element, speak, show: () => {} };
  },

  card(controls, id) {
    const title = make("h2", { id: `control-${id}` }), box = make("div", { className: "inside" });
    const close = make("button", { type: "button", textContent: "×" });
    const element = make("section", {}, title, close, box);
    const speak = () => { close.ariaLabel = t("Close"); };
    element.setAttribute("aria-labelledby", title.id);
    close.addEventListener("click", () => controls.press(id));
    const show = (look) => {
      setText(title, look.label || "");
      element.classList.toggle("of-spot", Boolean(look.of_spot));
    };
    return { element, box, speak, show };
  },

  strip() {
    const element = make("section");
    const speak = () => { element.ariaLabel = t("Past"); };
    return { element, box: element, speak, show: () => {} };
  },

  // What it is dragged to is said as soon as what was said before is answered.
  timeline(controls, id) {
    const input = make("input", { type: "range" }), output = newOutput();
    const marks = make("div", { className: "marks", ariaHidden: "true" });
    const { element, name } = field(id, input);
    element.append(marks, output);
    let next = null, isBusy = false, isHeld = false;
    const tell = () => {
      setText(output, timeOfDay(input.valueAsNumber));
      input.setAttribute("aria-valuetext", output.textContent);
    };
    const send = async () => {
      if (isBusy) return;
      isBusy = true;
      while (next !== null) {
        const value = next;
        next = null;
        await controls.press(id, value);
      }
      isBusy = false;
    };
    input.addEventListener("pointerdown", () => { isHeld = true; });
    for (const end of ["pointerup", "pointercancel", "change"]) {
      input.addEventListener(end, () => { isHeld = false; });
    }
    input.addEventListener("input", () => {
      next = input.valueAsNumber;
      tell();
      send();
    });
    return {
      element,
      show(look, before) {
        name(look);
        if (isHeld || isBusy) return; // the thumb stays under the finger
        for (const key of ["min", "max", "step"]) input[key] = look[key];
        input.value = look.value;
        tell();
        if (JSON.stringify([look.min, look.max, look.marks])
          === JSON.stringify([before.min, before.max, before.marks])) return;
        marks.replaceChildren(...(look.marks || []).map(([at, tone]) => {
          const mark = make("i");
          mark.dataset.tone = tone;
          mark.style.left = `${100 * (at - look.min) / Math.max(look.max - look.min, 1)}%`;
          return mark;
        }));
      },
    };
  },

  tiles: plainBox,
  actions: plainBox,

  tabs(controls, self) {
    const row = make("div", { role: "tablist" }), box = make("div");
    const element = make("div", {}, row, box);
    const drawn = { element, box, open: null };
    drawn.show = (look) => drawn.choose(String(look.value));
    // What a person opens is told: what is behind is kept up to date only while it is seen.
    drawn.chosen = (id) => {
      if (drawn.open === id) return;
      drawn.choose(id);
      controls.press(self, Number(id));
    };
    drawn.choose = (id) => {
      drawn.open = id;
      for (const tab of row.children) {
        const isOpen = tab.dataset.id === id;
        tab.setAttribute("aria-selected", String(isOpen));
        tab.tabIndex = isOpen ? 0 : -1;
        const inside = document.getElementById(tab.getAttribute("aria-controls"));
        if (inside !== null) inside.hidden = !isOpen;
      }
    };
    drawn.added = (tab, id) => {
      if (tab.tab.parentElement !== row) row.append(tab.tab);
      tab.tab.onclick = () => drawn.chosen(id);
      drawn.choose(drawn.open ?? id);
    };
    row.addEventListener("keydown", (event) => {
      const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (by === undefined) return;
      event.preventDefault(); // it moves nothing else
      const tabs = [...row.children], at = tabs.indexOf(event.target);
      const next = tabs[(at + by + tabs.length) % tabs.length];
      drawn.chosen(next.dataset.id);
      next.focus();
    });
    return drawn;
  },

  tab(controls, id) {
    const icon = newIcon(), text = make("span");
    const tab = make("button", { type: "button", id: `tab-${id}`, role: "tab" }, icon, text);
    const element = make("div", { role: "tabpanel", id: `inside-${id}` });
    tab.dataset.id = id;
    tab.setAttribute("aria-controls", element.id);
    element.setAttribute("aria-labelledby", tab.id);
    return {
      element,
      box: element,
      tab,
      show(look) {
        setIcon(icon, look.icon);
        setText(text, look.label || "");
      },
    };
  },
};

function showNumber(input, name, look, before) {
  name(look);
  for (const key of ["min", "max", "step"]) {
    input[key] = look[key] === undefined ? (key === "step" ? "any" : "") : look[key];
  }
  if (before.value !== look.value) input.value = look.value;
}

// Seconds since midnight as "14:05:12".
function timeOfDay(seconds) {
  const two = (number) => String(Math.floor(number)).padStart(2, "0");
  return `${two(seconds / 3600 % 24)}:${two(seconds / 60 % 60)}:${two(seconds % 60)}`;
}
