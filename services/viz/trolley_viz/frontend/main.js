// The page: what the viewer tells goes to its parts, what is pressed goes to the viewer.
import { Line } from "./line.js";
import { Controls } from "./controls.js";
import { Scene } from "./scene.js";
import { Joystick } from "./joystick.js";
import { Overlays } from "./overlays.js";
import { Notices } from "./notices.js";
import { Keys } from "./keys.js";
import { Room } from "./room.js";
import { countOnce } from "./pressing.js";
import { Sheet } from "./sheet.js";
import { Status } from "./status.js";
import { deviceLanguage, follow, likelyLanguage, speak, t } from "./words.js";

follow(document.documentElement);
const notices = new Notices(document.getElementById("notices"));
const status = new Status(() => line);
const line = new Line(told, changed);
const controls = new Controls(
  document.getElementById("controls"), document.getElementById("over"), line, notices,
);
const scene = new Scene(document.getElementById("scene"), line);
const joystick = new Joystick(document.getElementById("hand"), line);
controls.opened = (element) => joystick.giveWay(element);
const overlays = new Overlays(document.getElementById("overlays"), line);
const keys = new Keys(status, controls, joystick);
new Sheet(document.getElementById("panel"), document.getElementById("handle"));
const room = new Room(
  ...["map", "scene", "over", "stop-line"].map((id) => document.getElementById(id)),
);
keys.listenTo(document);
const pressedInside = countOnce(document);
scene.waits = (why) => {
  for (const one of document.querySelectorAll("#scene-wait p")) one.hidden = one.dataset.why !== why;
};
// Before viser, which turns the picture by the arrow keys.
scene.opened = (frame) => keys.listenTo(frame.document, { capture: true });
scene.tapped = (x, y) => {
  const { left, top } = scene.frame.getBoundingClientRect();
  pressedInside(left + x, top + y, performance.now());
  room.touch(x, y);
};
speakNow(likelyLanguage());

const stop = document.getElementById("stop");
let pressedBy = null; // the pointer, if it was this that it pressed last
addEventListener("pointerdown", () => { pressedBy = null; }, true);
// As soon as it is touched: a finger that slides, or that comes beside another, makes no click.
stop.addEventListener("pointerdown", ({ pointerId }) => {
  pressedBy = pointerId;
  status.stop();
});
// Keys and screen readers click without any pointer.
stop.addEventListener("click", ({ pointerId }) => pointerId === pressedBy || status.stop());
document.getElementById("resume").addEventListener("click", async () => {
  const answer = await line.ask("resume", { robot: status.robot });
  if (!answer.is_done) notices.show({ title: t("It cannot drive on"), text: t(answer.text), tone: "warn" });
});

function told(message) {
  const { hello, state, controls: changes, pad, overlays: shown, notice, file } = message;
  if (hello !== undefined) welcome(hello);
  if (state !== undefined) {
    speakNow(state.language);
    status.show(state);
    document.body.classList.toggle("set-up", Boolean(state.is_set_up));
    scene.hasSession = state.has_scene;
    document.getElementById("scene-wait").hidden = state.has_scene;
  }
  if (changes !== undefined) {
    controls.take(changes);
    if (changes.commands) keys.commands = changes.commands;
  }
  if (pad !== undefined) joystick.take(pad);
  if (shown !== undefined) overlays.take(shown);
  if (notice !== undefined) notices.show(notice);
  if (file !== undefined) save(file);
}

async function speakNow(code) {
  if (await speak(code)) controls.speak();
  if (line.state !== "loading") status.changed(line.state);
}

// A page of another build does not know what this viewer says.
function welcome(hello) {
  const build = document.querySelector("meta[name=build]").content;
  if (hello.build !== build) {
    if (isFirstFor(hello.build)) location.reload();
    else notices.show({ title: t("This page is out of date"), tone: "warn",
      text: t("The page and the viewer are of different releases. Reload the page, bypassing the cache if necessary.") });
  }
  document.body.classList.toggle("only-looks", !hello.may_drive);
  sayLook();
  const { timeZone } = Intl.DateTimeFormat().resolvedOptions();
  line.say("say", { language: deviceLanguage(), time_zone: timeZone });
  controls.forget();
}

// Whether the page was not loaded anew yet for this build; once has to do, whatever a cache says.
function isFirstFor(build) {
  try {
    if (sessionStorage.getItem("reloaded-for") === build) return false;
    sessionStorage.setItem("reloaded-for", build);
    return true;
  } catch {
    return false; // a browser that keeps nothing
  }
}

const dark = matchMedia("(prefers-color-scheme: dark)");
const sayLook = () => line.say("say", { prefers_dark: dark.matches });
dark.addEventListener("change", sayLook);
document.documentElement.dataset.look = dark.matches ? "dark" : "light"; // until the viewer says
addEventListener("languagechange", () => line.say("say", { language: deviceLanguage() }));

function changed(state) {
  document.body.dataset.line = state;
  // Not all of the map: there is a main part in any state.
  for (const id of ["scene", "overlays", "over", "panel"]) {
    document.getElementById(id).inert = state !== "open";
  }
  status.changed(state);
  if (state === "open") {
    joystick.show();
    scene.look();
  } else {
    joystick.lose();
    scene.lose();
  }
  if (state === "lost") overlays.lose();
}

function save({ name, text }) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
