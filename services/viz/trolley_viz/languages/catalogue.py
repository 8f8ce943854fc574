"""The catalogues: one file per language, which says what each English text of the page is there."""

import functools
import re
from collections.abc import Mapping
from importlib import resources

import msgspec
from msgspec import Struct

ENGLISH = "en"
"""The language in which everything is written; it has no file."""
CODE = re.compile(r"[a-z]{2,3}")


class Catalogue(Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `<code>.toml`; the keys of its tables are the English texts."""

    name: str
    """What the language calls itself."""
    page: dict[str, str]
    """What the page says by itself; its script gets these."""
    texts: dict[str, dict[str, str]]
    """What the viewer tells a page, by subject."""

    def all_texts(self) -> dict[str, str]:
        """What there is, of all subjects."""
        found = dict(self.page)
        for texts in self.texts.values():
            found.update(texts)
        return found


@functools.cache
def catalogues() -> Mapping[str, Catalogue]:
    """Read all catalogues, by the codes of their languages (ISO 639).

    Raises:
        msgspec.DecodeError: A file is not a catalogue.
    """
    files = resources.files("trolley_viz").joinpath("languages").iterdir()
    read = {
        one.name.removesuffix(".toml"): msgspec.toml.decode(one.read_bytes(), type=Catalogue)
        for one in files
        if one.name.endswith(".toml")
    }
    return dict(sorted(read.items()))


def known_language(tag: str) -> str:
    """Return the code of the language that a tag such as "de-AT" means; "" for none of ours."""
    found = CODE.match(tag.lower())
    code = "" if found is None else found[0]
    return code if code == ENGLISH or code in catalogues() else ""
