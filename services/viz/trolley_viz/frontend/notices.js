// Notices at the edge of the page, gone after a few seconds, or after as long as slow readers need.
const SECONDS = { good: 4, busy: 4, idle: 5, warn: 8, bad: 8 }, MOST = 2;
const READ_PER_S = 10; // characters

export class Notices {
  constructor(root) {
    this.root = root;
  }

  show({ title, text, tone }) {
    const notice = document.createElement("div");
    const head = document.createElement("strong"), body = document.createElement("p");
    notice.className = "notice";
    notice.dataset.tone = tone;
    head.textContent = title;
    body.textContent = text;
    notice.append(head, body);
    this.root.append(notice);
    while (this.root.children.length > MOST) this.root.firstElementChild.remove();
    const reading = notice.textContent.length / READ_PER_S;
    setTimeout(() => notice.remove(), 1000 * Math.max(SECONDS[tone], reading));
  }
}
