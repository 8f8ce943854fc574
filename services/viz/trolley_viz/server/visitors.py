"""Visitors: which browser it is, and what its person may do."""

from dataclasses import dataclass, field
from typing import Literal

Role = Literal["operator", "viewer"]
"""An operator may do everything; a viewer may look, and press Stop."""


@dataclass(frozen=True)
class Visitor:
    """One browser, as the web server knows it."""

    browser: str = ""
    """The name under which the browser's choices are saved; "" saves nothing."""
    role: Role = "operator"
    device: str = field(default="", compare=False)
    """What it is, to call it by while it has no name."""


NOBODY = Visitor()
