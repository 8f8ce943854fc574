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

// What has the focus and what is open in an element; to be found again once it is written anew.
function kept(element) {
  const name = (one) => [one.tagName, one.dataset.press, one.dataset.index, one.href, one.textContent].join();
  const opened = new Set([...element.querySelectorAll("details[open] > summary")].map(name));
  const focused = element.contains(document.activeElement) ? name(document.activeElement) : null;
  return () => {
    for (const one of element.querySelectorAll("summary")) {
      if (opened.has(name(one))) one.parentElement.open = true;
    }
    if (focused === null) return;
    const again = [...element.querySelectorAll("button, summary, a")].find((one) => name(one) === focused);
    again?.focus({ preventScroll: true });
  };
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
  const keep = kept(element);
  element.replaceChildren(...parsed.body.childNodes);
  keep();
  for (const [one, style] of styles) one.style.cssText = style;
  for (const one of element.querySelectorAll("[data-colour]")) {
    one.style.background = one.dataset.colour;
  }
}
