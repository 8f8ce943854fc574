// Markup that the viewer has made, and made safe. The page's policy forbids styles inside of markup;
// those that a program gave its text are set by script.

// What is replaced between press and release would lose the click: it waits for the release.
let pressed = null;
const late = new Map(); // by element: its newest markup

addEventListener("pointerdown", ({ target }) => { pressed = target; }, { capture: true });
for (const end of ["pointerup", "pointercancel", "blur"]) {
  addEventListener(end, () => {
    pressed = null;
    setTimeout(fillLate, 0); // after the click, which comes after the release
  }, { capture: true });
}

function fillLate() {
  const waiting = [...late];
  late.clear();
  for (const [element, html] of waiting) fill(element, html);
}

export function fill(element, html) {
  late.delete(element);
  if (element.markup === html) return;
  if (pressed !== null && element.contains(pressed)) {
    late.set(element, html);
    return;
  }
  element.markup = html;
  const parsed = new DOMParser().parseFromString(html, "text/html");
  const styles = [...parsed.querySelectorAll("[style]")].map((one) => {
    const style = one.getAttribute("style");
    one.removeAttribute("style");
    return [one, style];
  });
  element.replaceChildren(...parsed.body.childNodes);
  for (const [one, style] of styles) one.style.cssText = style;
  for (const one of element.querySelectorAll("[data-colour]")) {
    one.style.background = one.dataset.colour;
  }
}
