// The page's own words in the language of the page. What the viewer tells is in it already.
const languages = document.querySelector("meta[name=languages]").content.split(" ");
const KEPT = "language", ENGLISH = "en", SHOWN = ["aria-label", "title", "placeholder", "content"];
const fixed = []; // what stands in the page from the beginning: how to write it, and its English
const loaded = new Map([[ENGLISH, new Map()]]); // by language: its words, once they are here
let words = loaded.get(ENGLISH), now = ENGLISH;

// An English text in the language of the page, its placeholders filled in.
export function t(english, values = {}) {
  const text = words.get(english) ?? english;
  return text.replace(/\{(\w+)\}/g, (whole, name) =>
    Object.hasOwn(values, name) ? String(values[name]) : whole);
}

// The first of the device's languages that there is.
export function deviceLanguage() {
  const codes = navigator.languages.map((tag) => tag.toLowerCase().split("-")[0]);
  return codes.find((code) => code === ENGLISH || languages.includes(code)) ?? ENGLISH;
}

// The language that the page had the last time, else the device's: the viewer has yet to tell.
export function likelyLanguage() {
  let kept = null;
  try {
    kept = localStorage.getItem(KEPT);
  } catch { /* a browser that keeps nothing */ }
  return kept === ENGLISH || languages.includes(kept) ? kept : deviceLanguage();
}

// Have what stands in an element follow the language from now on.
export function follow(root) {
  const texts = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const node = texts.currentNode, english = node.data.trim();
    const [before, after] = english ? node.data.split(english) : [];
    if (english) add((text) => { node.data = before + text + after; }, english);
  }
  for (const element of root.querySelectorAll(SHOWN.map((name) => `[${name}]`).join())) {
    if (element.tagName === "META" && element.name !== "description") continue;
    for (const name of SHOWN.filter((one) => element.getAttribute(one))) {
      add((text) => element.setAttribute(name, text), element.getAttribute(name));
    }
  }
}

function add(write, english) {
  fixed.push([write, english]);
  if (words.size > 0) write(t(english));
}

// Change the language; tells whether it has changed. Nothing waits for it: STOP works before the
// words are there.
export async function speak(code) {
  if (code === now) return false;
  now = code;
  if (!loaded.has(code)) await load(code);
  if (now !== code) return false; // it has changed again meanwhile
  if (!loaded.has(code)) {
    now = ENGLISH; // the page stays as it is, and works
    return false;
  }
  words = loaded.get(code);
  document.documentElement.lang = code;
  for (const [write, english] of fixed) write(t(english));
  try {
    localStorage.setItem(KEPT, code);
  } catch { /* see above */ }
  return true;
}

async function load(code) {
  try {
    const answer = await fetch(`/page/words/${code}.json`);
    loaded.set(code, new Map(Object.entries(await answer.json())));
  } catch { /* it is asked for again when the viewer next tells the language */ }
}
