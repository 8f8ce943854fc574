"""What a lidar's driver module says of its model, for base, `trolley detect` and the importers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

from trolley import drivers
from trolley.config.hardware import LidarConfig
from trolley.drivers import Driver
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.lidars.frames import FrameFormat

SETTINGS = "base.lidar.settings"
"""Where a driver's own settings stand."""


@dataclass(frozen=True, slots=True)
class LidarFacts:
    """A lidar model as it is delivered.

    Attributes:
        title: its name for people.
        baud: of its line, 8N1.
        other_bauds: of other versions that `trolley detect` looks for.
        range_min_m: nearest distance that it measures.
        range_max_m: farthest.
        turns_hz: slowest and fastest turning at which it measures.
        usual_hz: how fast it usually turns.
        clockwise: its head turns clockwise as seen from above.
        speed_hint: what to do about a wrong speed.
        modes: what `[base.lidar] mode` may be.
        no_echo: what a program does where nothing comes back, as in `[base.lidar] no_echo`.
        has_usb: it has USB of its own, so that its baud does not say how long bytes were under way.
    """

    title: str
    baud: int
    range_min_m: float
    range_max_m: float
    turns_hz: tuple[float, float]
    usual_hz: float
    clockwise: bool = True
    speed_hint: str = "Is its head free to turn, and its 5 V supply strong enough?"
    modes: tuple[str, ...] = ("auto",)
    other_bauds: tuple[int, ...] = ()
    no_echo: Literal["hold", "creep"] = "hold"
    has_usb: bool = False


@dataclass(frozen=True, slots=True)
class Identity:
    """How `trolley detect` asks lidars of the Slamtec kind who they are.

    Attributes:
        stop: commands that end a stream which a dead program has left on.
        get_info: asks for model, firmware and serial number.
        get_health: asks how it is.
        other_model: what people call one that no driver knows by its number, and a sentence of
            advice.
        serial: the serial number as the vendor prints it, of its bytes.
    """

    stop: tuple[bytes, ...]
    get_info: bytes
    get_health: bytes
    other_model: Callable[[int], tuple[str, str]]
    serial: Callable[[bytes], str]


@dataclass(frozen=True, slots=True)
class Greeting:
    """How `trolley detect` asks a lidar that answers in words of its own who it is.

    Attributes:
        ask: the question, and before it what ends a stream which a dead program has left on; a
            device has a moment's rest between two parts.
        recognise: finds the answer in what has arrived: the lidar's title, and what it says of
            itself; None while it is not there.
    """

    ask: tuple[bytes, ...]
    recognise: Callable[[bytes], tuple[str, tuple[str, ...]] | None]


def _none(number: int) -> bool:
    del number
    return False


@dataclass(frozen=True, slots=True)
class LidarDriver(Driver):
    """A lidar model's entry in the table `MODELS`.

    Attributes:
        facts: of the model.
        make: makes the dialogue; raises DriverError where the settings do not fit the model.
        frames: of its stream, where `trolley detect` can tell it by them.
        start: makes it stream, for one that is silent until then and is not asked who it is.
        stop: ends that stream again.
        identity: how it and its kind are asked who they are.
        greeting: how it is asked who it is, where it is not of that kind.
        is_model: whether a model number is its own.
        linorobot_names: what linorobot calls it in `LINOLIDAR`.
        ros_packages: the ROS packages that drive it.
    """

    group: ClassVar[str] = drivers.LIDARS
    facts: LidarFacts
    make: Callable[[LidarConfig], LidarDialogue]
    frames: FrameFormat | None = None
    start: bytes = b""
    stop: bytes = b""
    identity: Identity | None = None
    greeting: Greeting | None = None
    is_model: Callable[[int], bool] = _none
    linorobot_names: tuple[str, ...] = ()
    ros_packages: tuple[str, ...] = ()
