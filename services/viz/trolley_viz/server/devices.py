"""What to call a browser that nobody has given a name."""

import itertools
import re

HERE = "the computer that runs this page"
"""One on the viewer's own host. Others read this, too: “this computer” would be theirs."""
A_BROWSER = "a browser"
MAX_AGENT = 500
"""Nothing that matters comes later in a User-Agent header."""
BROWSERS = (
    ("Edge", r"Edg(e|A|iOS)?/"),
    ("Opera", r"OPR/"),
    ("Samsung Internet", r"SamsungBrowser/"),
    ("Firefox", r"(Firefox|FxiOS)/"),
    ("Chrome", r"(Chrome|Chromium|CriOS)/"),
    ("Safari", r"Safari/"),
)
"""The first that is found wins: nearly all claim to be those further down as well."""
SYSTEMS = (
    ("Android", r"Android"),
    ("iPhone", r"iPhone"),
    ("iPad", r"iPad"),
    ("Windows", r"Windows"),
    ("ChromeOS", r"CrOS"),
    ("Mac", r"Macintosh"),
    ("Linux", r"Linux|X11"),
)


def device_name(agent: str) -> str:
    """Return what a User-Agent header says of a browser, as “Chrome on Android”."""
    browser, system = _first(BROWSERS, agent), _first(SYSTEMS, agent)
    return f"{browser or A_BROWSER} on {system}" if system else browser or A_BROWSER


def by(name: str, own: str = "") -> str:
    """Say who did something, to a browser that is called `own`; a computer does nothing itself."""
    if name != HERE:
        return f"by {name}"
    return "from this computer" if own == HERE else f"from {HERE}"


def _first(rules: tuple[tuple[str, str], ...], agent: str) -> str:
    text = agent[:MAX_AGENT]
    return next((name for name, pattern in rules if re.search(pattern, text)), "")


def _all_names() -> set[str]:
    browsers = [A_BROWSER, *(name for name, _ in BROWSERS)]
    pairs = itertools.product(browsers, (name for name, _ in SYSTEMS))
    return {HERE, *browsers, *(f"{browser} on {system}" for browser, system in pairs)}


DEVICE_NAMES = frozenset(_all_names())
"""All that a browser without a name can be called."""
