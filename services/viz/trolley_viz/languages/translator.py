"""Translates what the page is told, by a catalogue of texts and patterns.

A pattern is a text with placeholders, which its translation has as well:

    {name}    a name, a length of time and the like: stays as it is
    {count#}  a number or a time of day
    {why*}    an English text: it is translated, too
    {rest+}   anything: stays as it is

Of several patterns that fit, the one counts whose parts are all known, and of these the one with
the most characters of its own. A text without a translation stays as it is.
"""

import functools
import html
import re
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from trolley_viz.languages.catalogue import ENGLISH, catalogues

PLACEHOLDER = re.compile(r"\{(\w+)([#*+]?)\}")
_APART = r"[^,;:()“”„·→…!?\n]"
"""What keeps the parts of a text apart is in no name of a place, tour, zone or map."""
_NAME = rf"\(-?[\d.]+, -?[\d.]+\)|(?:(?!\. [A-Z“\d]){_APART})+?"
_ANY_NAME = rf"\(-?[\d.]+, -?[\d.]+\)|{_APART}+?"
"""A name such as "St. Anna", which looks like the end of a sentence."""
_KINDS = {"#": r"[-+±]?\d[\d.,:]*", "*": r".+?", "+": r".+?"}
_LETTERS = re.compile(r"[^\W\d_]{2}")
_ENDS = re.compile(r"(?<=[.!?…]) (?=\S+ )")
"""Between two sentences. What is only one word may be the end of a name: "1. Stop"."""
_TAG = re.compile(r"(<[^<>]*>)")
_TITLE = re.compile(r'(?<= title=")[^"<>]*(?=")')
_VOID = frozenset({"br", "hr", "img", "input", "path", "line", "polyline", "circle", "rect"})

MAX_CHARACTERS = 400
"""No text with parts is longer; programs and other robots may say more."""
MAX_SEARCHES = 150
"""For one text with its parts. What the page says by itself needs a few dozen."""
MAX_SENTENCES = 8
MIN_OWN_CHARACTERS = 6
"""A pattern with fewer characters of its own fits almost anything: all its parts must be known."""
MAX_CACHED = 4000


class Found(NamedTuple):
    """A translation, and how much of the text it covers."""

    text: str
    is_whole: bool = False
    """Whether nothing of it is left in English."""
    known: int = 0
    """How many characters of the English text are in the catalogue."""


class TooMuch(Exception):
    """A text has so many parts that looking for all of them would take long."""


class Pattern:
    """One entry of a catalogue that has placeholders."""

    def __init__(self, english: str, translation: str) -> None:
        self._translation = translation
        self._kinds = dict(PLACEHOLDER.findall(english))
        self.own_characters = len(PLACEHOLDER.sub("", english))
        own = PLACEHOLDER.split(english)[::3]
        self.begins, self.longest = own[0], max(own, key=len)
        """Of its own characters, those at the beginning and the longest piece."""
        self._strict = _regex(english, _NAME)
        self._loose = _regex(english, _ANY_NAME)

    def translate(
        self, text: str, inner: Callable[[str], Found], *, is_loose: bool
    ) -> Found | None:
        """Return what a text is, None where this does not fit; `inner` translates parts of it."""
        fit = (self._loose if is_loose else self._strict).fullmatch(text)
        if fit is None:
            return None
        parts: dict[str, Found] = {}
        for name, part in fit.groupdict().items():
            parts[name] = found = inner(part) if self._kinds[name] == "*" else Found(part, True)
            if not found.is_whole and self.own_characters < MIN_OWN_CHARACTERS:
                return None
        filled = PLACEHOLDER.sub(lambda found: parts[found[1]].text, self._translation)
        return Found(
            filled,
            all(part.is_whole for part in parts.values()),
            self.own_characters + sum(part.known for part in parts.values()),
        )


