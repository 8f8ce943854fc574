"""Bumpers, cliff sensors and a battery on pins of the board."""

from trolley import codes
from trolley.config.hardware import InputsConfig
from trolley.messages import Battery
from trolley_base.drivers.boards.battery import BatteryGauge

TOUCH_EVERY_NS, TOUCH_PINS = 40_000_000, 2
"""Two pins are read this often: with the answer and a period of base, the wheels are told to stop
within 0.1 s. More of them share the same part of the line."""
BATTERY_EVERY_NS = 1_000_000_000


class Inputs:
    """What is asked of the pins, and what the answers mean.

    Args:
        config: what is wired to which pin.
    """

    def __init__(self, config: InputsConfig) -> None:
        self._config = config
        self._gauge = BatteryGauge(config)
        self.reset()

    @property
    def battery(self) -> Battery | None:
        """The newest charge, None if it is not known."""
        return self._gauge.battery

    def reset(self) -> None:
        """Forget what was read."""
        self._gauge.reset()
        self._active: dict[str, str] = {}

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
            self._gauge.take_voltage(value * self._config.battery_volts_per_count, now_ns)
            return
        config = self._config
        self._active.pop(question, None)
        if int(pin) in config.bumper_pins and value == config.bumper_active:
            self._active[question] = codes.BUMPER
        elif int(pin) in config.cliff_pins and value == config.cliff_active:
            self._active[question] = codes.CLIFF

    def alarms(self) -> tuple[str, ...]:
        """Return the codes that hold now."""
        return tuple(sorted({*self._active.values(), *self._gauge.alarms()}))
