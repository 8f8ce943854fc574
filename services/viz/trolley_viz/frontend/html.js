// Markup that the viewer has made, and made safe. The page's policy forbids styles inside of markup;
// those that a program gave its text are set by script.
export function fill(element, html) {
  if (element.markup === html) return;
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
