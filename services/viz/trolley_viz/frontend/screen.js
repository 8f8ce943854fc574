// The screen, kept from going dark. Browsers let a page do that only over https and on the viewer's
// own computer, and end it whenever the page goes out of sight.
let lock = null; // the promise of what keeps it on, while that is wanted

export function keepScreenOn(isWanted) {
  if (isWanted === (lock !== null)) return;
  if (!isWanted) {
    lock.then((held) => held?.release());
    lock = null;
    return;
  }
  // Refused to save the battery, it is not asked for again until the page comes back into sight.
  const asked = navigator.wakeLock?.request("screen").catch(() => null) ?? Promise.resolve(null);
  lock = asked;
  asked.then((held) => held?.addEventListener("release", () => {
    if (lock === asked) lock = null;
  }));
}
