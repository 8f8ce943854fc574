// The life line's own thread: a socket on which viewer and page hear each other all the time. Here,
// as drawing the scene may hold up the page for seconds. What is pressed carries its time and is
// answered; Stop is kept until it is.
const SILENCE_MS = 1350, RETRY_MS = 700, ASKED_MS = 1500, PATIENCE_MS = 4000, LOOK_MS = 150;
const BUSY_MS = 500, SPEAK_MS = 300;
const MAX_WAITING_BYTES = 1000;
const t = (english) => english; // the page shows it in its language
const UNANSWERED = t("The connection was lost before it was answered. Check whether it was done.");
const NOT_CONNECTED = t("There is no connection. Nothing was done.");

const key = Array.from(crypto.getRandomValues(new Uint8Array(16)), (one) =>
  one.toString(16).padStart(2, "0")).join("");
const pending = new Set(); // the numbers of what was pressed and not answered
const stops = new Map(); // by number: what is to stop, until it is answered
let state = "loading", socket = null, asking = null, viewerMs = null, isGreeted = false, opening = 0;
let openedMs = performance.now(), heardMs = openedMs, lookedMs = openedMs, saidMs = openedMs;

function open() {
  close();
  const url = new URL("/line", location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.searchParams.set("page", key);
  const mine = (socket = new WebSocket(url));
  openedMs = performance.now();
  mine.onmessage = (event) => mine === socket && hear(JSON.parse(event.data));
  mine.onclose = () => mine === socket && lose();
}

function close() {
  const old = socket;
  socket = null;
  isGreeted = false;
  if (old !== null) old.close();
  if (asking !== null) asking.abort();
  asking = null;
}

// A viewer that was lost is asked first whether it is there: browsers make sockets that fail wait, the
// longer the more often they do, Firefox up to a minute. Where nothing comes back at all, it is called
// all the same: photos that hang take all six connections that a browser has for it, beside sockets.
function reopen() {
  close();
  openedMs = performance.now();
  ask((asking = new AbortController()));
}

function isCalling() {
  return asking !== null || (socket !== null && socket.readyState < WebSocket.CLOSING);
}

function hear(told) {
  heardMs = performance.now();
  if (told.beat_ms !== undefined) viewerMs = told.beat_ms;
  if (told.hello !== undefined) {
    for (const [id, robots] of stops) send({ stop: { id, robots } });
    isGreeted = true;
  }
  if (told.beat_ms !== undefined) send({ beat_ms: told.beat_ms });
  if (told.answer !== undefined) settle(told.answer);
  delete told.answer;
  delete told.beat_ms;
  if (Object.keys(told).length > 0) postMessage({ told });
  if (isGreeted && told.state !== undefined && state !== "open") become("open");
}

function look() {
  const now = performance.now(), lastMs = lookedMs;
  lookedMs = now;
  // A viewer that is late with its own beats is to know all the same that the page is there.
  if (isGreeted && now - saidMs > SPEAK_MS) send({ beat_ms: viewerMs ?? 0 });
  // A computer that slept hears first what has come meanwhile.
  if (now - lastMs > BUSY_MS) return;
  if (state === "open") return now - heardMs > SILENCE_MS && lose();
  const waitedMs = now - (isGreeted ? heardMs : openedMs);
  if (asking !== null) return waitedMs > ASKED_MS && open();
  if (waitedMs > (isCalling() ? PATIENCE_MS : RETRY_MS)) reopen();
}

function lose() {
  close();
  for (const id of pending) settle({ id, is_done: false, is_unknown: true, text: UNANSWERED });
  become(state === "open" ? "lost" : state);
}

// A socket does not say why it is refused; a page does.
async function ask(mine) {
  let status = 0; // as long as nobody has answered
  try {
    ({ status } = await fetch("/", { method: "HEAD", redirect: "manual", signal: mine.signal }));
  } catch { /* it is not there */ }
  if (mine !== asking) return;
  asking = null;
  if (status === 200) open();
  else if (status === 401 || status === 403) become("refused");
  else become(state === "refused" ? "lost" : state);
}

function become(now) {
  state = now;
  if (now === "open") opening++;
  postMessage({ state, opening, silentMs: performance.now() - heardMs });
}

function settle(answer) {
  pending.delete(answer.id);
  stops.delete(answer.id);
  postMessage({ answer });
}

function send(said) {
  if (socket === null || socket.readyState !== WebSocket.OPEN) return;
  saidMs = performance.now();
  socket.send(JSON.stringify(said));
}

// The viewer's time some while ago, as well as it is known here: never later than it is there.
function viewerTime(ageMs) {
  return viewerMs === null ? 0 : viewerMs + performance.now() - heardMs - ageMs;
}

// Whether the page shows what this viewer told it: one that comes back may be another, with other
// controls under the same numbers. What is pressed before the page knows it is dropped.
function isSeen(seen) {
  return state === "open" && seen === opening;
}

const DOES = {
  // Something that needs an answer; without a connection it is dropped.
  ask({ kind, id, asked, ageMs }, seen) {
    if (!isSeen(seen)) return settle({ id, is_done: false, text: NOT_CONNECTED });
    pending.add(id);
    send({ [kind]: { id, at_ms: viewerTime(ageMs), ...asked } });
  },
  stop({ id, robots }) {
    stops.set(id, robots);
    if (isGreeted) send({ stop: { id, robots } });
    else if (!isCalling()) reopen(); // to begin anew would only take longer
  },
  gesture({ ageMs, ...gesture }, seen) {
    if (isSeen(seen)) send({ gesture: { at_ms: viewerTime(ageMs), ...gesture } });
  },
  grip(grip, seen) {
    if (grip.held && !isSeen(seen)) return;
    // On a connection that does not get rid of what it has, more would only come late.
    if (grip.held && socket !== null && socket.bufferedAmount > MAX_WAITING_BYTES) return;
    send({ grip });
  },
  hold({ ageMs, control }, seen) {
    const isStuck = socket !== null && socket.bufferedAmount > MAX_WAITING_BYTES;
    if (isSeen(seen) && !isStuck) send({ hold: { at_ms: viewerTime(ageMs), control } });
  },
  say: send,
  retry() {
    if (state !== "open") reopen();
  },
};

onmessage = ({ data: [name, said, seen] }) => DOES[name](said, seen);
addEventListener("online", DOES.retry);
setInterval(look, LOOK_MS);
open();
