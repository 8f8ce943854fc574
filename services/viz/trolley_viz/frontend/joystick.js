// The joystick. What is held here drives the robot only as long as this says so, ten times a second;
// everything that might be a release is one.
import { follow, t } from "./words.js";

const BEAT_MS = 100, KEYS = "keys";
const ARROWS = { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };
const MARKUP = `
<button class="hand-open" type="button" aria-label="Drive by hand" aria-expanded="false">
  <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 3l3 4h-6zM12 21l-3-4h6zM3 12l4-3v6zM21 12l-4 3v-6z"/><circle cx="12" cy="12" r="3"/></svg>
  <span>Drive by hand</span>
</button>
<div class="hand-card" hidden>
  <button class="hand-close" type="button" aria-label="Close the joystick">×</button>
  <div class="hand-pad" role="application" tabindex="0"
    aria-label="Joystick: drag it, or hold the arrow keys">
    <i class="up"></i><i class="right"></i><i class="down"></i><i class="left"></i>
    <div class="hand-knob"></div>
  </div>
  <div class="hand-side">
    <label>Speed <output aria-live="off"></output>
      <input type="range" min="0.05" max="0.25" step="0.05" value="0.25" aria-label="Speed">
    </label>
    <p class="hand-say" role="status"></p>
  </div>
</div>`;

export class Joystick {
  constructor(root, line) {
    this.line = line;
    root.innerHTML = MARKUP;
    follow(root);
    const find = (name) => root.querySelector(name);
    this.button = find(".hand-open");
    this.card = find(".hand-card");
    this.pad = find(".hand-pad");
    this.knob = find(".hand-knob");
    this.slider = find("input");
    this.speed = find("output");
    this.words = find(".hand-say");
    this.pointer = this.timer = null; // what holds it: a pointer, or the keys
    this.keys = new Set(); // the arrows that are held
    this.x = this.y = 0;
    this.can = this.isMine = false;
    this.button.addEventListener("click", () => this.toggle());
    find(".hand-close").addEventListener("click", () => this.setOpen(false));
    this.slider.addEventListener("input", () => this.show());
    this.pad.addEventListener("pointerdown", (event) => this.press(event));
    this.pad.addEventListener("pointermove", (event) => this.isHeldBy(event) && this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      this.pad.addEventListener(name, (event) => this.isHeldBy(event) && this.release());
    }
    this.pad.addEventListener("keydown", (event) => this.key(event, true));
    this.pad.addEventListener("keyup", (event) => this.key(event, false));
    this.pad.addEventListener("blur", () => this.pointer === KEYS && this.release());
    this.pad.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("blur", () => this.release());
    addEventListener("pagehide", () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
    this.show();
  }

  isHeldBy(event) {
    return event.pointerId === this.pointer;
  }

  toggle() {
    if (this.button.offsetParent === null) return; // who may only look has none
    this.setOpen(this.card.hidden);
  }

  setOpen(wanted) {
    this.release();
    this.button.setAttribute("aria-expanded", String(wanted));
    this.card.hidden = !wanted;
    document.body.classList.toggle("by-hand", wanted);
    (wanted ? this.pad : this.button).focus({ preventScroll: true });
  }

  // What opens where the pad is, as on a phone, is what its person wants to see now.
  giveWay(opened) {
    const [pad, other] = [this.card, opened].map((one) => one.getBoundingClientRect());
    const isApart = other.right <= pad.left || pad.right <= other.left
      || other.bottom <= pad.top || pad.bottom <= other.top;
    if (!this.card.hidden && !isApart) this.setOpen(false);
  }

  take(told) {
    this.can = told.can;
    this.isMine = told.mine;
    if (told.max_speed > 0 && Number(this.slider.max) !== told.max_speed) {
      this.slider.max = told.max_speed;
    }
    this.tell(told.text, told.tone);
    this.show();
  }

  lose() {
    this.can = this.isMine = false;
    this.release();
    this.tell(t("No connection to the viewer."), "bad");
    this.show();
  }

  tell(text, tone) {
    this.words.textContent = text;
    this.words.dataset.tone = tone;
  }

  show() {
    this.button.disabled = !this.line.isOpen;
    this.card.classList.toggle("hand-off", !this.can);
    this.card.classList.toggle("hand-held", this.pointer !== null && this.isMine);
    this.speed.textContent = `${Number(this.slider.value).toFixed(2)} m/s`;
    this.slider.setAttribute("aria-valuetext", this.speed.textContent);
  }

  press(event) {
    if (this.pointer !== null || !this.can || event.button !== 0) return;
    event.preventDefault();
    this.pad.setPointerCapture(event.pointerId);
    this.pointer = event.pointerId;
    this.move(event);
    this.hold();
  }

  hold() {
    this.send();
    this.timer = setInterval(() => this.send(), BEAT_MS);
    this.show();
  }

  // A key that was held before, as through a stop, has to be pressed again. Any other key lets go of
  // the arrows: a Mac does not tell of keys that come up while Command is held, nor does Firefox
  // while its menu bar is open, as after Alt or F10.
  key(event, isDown) {
    const isArrow = event.key in ARROWS;
    if (isArrow) event.preventDefault();
    if (event.metaKey || (isDown && !isArrow)) return this.pointer === KEYS && this.release();
    if (!isArrow) return;
    if (event.repeat || (this.pointer !== null && this.pointer !== KEYS)) return;
    if (!isDown) this.keys.delete(event.key);
    else if (this.can) this.keys.add(event.key);
    if (this.keys.size === 0) return this.release();
    const [right, up] = [0, 1].map((i) =>
      [...this.keys].reduce((sum, key) => sum + ARROWS[key][i], 0));
    this.lean(right, up);
    if (this.pointer === KEYS) return;
    this.pointer = KEYS;
    this.hold();
  }

  move(event) {
    const box = this.pad.getBoundingClientRect(), radius = box.width / 2;
    const reach = radius - this.knob.offsetWidth / 2;
    this.lean((event.clientX - box.left - radius) / reach, (box.top + radius - event.clientY) / reach);
  }

  lean(right, up) {
    const reach = 0.5 * (this.pad.clientWidth - this.knob.offsetWidth);
    const length = Math.max(1, Math.hypot(right, up));
    this.x = right / length;
    this.y = up / length;
    this.knob.style.transform = `translate(${this.x * reach}px, ${-this.y * reach}px)`;
  }

  release() {
    if (this.pointer === null) return;
    this.pointer = null;
    this.keys.clear();
    clearInterval(this.timer);
    this.x = this.y = 0;
    this.knob.style.transform = "";
    this.send();
    this.show();
  }

  send() {
    const { x, y } = this, held = this.pointer !== null;
    this.line.say("grip", {
      x, y, held, speed: Number(this.slider.value), sent_ms: performance.now(),
    });
  }
}
