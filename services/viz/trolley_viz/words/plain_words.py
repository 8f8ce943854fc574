"""What services say, in the words of the page, where nobody types commands.

Services speak to programs and terminals, too: of codes, of commands in backticks, of resuming. All
that a page shows of what they say goes through here; what is left in backticks is put in quotes.
"""

import re

from trolley import codes

NOT_READY = (
    "A part of the robot's software is not running. If the robot has just started, try again in a "
    "moment."
)
_WORDS = {
    "`trolley resume` lets it drive": "“Drive on” lets it drive",
    "The map is paused; resume it first": "The map is paused; press “Continue” first",
    "resume it first": "press “Drive on” first",
    "The goal is paused; resume it or send a new one": "It is paused; press “Continue”, or send "
    "it elsewhere",
    "resume it to continue": "press “Continue”",
    "resume the goal to continue": "press “Continue”",
    "resume the goal to go on": "press “Continue”",
    "resume the tour to continue": "press “Continue”",
    "resume the robot, then the tour": "press “Drive on”, then “Continue”",
    "resume it, then exploring": "press “Drive on”, then “Explore by itself”",
    "`trolley map explore` continues it": "tell it to continue",
    ", or use `replace` to overwrite it": "",
    "use `replace` to overwrite it": "choose another one",  # said by release 0.2.0
    "make one (`trolley map new NAME`), or set [map] file": "make one in the “Map” tab",
    " (`--as NAME`)": "",
    " (`trolley map load NAME`)": "",
    " (`trolley map cancel`)": "",
    " (`trolley map save NAME`)": "",
    codes.SENTENCES[codes.NOT_READY]: NOT_READY,
    codes.SENTENCES[codes.INTERNAL]: "Something went wrong in the robot's software; its log has "
    "the details.",
    codes.SENTENCES[codes.WRONG_FRAME]: "The robot cannot be sent there: that place is not on the "
    "map that it drives by.",
}
"""What programs call something, and what the page does; the longer is looked for first."""
_KNOWN = re.compile("|".join(map(re.escape, sorted(_WORDS, key=len, reverse=True))))
_REQUEST = re.compile(r"^[a-z_]+(?:/[a-z_]+)+: (?:`name`: )?(\w)")
"""The name of a request before what became of it, or of what people typed into a field."""
_QUOTED = re.compile(r"`([^`]*)`")


def plain(text: str) -> str:
    """Say what a service said in the words of the page."""
    text = _REQUEST.sub(lambda found: found[1].upper(), text)
    text = _KNOWN.sub(lambda found: _WORDS[found[0]], text)
    return _QUOTED.sub(r"“\1”", text)


def said(message: str, code: str = "") -> str:
    """Say what a service said in a message, or else by a code; "" where it said nothing.

    A code that is not known, as of a newer program, is at least shown as words.
    """
    return plain(message or codes.SENTENCES.get(code, code.replace("_", " ")))
