// The pad in the page. What is held here drives the robot only as long as this says so, ten times a
// second; everything that might be a release is one.
function startPad(root, client) {
  if (root.dataset.started) return; // an image may be loaded twice
  root.dataset.started = "yes";
  const BEAT_MS = 100, SILENCE_MS = 1500, MAX_WAITING_BYTES = 1000;
  const find = (name) => root.querySelector(name);
  const toggle = find(".hand-open"), card = find(".hand-card"), pad = find(".hand-pad");
  const knob = find(".hand-knob"), slider = find("input"), speed = find("output");
  const say = find(".hand-say");
  const ending = new AbortController();
  let pointer = null, beat = null;
  let x = 0, y = 0, can = false, heardMs = 0;

  function show(text, tone) {
    say.textContent = text;
    say.dataset.tone = tone;
  }

  function showState() {
    card.classList.toggle("hand-off", !can);
    card.classList.toggle("hand-held", pointer !== null && can);
    speed.textContent = `${Number(slider.value).toFixed(2)} m/s`;
  }

  function send() {
    const held = pointer !== null;
    const said = { x, y, held, speed: Number(slider.value), sent_ms: performance.now() };
    // On a connection that does not get rid of what it has, more would only come late.
    connection.say(said, held ? MAX_WAITING_BYTES : Infinity);
  }

  function release() {
    if (pointer === null) return;
    pointer = null;
    clearInterval(beat);
    x = y = 0;
    knob.style.transform = "";
    send();
    showState();
  }

  function move(event) {
    const box = pad.getBoundingClientRect(), radius = box.width / 2;
    const reach = radius - knob.offsetWidth / 2;
    const right = (event.clientX - box.left - radius) / reach;
    const up = (box.top + radius - event.clientY) / reach;
    const length = Math.max(1, Math.hypot(right, up));
    x = right / length;
    y = up / length;
    knob.style.transform = `translate(${x * reach}px, ${-y * reach}px)`;
  }

  function press(event) {
    if (pointer !== null || !can || event.button !== 0) return;
    event.preventDefault();
    pad.setPointerCapture(event.pointerId);
    pointer = event.pointerId;
    move(event);
    send();
    beat = setInterval(tick, BEAT_MS);
    showState();
  }

  function tick() {
    if (connection.isGone()) return;
    if (performance.now() - heardMs > SILENCE_MS) return lose();
    send();
  }

  function take(word) {
    heardMs = performance.now();
    can = word.can;
    if (word.max_speed > 0 && Number(slider.max) !== word.max_speed) {
      slider.max = word.max_speed;
    }
    show(word.text, word.tone);
    showState();
  }

  function lose() {
    can = false;
    release();
    show("No connection to the viewer.", "bad");
    showState();
  }

  function disconnect() {
    release();
    connection.close();
    can = false;
  }

  function setOpen(wanted) {
    toggle.setAttribute("aria-expanded", String(wanted));
    card.hidden = !wanted;
    disconnect();
    show("", "idle");
    showState();
    if (wanted) connection.open();
  }

  function typed(event) {
    const into = event.target;
    const isField = into.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(into.tagName);
    const isBare = !(event.repeat || event.ctrlKey || event.metaKey || event.altKey || event.shiftKey);
    if (event.code === "KeyJ" && isBare && !isField) setOpen(card.hidden);
  }

  function end() {
    disconnect();
    ending.abort();
  }

  const connection = trolleyConnection(root, "joystick", client, {
    opened: () => {}, heard: take, lost: lose, left: end,
  });
  const on = (target, name, action) =>
    target.addEventListener(name, action, { signal: ending.signal });
  on(toggle, "click", () => setOpen(card.hidden));
  on(find(".hand-close"), "click", () => setOpen(false));
  on(document, "keydown", typed);
  on(slider, "input", showState);
  on(pad, "pointerdown", press);
  on(pad, "pointermove", (event) => event.pointerId === pointer && move(event));
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    on(pad, name, (event) => event.pointerId === pointer && release());
  }
  on(pad, "contextmenu", (event) => event.preventDefault());
  on(window, "blur", release);
  on(window, "pagehide", release);
  on(document, "visibilitychange", () => document.hidden && release());
  showState();
}