class Translator:
    """Translates into one language.

    Args:
        texts: by the English one, what it is in this language.
    """

    def __init__(self, texts: Iterable[tuple[str, str]]) -> None:
        entries = dict(texts)
        self._texts = {one: other for one, other in entries.items() if not PLACEHOLDER.search(one)}
        patterns = [Pattern(*entry) for entry in entries.items() if entry[0] not in self._texts]
        patterns.sort(key=lambda one: -one.own_characters)
        self._anywhere = [one for one in patterns if not one.begins]
        self._by_first = {
            first: [one for one in patterns if one.begins[:1] in ("", first)]
            for first in {one.begins[0] for one in patterns if one.begins}
        }
        self._num_searches = 0
        self._find = functools.lru_cache(maxsize=MAX_CACHED)(self._find_anew)
        self._search = functools.lru_cache(maxsize=MAX_CACHED)(self._search_anew)
        self.markup = functools.lru_cache(maxsize=MAX_CACHED // 10)(self._in_markup)
        """Translates the texts in markup; what is marked with `translate="no"` stays."""

    def text(self, english: str) -> str:
        """Return what a text is in this language; one that is not known stays as it is."""
        return self._find(english).text

    def knows(self, english: str) -> bool:
        """Whether nothing of a text would be left in English."""
        return self._find(english).is_whole

    def card(self, markup: str) -> str:
        """Translate what is marked with `translate="yes"` between the texts of programs."""
        return self._in_markup(markup, is_on=False) if 'translate="yes"' in markup else markup

    # Inside.
    def _find_anew(self, text: str) -> Found:
        self._num_searches = 0
        try:
            return self._part(text.strip())
        except TooMuch:
            return Found(text)

    def _search_anew(self, text: str, is_one: bool = False) -> Found:
        """Look a text up; `is_one`: as one piece, not sentence by sentence."""
        if not _LETTERS.search(text):
            return Found(text, is_whole=True)
        if text in self._texts:
            return Found(self._texts[text], is_whole=True, known=len(text))
        if len(text) > MAX_CHARACTERS:
            return Found(text)
        self._num_searches += 1
        if self._num_searches > MAX_SEARCHES:
            raise TooMuch
        best = Found(text)
        for found in self._attempts(text, is_one=is_one):
            if found.is_whole:
                return found
            if best.text == text:
                best = found
        return best

    def _attempts(self, text: str, *, is_one: bool) -> Iterator[Found]:
        """What a text might be, the likeliest first."""
        patterns = [
            one
            for one in self._by_first.get(text[0], self._anywhere)
            if one.longest in text and text.startswith(one.begins)
        ]
        own = [one for one in patterns if one.own_characters >= MIN_OWN_CHARACTERS]
        yield from self._fitting(own, text, is_loose=False)
        if is_one:  # else what fits almost anything would take all of it
            patterns = own
        else:
            yield from self._sentence_by_sentence(text)
        yield from self._fitting(patterns[len(own) :], text, is_loose=False)
        yield from self._fitting(patterns, text, is_loose=True)

    def _fitting(self, patterns: list[Pattern], text: str, *, is_loose: bool) -> Iterator[Found]:
        for pattern in patterns:
            found = pattern.translate(text, self._part, is_loose=is_loose)
            if found is not None:
                yield found

    def _part(self, text: str, *, is_one: bool = False) -> Found:
        """Translate a part of a text: a sentence may have lost its capital or full stop there."""
        found = self._search(text, is_one)
        if text in self._texts or (found.is_whole and text.endswith(".")):
            return found
        sentence = self._search(f"{text[:1].upper()}{text[1:]}.", is_one)
        if sentence.is_whole and sentence.known > found.known * found.is_whole:
            return sentence._replace(text=sentence.text.removesuffix("."))
        bare = self._search(text.removesuffix("."), is_one)
        if bare.is_whole and not found.is_whole:
            return bare._replace(text=f"{bare.text}.")
        return found

    def _sentence_by_sentence(self, text: str) -> Iterator[Found]:
        """Translate the sentences of a text, several at once where they are known together."""
        rest = _ENDS.split(text, maxsplit=MAX_SENTENCES)
        if len(rest) == 1:
            return
        found = [self._first_of(rest, len(rest) - 1)]
        while rest:
            found.append(self._first_of(rest, len(rest)))
        whole = all(one.is_whole for one in found)
        yield Found(" ".join(one.text for one in found), whole, sum(one.known for one in found))

    def _first_of(self, rest: list[str], most: int) -> Found:
        """Take from the sentences that are left those that are known together, else the first."""
        for count in range(most, 0, -1):
            one = self._part(" ".join(rest[:count]), is_one=count > 1)
            if one.is_whole or count == 1:
                del rest[:count]
                return one
        raise AssertionError("there is no sentence left")

    def _in_markup(self, markup: str, is_on: bool = True) -> str:
        pieces: list[str] = []
        switches = [is_on]
        for piece in _TAG.split(markup):
            if not piece.startswith("<"):
                pieces.append(self._in_text(piece) if switches[-1] else piece)
                continue
            if piece.startswith("</"):
                switches = switches[:-1] or [is_on]
            elif not _is_void(piece):
                switches.append(_switch(piece, is_on=switches[-1]))
                piece = self._in_tag(piece) if switches[-1] else piece
            pieces.append(piece)
        return "".join(pieces)

    def _in_text(self, escaped: str) -> str:
        text = html.unescape(escaped)
        inner = text.strip()
        if not inner:
            return escaped
        before, after = text[: text.index(inner)], text[text.index(inner) + len(inner) :]
        return html.escape(f"{before}{self.text(inner)}{after}")

    def _in_tag(self, tag: str) -> str:
        return _TITLE.sub(lambda title: html.escape(self.text(html.unescape(title[0]))), tag)


@functools.cache
def translator_of(code: str) -> Translator | None:
    """Return the translator into a language; None for English, which needs none."""
    if code == ENGLISH:
        return None
    return Translator(catalogues()[code].all_texts().items())


def _regex(english: str, name: str) -> re.Pattern[str]:
    parts = PLACEHOLDER.split(english)
    fixed = [re.escape(part) for part in parts[::3]]
    open_ends = [
        f"(?P<{called}>{_KINDS.get(kind, name)})"
        for called, kind in zip(parts[1::3], parts[2::3], strict=True)
    ]
    whole = "".join(one + other for one, other in zip(fixed, [*open_ends, ""], strict=True))
    return re.compile(whole, re.DOTALL)


def _is_void(tag: str) -> bool:
    return tag.endswith("/>") or tag[1:-1].partition(" ")[0] in _VOID


def _switch(tag: str, *, is_on: bool) -> bool:
    """Whether the texts inside of a tag are translated."""
    return ' translate="yes"' in tag or (is_on and ' translate="no"' not in tag)
