// The life line: a socket on which viewer and page hear each other all the time. What is pressed
// carries its time and is answered; Stop is kept until it is.

const SILENCE_MS = 1500, RETRY_MS = 700, PATIENCE_MS = 4000, LOOK_MS = 150, BUSY_MS = 500;

export class Line {
  // `told` is called with each message, `changed` with "open", "lost" or "refused".
  constructor(told, changed) {
    this.told = told;
    this.changed = changed;
    this.state = "loading";
    this.key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (one) =>
      one.toString(16).padStart(2, "0")).join("");
    this.socket = null;
    this.openedMs = this.heardMs = this.lookedMs = performance.now();
    this.viewerMs = null; // the newest time that the viewer told
    this.nextId = 1;
    this.pending = new Map(); // by id: what to do with the answer
    this.stops = new Map(); // by id: what is to stop, until it is answered
    setInterval(() => this.look(), LOOK_MS);
    addEventListener("online", () => this.retry());
    addEventListener("visibilitychange", () => document.hidden || this.look());
    this.open();
  }

  get isOpen() {
    return this.state === "open";
  }

  // How long nothing has been heard [s].
  get silence() {
    return (performance.now() - this.heardMs) / 1000;
  }

  open() {
    const url = new URL("/line", location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.searchParams.set("page", this.key);
    const mine = (this.socket = new WebSocket(url));
    this.openedMs = performance.now();
    mine.onmessage = (event) => mine === this.socket && this.hear(JSON.parse(event.data));
    mine.onclose = () => mine === this.socket && this.lose();
  }

  // Connect now, as when somebody waits for it.
  retry() {
    if (!this.isOpen) this.reopen();
  }

  reopen() {
    const old = this.socket;
    this.socket = null;
    if (old !== null) old.close();
    this.open();
  }

  hear(told) {
    this.heardMs = performance.now();
    if (told.beat_ms !== undefined) this.viewerMs = told.beat_ms;
    if (told.hello !== undefined) {
      for (const [id, robots] of this.stops) this.send({ stop: { id, robots } });
      this.state = "open";
      this.changed("open");
    }
    if (told.beat_ms !== undefined) this.send({ beat_ms: told.beat_ms });
    if (told.answer !== undefined) this.settle(told.answer);
    this.told(told);
  }

  look() {
    const now = performance.now(), lastMs = this.lookedMs;
    this.lookedMs = now;
    // A page that was busy itself, as while the scene loads, hears what has come meanwhile first.
    if (now - lastMs > BUSY_MS) return;
    if (this.isOpen && now - this.heardMs > SILENCE_MS) this.lose();
    else if (!this.isOpen && now - this.openedMs > (this.isConnecting ? PATIENCE_MS : RETRY_MS)) {
      this.reopen();
    }
  }

  get isConnecting() {
    return this.socket !== null && this.socket.readyState < WebSocket.CLOSING;
  }

  lose() {
    const was = this.state, old = this.socket;
    this.socket = null;
    if (old !== null) old.close();
    for (const [, answered] of this.pending) {
      answered({ is_done: false, text: "The connection was lost before it was answered." });
    }
    this.pending.clear();
    if (was === "open") {
      this.state = "lost";
      this.changed("lost");
    } else {
      this.ask();
    }
  }

  // A socket does not say why it is refused; a page does.
  async ask() {
    try {
      const answer = await fetch("/", { method: "HEAD", redirect: "manual" });
      if (answer.status === 401 || answer.status === 403) {
        this.state = "refused";
        this.changed("refused");
      } else if (this.state === "loading") {
        this.changed("loading");
      }
    } catch {
      if (this.state === "refused") this.state = "lost";
      this.changed(this.state);
    }
  }

  settle(answer) {
    this.stops.delete(answer.id);
    const answered = this.pending.get(answer.id);
    this.pending.delete(answer.id);
    if (answered !== undefined) answered(answer);
  }

  send(said) {
    const socket = this.socket;
    if (socket !== null && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(said));
  }

  // The viewer's time now, as well as it is known here: never later than it is there.
  get now() {
    return this.viewerMs === null ? 0 : this.viewerMs + performance.now() - this.heardMs;
  }

  // Say something that needs an answer; without a connection it is dropped.
  ask_for(kind, asked) {
    const id = this.nextId++;
    if (!this.isOpen) {
      return Promise.resolve({ is_done: false, text: "There is no connection. Nothing was done." });
    }
    return new Promise((answered) => {
      this.pending.set(id, answered);
      this.send({ [kind]: { id, at_ms: this.now, ...asked } });
    });
  }

  stop(robots) {
    const id = this.nextId++;
    this.stops.set(id, robots);
    if (this.isOpen) this.send({ stop: { id, robots } });
    else this.retry();
  }

  get isStopWaiting() {
    return this.stops.size > 0;
  }
}
