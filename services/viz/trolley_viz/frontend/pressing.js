// Hands that shake press twice. By the second press something else may have come under the finger:
// what was under a card that has closed, or “Continue” in place of “Pause”. It counts for nothing,
// nor does a third.
const TWICE_MS = 400, NEAR_PX = 30;

// Returns what is to be told of presses that this does not hear of, as those inside of a frame.
export function countOnce(root) {
  let last = null; // the press before, by a pointer
  root.addEventListener("click", (event) => {
    if (event.detail === 0) return; // by a key or a screen reader
    const { target, clientX: x, clientY: y, timeStamp: ms } = event;
    const button = target.closest("button");
    const isTwice = last !== null && ms - last.ms < TWICE_MS
      && Math.hypot(x - last.x, y - last.y) < NEAR_PX;
    if (isTwice && button !== null && button !== last.button && button.id !== "stop") {
      event.preventDefault();
      event.stopPropagation();
      return;
    }
    last = { button, x, y, ms };
  }, { capture: true });
  return (x, y, ms) => { last = { button: null, x, y, ms }; };
}
