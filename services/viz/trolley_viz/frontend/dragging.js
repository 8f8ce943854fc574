// A button in a list that is dragged by its grip to another place in the list, or moved with
// Alt and the arrows. `moved` is called with by how many places, up being negative.
const THRESHOLD_PX = 6, KEYS = { ArrowUp: -1, ArrowDown: 1 };

const isListed = (one) => one.querySelector(":scope > .grip:not([hidden])") !== null && !one.hidden;

// The others of the list, above and below.
function others(element) {
  return [...element.parentElement.children].filter((one) => one !== element && isListed(one));
}

// How many of the others an element has passed whose middle is at this height.
function passed(element, startY, y) {
  const middle = (one) => {
    const box = one.getBoundingClientRect();
    return (box.top + box.bottom) / 2;
  };
  const above = others(element).filter((one) => middle(one) < startY && middle(one) > y).length;
  const below = others(element).filter((one) => middle(one) > startY && middle(one) < y).length;
  return below - above;
}

export function letMove(element, grip, moved) {
  let pointer = null, fromY = 0, startY = 0, isDragged = false;

  function end(event, isDone) {
    if (event.pointerId !== pointer) return;
    pointer = null;
    const by = isDone && isDragged ? passed(element, startY, startY + event.clientY - fromY) : 0;
    element.style.transform = "";
    element.classList.remove("dragged");
    if (by !== 0) moved(by);
  }

  grip.addEventListener("pointerdown", (event) => {
    if (pointer !== null || event.button !== 0 || element.disabled) return;
    event.preventDefault();
    const box = element.getBoundingClientRect();
    [pointer, fromY, startY, isDragged] = [
      event.pointerId, event.clientY, (box.top + box.bottom) / 2, false,
    ];
    grip.setPointerCapture(pointer);
  });
  grip.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pointer) return;
    const far = event.clientY - fromY;
    isDragged ||= Math.abs(far) > THRESHOLD_PX;
    if (!isDragged) return;
    element.classList.add("dragged");
    element.style.transform = `translateY(${far}px)`;
  });
  grip.addEventListener("pointerup", (event) => end(event, true));
  grip.addEventListener("pointercancel", (event) => end(event, false));
  // What is dragged is not pressed as well.
  grip.addEventListener("click", (event) => isDragged && event.stopPropagation());
  element.addEventListener("keydown", (event) => {
    if (!event.altKey || !(event.key in KEYS) || grip.hidden) return;
    event.preventDefault();
    moved(KEYS[event.key]);
  });
}
