// Notices at the edge of the page, gone after a few seconds.
const SECONDS = { good: 4, busy: 4, idle: 5, warn: 8, bad: 8 }, MOST = 2;

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
    setTimeout(() => notice.remove(), 1000 * SECONDS[tone]);
  }
}
