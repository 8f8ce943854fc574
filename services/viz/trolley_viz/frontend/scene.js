// viser's scene, in a frame of its own: finds out whose it is, hides its controls, and tells of
// what a pointer does there. What is pressed counts as let go only if its own pointer comes up,
// alone, while the page has the focus.

const LOOK_MS = 100, LOADING_MS = 180000, GIVEN_UP_MS = 8000, LOST_MS = 3000;
const LOST_AGAIN_MS = 60000;
const TAP_PX = 12, TAP_MS = 700, PASSED_ON = ["fixedDpr"];
const HIDDEN = `
[data-dock-region], .mantine-Paper-root, .mantine-Notifications-root { display: none !important }
canvas:focus-visible { outline: 3px solid #2f74ff; outline-offset: -3px }`;

function canDraw() {
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext(); // a browser has but a few
  return context !== null;
}

export class Scene {
  constructor(frame, line) {
    this.frame = frame;
    this.line = line;
    this.hasSession = false;
    this.loadedMs = 0;
    this.patienceMs = GIVEN_UP_MS;
    this.told = "";
    this.toldSize = ""; // width and height of the picture [px], as the viewer knows them
    this.held = null; // the pointer that presses: its id and kind
    this.failures = 0;
    this.drawnMs = 0;
    this.redrawnMs = -Infinity; // when it was last loaded anew for a picture that was lost
    this.opened = () => {};
    this.waits = () => {}; // told why there is no picture
    this.tapped = () => {};
    frame.addEventListener("load", () => this.loaded());
    setInterval(() => this.look(), LOOK_MS);
  }

  get canvas() {
    return this.frame.contentDocument?.querySelector("canvas[data-engine]") ?? null;
  }

  // A browser takes back what it draws with where it is short of it, and may not return it.
  get isLost() {
    return this.canvas?.getContext("webgl2")?.isContextLost() ?? false;
  }

  look() {
    const now = performance.now();
    if (document.hidden) this.drawnMs = now;
    // Out of sight nothing is drawn, however often it is loaded.
    if (document.hidden || !this.line.isOpen) return;
    if (this.loadedMs === 0) return this.load();
    if (!this.hasSession || !this.isLost) this.drawnMs = now;
    if (now - this.drawnMs > LOST_MS && now - this.redrawnMs > LOST_AGAIN_MS) {
      this.redrawnMs = now;
      return this.load();
    }
    if (this.hasSession) {
      this.letFocus();
      if (this.failures > 0) this.waits("loading"); // should there be no picture later
      this.failures = 0;
      return this.tellSize();
    }
    const secret = this.frame.contentDocument?.getElementById("trolley-scene")?.dataset.secret;
    if (secret !== undefined && secret !== this.told) {
      this.told = secret;
      this.loadedMs = now;
      this.line.say("say", { scene: secret });
      this.toldSize = "";
      this.tellSize();
    } else if (now - this.loadedMs > this.patienceMs) {
      this.failures += 1;
      this.loadedMs = now;
      if (!canDraw()) return this.waits("no webgl"); // it may be able to later
      this.waits(this.failures > 1 ? "failing" : "loading");
      this.load();
    }
  }

  load() {
    const url = new URL("/scene/", location.href), socket = new URL("/scene/", location.href);
    socket.protocol = socket.protocol === "https:" ? "wss:" : "ws:";
    const asked = new URLSearchParams(location.search);
    for (const name of PASSED_ON) if (asked.has(name)) url.searchParams.set(name, asked.get(name));
    url.searchParams.set("websocket", socket.href);
    this.loadedMs = this.drawnMs = performance.now();
    this.patienceMs = LOADING_MS; // over a thin link it takes most of a minute
    this.told = "";
    this.frame.src = url.href;
  }

  loaded() {
    const inside = this.frame.contentWindow;
    if (inside.location.pathname !== "/scene/") return;
    this.loadedMs = performance.now();
    this.patienceMs = GIVEN_UP_MS;
    const style = inside.document.createElement("style");
    style.textContent = HIDDEN;
    inside.document.head.append(style);
    const on = (target, name, action) => target.addEventListener(name, action, { capture: true });
    on(inside, "pointerdown", (event) => this.press(event));
    on(inside, "pointerup", (event) => this.letGo(event));
    on(inside, "pointercancel", (event) => event.pointerId === this.held?.id && this.cancel());
    on(inside, "keydown", (event) => event.key === "Escape" && this.cancel());
    // A finger that rests for a moment asks for this menu, too, and means nothing by it.
    on(inside, "contextmenu", () => this.held?.kind === "mouse" && this.cancel());
    on(inside, "blur", (event) => event.target === inside && this.cancel());
    on(inside, "pagehide", () => this.cancel());
    on(document, "visibilitychange", () => document.hidden && this.cancel());
    this.opened(inside);
  }

  press(event) {
    if (this.held !== null) this.cancel(); // a second finger
    else if (event.button === 0) {
      const { pointerId: id, pointerType: kind, clientX: x, clientY: y, timeStamp: ms } = event;
      this.held = { id, kind, x, y, ms };
    }
  }

  // Its keys turn and move the picture: what has the focus is seen, and has a name.
  letFocus() {
    if (this.canvas === null) return;
    this.canvas.tabIndex = 0;
    this.canvas.ariaLabel = this.frame.title;
  }

  // viser's picture follows the size of the frame some time later.
  tellSize() {
    const canvas = this.canvas;
    if (canvas === null) return;
    const size = [canvas.clientWidth, canvas.clientHeight];
    if (String(size) === this.toldSize) return;
    this.toldSize = String(size);
    this.say({ size });
  }

  // Shares of the picture as viser counts them: to the middle of the pixel.
  letGo(event) {
    if (this.held === null || event.pointerId !== this.held.id) return;
    const { x, y, ms } = this.held, canvas = this.canvas;
    this.held = null;
    if (canvas === null) return;
    const box = canvas.getBoundingClientRect();
    const u = (event.clientX - box.left + 0.5) / canvas.clientWidth;
    const v = (event.clientY - box.top + 0.5) / canvas.clientHeight;
    const isNear = Math.hypot(event.clientX - x, event.clientY - y) < TAP_PX;
    const isTap = isNear && event.timeStamp - ms < TAP_MS;
    if (isTap) this.tapped(event.clientX, event.clientY);
    this.tellSize(); // by which the viewer knows what lies there
    this.say({ released: [u, v], is_tap: isTap });
  }

  cancel() {
    if (this.held === null) return;
    this.held = null;
    this.say({ cancelled: true });
  }

  // What is let go after the connection was lost counts for nothing, also when it is back; nor is
  // it known what the viewer still heard.
  lose() {
    this.held = null;
    this.toldSize = "";
  }

  say(gesture) {
    this.line.gesture(gesture);
  }
}
