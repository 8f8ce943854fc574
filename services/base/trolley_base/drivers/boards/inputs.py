"""Bumpers, cliff sensors and a battery on pins of the board."""

from trolley import codes
from trolley.config.hardware import InputsConfig
from trolley.messages import Battery

TOUCH_EVERY_NS, TOUCH_PINS = 40_000_000, 2
"""Two pins are read this often: with the answer and a period of base, the wheels are told to stop
within 0.1 s. More of them share the same part of the line."""
BATTERY_EVERY_NS = 1_000_000_000
EMPTY_FOR_NS = 2_000_000_000
"""Motors that set off pull the voltage down for a moment."""
RECOVERED_SHARE = 0.1
"""An empty battery recovers a little as soon as nothing is driven; this share of the range from
empty to full above the limit it counts as charged again."""


class Inputs:
    """What is asked of the pins, and what the answers mean.

    Attributes:
        battery: the newest charge, None if it is not known.

    Args:
        config: what is wired to which pin.
    """

    def __init__(self, config: InputsConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was read."""
        self.battery: Battery | None = None
        self._active: dict[str, str] = {}
        self._low_since_ns: int | None = None
        self._is_empty = False

    def questions(self) -> dict[str, int]:
        """Return what is to be asked, and how far apart [ns]."""
        config = self._config
        touched = [*config.bumper_pins, *config.cliff_pins]
        period_ns = TOUCH_EVERY_NS * max(TOUCH_PINS, len(touched)) // TOUCH_PINS
        asked = {f"d {pin}": period_ns for pin in touched}
        if config.battery_pin is not None:
            asked[f"a {config.battery_pin}"] = BATTERY_EVERY_NS
        return asked

    def answer(self, question: str, value: int, now_ns: int) -> None:
        """Take what a pin reads."""
        kind, pin = question.split()
        if kind == "a":
            self._take_battery(value * self._config.battery_volts_per_count, now_ns)
            return
        config = self._config
        self._active.pop(question, None)
        if int(pin) in config.bumper_pins and value == config.bumper_active:
            self._active[question] = codes.BUMPER
        elif int(pin) in config.cliff_pins and value == config.cliff_active:
            self._active[question] = codes.CLIFF

    def alarms(self) -> tuple[str, ...]:
        """Return the codes that hold now."""
        found = set(self._active.values())
        if self._is_empty:
            found.add(codes.BATTERY)
        return tuple(sorted(found))

    def _take_battery(self, voltage: float, now_ns: int) -> None:
        empty, full = self._config.battery_empty_v, self._config.battery_full_v
        share = (voltage - empty) / (full - empty)
        self.battery = Battery(fraction=min(1.0, max(0.0, share)), voltage=voltage)
        if share >= 0.0:
            self._low_since_ns = None
        elif self._low_since_ns is None:
            self._low_since_ns = now_ns
        if self._low_since_ns is not None and now_ns - self._low_since_ns >= EMPTY_FOR_NS:
            self._is_empty = True
        elif share >= RECOVERED_SHARE:
            self._is_empty = False
