"""Bumpers, cliff sensors, sonars and a battery on pins of the board."""

import math

from trolley import codes
from trolley.config.hardware import InputsConfig
from trolley.drivers import FELT_KEPT_S, BoardSensor
from trolley.messages import Battery, Scan
from trolley_base.drivers.boards.battery import BatteryGauge
from trolley_base.drivers.boards.sonar import sonar_scan, sonar_sensor
from trolley_base.drivers.interface import Contact

TOUCH_EVERY_NS, TOUCH_PINS = 40_000_000, 2
"""Two pins are read this often: with the answer and a period of base, the wheels are told to stop
within 0.1 s. More of them share the same part of the line."""
BATTERY_EVERY_NS = 1_000_000_000
SONAR_EVERY_NS = 100_000_000
"""Each sonar is read this often where there is one; more of them share the time: while a board
waits for an echo, 18 ms without one, it does nothing else."""
SONAR_MIN_M, SONAR_MAX_M, SONAR_CONE_RAD = 0.02, 3.0, math.radians(20.0)
"""Of Parallax's PING))), by its data sheet; of its cone the part in which it sees a broad thing."""
CM = 0.01
AHEAD = (math.radians(-60.0), math.radians(60.0))
"""Where bumpers and cliff sensors on pins are taken to be: with one active the robot may only back
away."""


def wired_sensors(config: InputsConfig) -> tuple[BoardSensor, ...]:
    """Return what the pins feel, for robot.toml."""
    felt = {
        codes.BUMPER: (config.bumper_pins, "bumpers", "around what it has hit"),
        codes.CLIFF: (config.cliff_pins, "cliff sensors", "around the edge that it has met"),
    }
    touched = (
        BoardSensor(
            name=name,
            meaning=f"the {what} on its pins. For a minute the robot drives {where}. They are "
            "taken to be in front: the echoes lie along its footprint there; so it has no pose.",
            settings={"kept_s": FELT_KEPT_S},
        )
        for name, (pins, what, where) in felt.items()
        if pins
    )
    sonars = (
        sonar_sensor(name, f"the sonar on its pin {pin}") for name, pin in config.sonar_pins.items()
    )
    return (*touched, *sonars)


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
        period_ns = SONAR_EVERY_NS * len(config.sonar_pins)
        asked |= {f"p {pin}": period_ns for pin in config.sonar_pins.values()}
        if config.battery_pin is not None:
            asked[f"a {config.battery_pin}"] = BATTERY_EVERY_NS
        return asked

    def answer(self, question: str, value: int, now_ns: int) -> Scan | None:
        """Take what a pin reads; return what a sonar measured."""
        kind, pin = question.split()
        if kind == "a":
            self._gauge.take_voltage(value * self._config.battery_volts_per_count, now_ns)
            return None
        config = self._config
        if kind == "p":
            name = next(name for name, its in config.sonar_pins.items() if its == int(pin))
            return sonar_scan(
                name,
                now_ns,
                value * CM,
                cone_rad=SONAR_CONE_RAD,
                range_min=SONAR_MIN_M,
                range_max=SONAR_MAX_M,
            )
        self._active.pop(question, None)
        if int(pin) in config.bumper_pins and value == config.bumper_active:
            self._active[question] = codes.BUMPER
        elif int(pin) in config.cliff_pins and value == config.cliff_active:
            self._active[question] = codes.CLIFF
        return None

    def contacts(self) -> tuple[Contact, ...]:
        """Return what bumpers and cliff sensors feel."""
        config, active = self._config, self._active.values()
        there = {codes.BUMPER: config.bumper_pins, codes.CLIFF: config.cliff_pins}
        return tuple(
            Contact(code, (AHEAD,) if code in active else ())
            for code, pins in there.items()
            if pins
        )

    def alarms(self) -> tuple[str, ...]:
        """Return the codes that hold now."""
        return tuple(sorted({*self._active.values(), *self._gauge.alarms()}))
