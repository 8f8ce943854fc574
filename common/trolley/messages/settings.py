"""Settings of `robot.toml` while the robot runs."""

from typing import Any, Literal

from msgspec import Struct

from trolley.geometry.pose import Finite
from trolley.messages.types import StampNs

Acts = Literal["at_once", "file", "restart"]
"""When a changed setting counts; `file`: it is changed only in robot.toml, on the robot."""


Source = Literal["default", "not_saved", "robot_toml", "settings_toml"]
"""What says what a setting is after a restart.

`settings_toml`: the file of that name in the state folder of `base`, where settings are kept while
robot.toml cannot be written. `not_saved`: nothing, it was set and ends with a restart.
"""


class Setting(Struct, frozen=True, kw_only=True):
    """One setting of `robot.toml`.

    `value` is what the robot runs with, `next` what it will run with after a restart; what is not
    given is `null`. `acts`: it counts `at_once` when it is set, after a `restart` of `service`, or
    it is changed only in the `file` itself, on the robot. `saved` is false where `value` was set
    but could not be saved. `least` and `greatest` bound a number, `choices` are all
    values of a word, `allowed` says the same to people. `source` is what says `next`.
    """

    section: str
    key: str
    value: Any = None
    next: Any = None
    default: Any = None
    meaning: str = ""
    allowed: str = ""
    unit: str = ""
    least: Finite | None = None
    greatest: Finite | None = None
    choices: list[str] = []
    acts: Acts = "file"
    service: str = ""
    saved: bool = True
    source: Source = "robot_toml"


class Settings(Struct, frozen=True, kw_only=True):
    """Settings, and the robot.toml they are of; `message` says in a sentence what was done."""

    settings: list[Setting]
    file: str = ""
    message: str = ""


class ChangedSetting(Struct, frozen=True, kw_only=True):
    """What a setting that counts at once was set to, whatever a service has read in its file."""

    section: str
    key: str
    value: bool | int | Finite | str
    saved: bool = True


class ConfigChanges(Struct, frozen=True, kw_only=True):
    """All settings that were set while the robot runs, and count. Owned by `base`, on change.

    A service takes those of its own section, and goes back to its file's where one is missing.
    """

    stamp_ns: StampNs
    changes: list[ChangedSetting]
