// The overlays in the page. What they hold is made, and made safe, by the viewer; this puts it in
// its place, and says what was clicked.
function startOverlays(root, client) {
  if (root.dataset.started) return; // an image may be loaded twice
  root.dataset.started = "yes";
  const ending = new AbortController();
  const cards = new Map(); // by the overlay's name: its elements
  let isPressed = false, waiting = null;

  function newCard(name) {
    const card = document.createElement("div");
    const head = document.createElement("div"), body = document.createElement("div");
    card.className = "ov-card";
    card.dataset.name = name;
    card.append(head, body);
    return { card, head, body, shown: {} };
  }

  function fill(element, html) {
    if (element.dataset.html === html) return;
    element.dataset.html = html;
    element.innerHTML = html;
  }

  function put(name, wanted) {
    if (!cards.has(name)) cards.set(name, newCard(name));
    const { card, head, body } = cards.get(name);
    card.dataset.kind = wanted.kind;
    card.dataset.place = wanted.place;
    card.style.cssText = wanted.style;
    fill(head, wanted.head);
    fill(body, wanted.body);
    card.classList.toggle("ov-troubled", body.querySelector("[data-trouble]") !== null);
  }

  function arrange(order) {
    for (const [name, { card }] of cards) {
      if (order.includes(name)) continue;
      card.remove();
      cards.delete(name);
    }
    for (const slot of root.querySelectorAll(".ov-slot")) {
      const mine = order.filter((name) => cards.get(name).card.dataset.place === slot.dataset.place);
      const wanted = mine.map((name) => cards.get(name).card);
      const here = [...slot.children];
      if (wanted.length !== here.length || wanted.some((card, i) => card !== here[i])) {
        slot.replaceChildren(...wanted);
      }
    }
  }

  // A card that is replaced between press and release would lose the click.
  function take(told) {
    if (told.csv !== null) return save(told.csv);
    if (isPressed && waiting !== null) Object.assign(told.cards, { ...waiting.cards, ...told.cards });
    if (isPressed) return void (waiting = told);
    for (const [name, card] of Object.entries(told.cards)) put(name, card);
    arrange(told.order);
    root.dataset.note = told.note;
    root.dataset.choose = String(told.may_choose);
  }

  function save({ name, text }) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function clicked(event) {
    const card = event.target.closest(".ov-card");
    if (card === null) return;
    const id = card.dataset.name, item = event.target.closest("[data-index]");
    if (item !== null) connection.say({ id, index: Number(item.dataset.index) });
    else if (event.target.closest(".ov-csv") !== null) connection.say({ id, csv: true });
  }

  function released() {
    isPressed = false;
    const late = waiting;
    waiting = null;
    // After the click, which comes after the release.
    if (late !== null) setTimeout(() => take(late), 0);
  }

  function lose() {
    for (const { card } of cards.values()) card.classList.add("ov-troubled");
  }

  const connection = trolleyConnection(root, "overlays", client, {
    opened: () => {}, heard: take, lost: lose, left: () => ending.abort(),
  });
  const on = (target, name, action) =>
    target.addEventListener(name, action, { signal: ending.signal });
  on(root, "click", clicked);
  on(root, "pointerdown", () => (isPressed = true));
  for (const name of ["pointerup", "pointercancel", "blur"]) on(window, name, released);
  connection.open();
}
