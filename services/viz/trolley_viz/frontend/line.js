// The page's end of the life line, which is held in a thread of its own (`line-worker.js`).

// How long ago what is handled now was done [ms]: a page that was busy hears of it late. A frame
// counts from when it was loaded itself.
function age() {
  const { event } = globalThis;
  return event === undefined ? 0 : (event.view ?? globalThis).performance.now() - event.timeStamp;
}

export class Line {
  // `told` is called with each message, `changed` with "loading", "open", "lost" or "refused".
  constructor(told, changed) {
    this.state = "loading";
    this.changed = changed;
    this.told = told;
    this.silentMs = 0;
    this.changedMs = performance.now();
    this.opening = 0; // which of the connections it has heard of
    this.nextId = 1;
    this.pending = new Map(); // by number: what to do with the answer
    this.stops = new Set(); // the numbers of those that are not answered
    this.worker = new Worker("/page/line-worker.js");
    this.worker.onmessage = ({ data }) => this.hear(data);
    addEventListener("visibilitychange", () => document.hidden || this.say("retry"));
  }

  get isOpen() {
    return this.state === "open";
  }

  get isStopWaiting() {
    return this.stops.size > 0;
  }

  // How long nothing has been heard [s], while the connection is lost.
  get silence() {
    return (this.silentMs + performance.now() - this.changedMs) / 1000;
  }

  hear({ told, answer, state, opening, silentMs }) {
    if (answer !== undefined) {
      this.stops.delete(answer.id);
      const answered = this.pending.get(answer.id);
      this.pending.delete(answer.id);
      if (answered !== undefined) answered(answer);
    }
    if (state !== undefined) {
      this.changedMs = performance.now();
      this.silentMs = silentMs;
      this.state = state;
      this.opening = opening;
      this.changed(state);
    }
    if (told !== undefined) this.told(told);
  }

  // Say something that needs an answer.
  ask(kind, asked) {
    const id = this.nextId++;
    return new Promise((answered) => {
      this.pending.set(id, answered);
      this.say("ask", { kind, id, asked, ageMs: age() });
    });
  }

  stop(robots) {
    const id = this.nextId++;
    this.stops.add(id);
    this.say("stop", { id, robots });
  }

  gesture(gesture) {
    this.say("gesture", { ageMs: age(), ...gesture });
  }

  // Say that the page is in sight.
  hold(control) {
    this.say("hold", { ageMs: age(), control });
  }

  // Any other: "grip" of the joystick, "say" what needs neither time nor answer, "retry" now.
  say(what, said) {
    this.worker.postMessage([what, said, this.opening]);
  }
}
