// What the robot is doing, what became of Stop, and what is known when nothing is heard.
import { t } from "./words.js";

const SENDING_MS = 400;
const LONG = 66; // characters that fit into two lines on a phone

export class Status {
  constructor(line) {
    this.line = line;
    this.state = null;
    this.pressedMs = null;
    const at = (id) => document.getElementById(id);
    this.title = at("title");
    this.sentence = at("sentence");
    this.spoken = at("spoken");
    this.announced = "";
    this.lines = at("lines");
    this.hint = at("hint");
    this.stopLine = at("stop-line");
    this.resume = at("resume");
    this.lost = at("lost");
    this.lostSaid = at("lost-said");
    this.lostDoes = at("lost-does");
    setInterval(() => this.tick(), 250);
  }

  get robot() {
    return this.state === null ? "" : this.state.robot;
  }

  show(state) {
    this.state = state;
    document.title = `${state.title}: ${state.sentence.headline}`;
    say(this.title, state.title);
    this.tell(state.sentence.headline);
    this.sentence.dataset.tone = state.sentence.tone;
    this.lines.replaceChildren(...state.lines.map(lineItem));
    say(this.hint, state.hint || "");
    this.hint.hidden = !state.hint;
    document.documentElement.dataset.look = state.dark ? "dark" : "light";
    this.resume.dataset.lit = String(Boolean(state.is_stopped));
    this.offerResume(this.line().state);
    this.tick();
  }

  // For screen readers: what is new, but not each metre that it has come nearer.
  announce(headline) {
    const kind = headline.replace(/\d+/g, "");
    if (kind === this.announced) return;
    this.announced = kind;
    say(this.spoken, headline);
  }

  stop() {
    this.pressedMs = performance.now();
    this.line().stop(this.state === null ? [] : [this.state.robot]);
    this.tick();
  }

  changed(state) {
    if (state === "refused") {
      this.tell(t("This page may no longer show the robot: open the link that you were given, or ask for a new one."));
    } else if (state === "loading") {
      this.tell(t("The viewer does not answer. Is it running?"));
    }
    this.offerResume(state);
    this.lost.hidden = state !== "lost";
    this.tick();
  }

  // What the robot is and whether it can be told to go on come in any order.
  offerResume(line) {
    this.resume.disabled = line !== "open" || !this.state?.is_stopped;
  }

  tell(sentence) {
    say(this.sentence, sentence);
    this.sentence.dataset.length = sentence.length > LONG ? "long" : "short";
    this.announce(sentence);
  }

  tick() {
    const line = this.line();
    const isWaiting = line.isStopWaiting;
    const stop = this.state === null ? null : this.state.stop;
    let text = "", isAlarm = false;
    if (isWaiting && (!line.isOpen || performance.now() - this.pressedMs > SENDING_MS)) {
      text = t("NOT STOPPED: no connection");
      isAlarm = true;
    } else if (isWaiting) {
      text = t("Stopping …");
    } else if (stop && line.isOpen) {
      text = stop.text;
      isAlarm = stop.is_alarm;
    } else if (this.state !== null && this.state.is_stopped && line.isOpen) {
      text = this.state.stopped_by || t("Stopped");
    }
    say(this.stopLine, text);
    this.stopLine.hidden = text === "";
    this.stopLine.dataset.alarm = String(isAlarm);
    if (!this.lost.hidden) this.sayLost(line, isWaiting);
  }

  sayLost(line, isWaiting) {
    const seconds = Math.round(line.silence);
    const time = seconds < 120 ? `${seconds} s` : `${Math.round(seconds / 60)} min`;
    say(this.lostSaid, this.state === null
      ? t("It last said: nothing yet {time} ago.", { time })
      : t("It last said: “{sentence}” {time} ago.", { sentence: this.state.sentence.headline, time }));
    say(this.lostDoes, isWaiting
      ? t("STOP will be sent first when the connection is back. If it must stop now, switch it off.")
      : t("You can still press STOP: it is sent first when the connection is back. Nothing else is sent."));
  }
}

function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function lineItem({ headline, tone, detail }) {
  const item = document.createElement("li");
  item.dataset.tone = tone;
  item.textContent = headline;
  if (detail) item.title = detail;
  return item;
}
