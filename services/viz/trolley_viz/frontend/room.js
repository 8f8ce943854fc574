// On a phone, cards lie over the sheet and may reach up over the map: its buttons go up by as much.
export class Room {
  constructor(map, over, stopLine) {
    this.map = map;
    this.over = over;
    const watch = new ResizeObserver(() => this.make());
    for (const one of [map, stopLine]) watch.observe(one);
    new MutationObserver((changes) => {
      for (const { addedNodes } of changes) for (const one of addedNodes) watch.observe(one);
    }).observe(over, { childList: true });
  }

  make() {
    const { bottom } = this.map.getBoundingClientRect();
    const tops = [...this.over.children]
      .filter((one) => !one.hidden && getComputedStyle(one).position === "fixed")
      .map((one) => one.getBoundingClientRect().top);
    const covered = bottom - Math.min(bottom, ...tops);
    this.over.style.setProperty("--covered", `${covered}px`);
  }
}
