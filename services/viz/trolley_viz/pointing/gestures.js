// Tells the viewer where a pointer was let go, how large the picture is, and which folders are
// opened and closed. What is pressed counts as let go only if its own pointer comes up, alone, while
// the page has the focus.
function startGestures(root, client) {
  if (root.dataset.started) return; // an image may be loaded twice
  root.dataset.started = "yes";
  const ending = new AbortController();
  let held = null; // the pointer that presses: its id and kind

  function press(event) {
    if (held !== null) cancel(); // a second finger
    else if (event.button === 0) held = { id: event.pointerId, kind: event.pointerType };
  }

  const picture = () => document.querySelector("canvas[data-engine]");

  function tellSize() {
    const canvas = picture();
    if (canvas !== null) connection.say({ size: [canvas.clientWidth, canvas.clientHeight] });
  }

  // Shares of the picture as viser counts them: to the middle of the pixel.
  function letGo(event) {
    if (held === null || event.pointerId !== held.id) return;
    held = null;
    const canvas = picture();
    if (canvas === null) return;
    const box = canvas.getBoundingClientRect();
    const u = (event.clientX - box.left + 0.5) / canvas.clientWidth;
    const v = (event.clientY - box.top + 0.5) / canvas.clientHeight;
    connection.say({ released: [u, v] });
  }

  function cancel() {
    if (held === null) return;
    held = null;
    connection.say({ cancelled: true });
  }

  // viser's folders: a title with an arrow, beside what it folds. Asked before viser turns the arrow.
  function clicked(event) {
    const title = event.target.closest(".mantine-Paper-root");
    const arrow = title === null ? null : title.querySelector(":scope > svg");
    if (arrow === null || title.parentElement.closest(".mantine-Paper-root") === null) return;
    const isOpen = !arrow.classList.contains("tabler-icon-chevron-up");
    if (isOpen && !arrow.classList.contains("tabler-icon-chevron-down")) return;
    connection.say({ folder: title.textContent, is_open: isOpen });
  }

  function end() {
    sizes.disconnect();
    ending.abort();
  }

  const connection = trolleyConnection(root, "gestures", client, {
    opened: tellSize, heard: () => {}, lost: () => {}, left: end,
  });
  const sizes = new ResizeObserver(tellSize);
  if (picture() !== null) sizes.observe(picture());
  const on = (target, name, action) =>
    target.addEventListener(name, action, { signal: ending.signal, capture: true });
  on(window, "pointerdown", press);
  on(window, "pointerup", letGo);
  on(window, "pointercancel", (event) => held !== null && event.pointerId === held.id && cancel());
  on(window, "keydown", (event) => event.key === "Escape" && cancel());
  // A finger that rests for a moment asks for this menu, too, and means nothing by it.
  on(window, "contextmenu", () => held !== null && held.kind === "mouse" && cancel());
  on(window, "blur", (event) => event.target === window && cancel());
  on(window, "pagehide", cancel);
  on(document, "visibilitychange", () => document.hidden && cancel());
  on(document, "click", clicked);
  connection.open();
}
