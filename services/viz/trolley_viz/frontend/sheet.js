// On a phone the controls are a sheet over the lower part of the page, as high as it is dragged.
const STEPS = [0, 0.42, 0.82];

export class Sheet {
  constructor(panel, handle) {
    this.panel = panel;
    this.handle = handle;
    this.isDragged = false;
    this.held = null;
    this.step = 1;
    handle.addEventListener("pointerdown", (event) => this.press(event, handle));
    handle.addEventListener("pointermove", (event) => this.drag(event));
    handle.addEventListener("pointerup", (event) => this.release(event));
    handle.addEventListener("pointercancel", () => this.settle());
    handle.addEventListener("click", () => this.tap());
    handle.addEventListener("keydown", (event) => this.key(event));
    this.settle();
  }

  press(event, handle) {
    handle.setPointerCapture(event.pointerId);
    this.held = { y: event.clientY, height: this.panel.offsetHeight };
    this.isDragged = false;
  }

  drag(event) {
    if (this.held === null) return;
    const by = this.held.y - event.clientY;
    this.isDragged ||= Math.abs(by) > 6;
    this.panel.style.setProperty("--sheet", `${Math.max(0, this.held.height + by)}px`);
  }

  release() {
    if (this.held === null) return;
    const share = this.panel.offsetHeight / innerHeight;
    const nearest = STEPS.map((one) => Math.abs(one - share));
    if (this.isDragged) this.step = nearest.indexOf(Math.min(...nearest));
    this.settle();
    setTimeout(() => { this.isDragged = false; }, 0); // after the click that ends a drag
  }

  // By a finger, or by a screen reader, which presses without a pointer.
  tap() {
    if (this.isDragged) return;
    this.step = this.step === 0 ? 1 : 0;
    this.settle();
  }

  key(event) {
    const by = { ArrowUp: 1, ArrowDown: -1, Enter: this.step ? -9 : 1 }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    this.step = Math.min(Math.max(this.step + by, 0), STEPS.length - 1);
    this.settle();
  }

  settle() {
    this.held = null;
    this.panel.style.setProperty("--sheet", `${100 * STEPS[this.step]}dvh`);
    this.panel.dataset.step = String(this.step);
    this.handle.setAttribute("aria-expanded", String(this.step > 0));
  }
}
