// Keeps the card of a spot of the map that was touched off the spot: beside the map it goes into
// another corner of it, and where it is too wide for that the picture moves aside. On a phone cards
// lie over the sheet and may reach up over the map: its buttons go up by as much, and the picture as
// far as it takes to see the spot.
const CORNERS = ["bottom-right", "top-right", "top-left"];
const AROUND_PX = 24, ABOVE_PX = 70; // the ring around the spot; with the buttons, too

export class Room {
  constructor(map, scene, over, stopLine) {
    this.map = map;
    this.scene = scene;
    this.over = over;
    this.spot = null; // that was touched last, in the picture
    const watch = new ResizeObserver(() => this.make());
    for (const one of [map, stopLine]) watch.observe(one);
    new MutationObserver((changes) => {
      for (const { addedNodes } of changes) for (const one of addedNodes) watch.observe(one);
    }).observe(over, { childList: true });
  }

  touch(x, y) {
    this.spot = { x, y };
    this.make();
  }

  make() {
    const map = this.map.getBoundingClientRect();
    const shown = [...this.over.children].filter((one) => !one.hidden);
    const low = shown.filter((one) => getComputedStyle(one).position === "fixed");
    const tops = low.map((one) => one.getBoundingClientRect().top);
    const covered = map.bottom - Math.min(map.bottom, ...tops);
    this.over.style.setProperty("--covered", `${covered}px`);
    const card = this.spot && shown.find((one) => one.matches(".card.of-spot"));
    let up = 0, aside = 0;
    if (low.includes(card)) up = this.spot.y + ABOVE_PX - (map.height - covered);
    else if (card) aside = this.moveAway(card, map.left + this.spot.x, map.top + this.spot.y);
    this.scene.style.translate = `${aside}px ${-Math.min(Math.max(up, 0), covered)}px`;
  }

  // Says how far the picture has to move aside.
  moveAway(card, x, y) {
    const ways = CORNERS.map((corner) => {
      card.dataset.corner = corner;
      const { left, right, top, bottom } = card.getBoundingClientRect();
      const isBeside = x < left - AROUND_PX || x > right + AROUND_PX;
      if (isBeside || y < top - AROUND_PX || y > bottom + AROUND_PX) return 0;
      return (corner.endsWith("right") ? left - AROUND_PX : right + AROUND_PX) - x;
    });
    const best = ways.reduce((a, b) => (Math.abs(b) < Math.abs(a) ? b : a));
    card.dataset.corner = CORNERS[ways.indexOf(best)];
    return best;
  }
}
