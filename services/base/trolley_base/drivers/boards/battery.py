"""A battery whose voltage, or whose charge, a board measures."""

from trolley import codes
from trolley.config.hardware import InputsConfig
from trolley.messages import Battery

EMPTY_FOR_NS = 2_000_000_000
"""Motors that set off pull the voltage down for a moment."""
RECOVERED_SHARE = 0.1
"""An empty battery recovers a little as soon as nothing is driven; this share of the range from
empty to full above the limit it counts as charged again."""


class BatteryGauge:
    """Makes a charge of voltages, and says when the battery is empty.

    Attributes:
        battery: the newest charge, None if it is not known.

    Args:
        config: which voltages are empty and full.
    """

    def __init__(self, config: InputsConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self.battery: Battery | None = None
        self._low_since_ns: int | None = None
        self._is_empty = False

    def take_voltage(self, voltage: float, now_ns: int) -> None:
        """Take a voltage [V]."""
        empty, full = self._config.battery_empty_v, self._config.battery_full_v
        share = (voltage - empty) / (full - empty)
        self.battery = Battery(fraction=min(1.0, max(0.0, share)), voltage=voltage)
        self._judge(share, now_ns)

    def take_charge(
        self, share: float, empty: float, voltage: float, now_ns: int, *, charging: bool
    ) -> None:
        """Take a charge that the board knows.

        Args:
            share: of the capacity.
            empty: the share below which the battery is empty.
            voltage: [V].
            now_ns: the time.
            charging: whether it is being charged.
        """
        fraction = min(1.0, max(0.0, share))
        self.battery = Battery(fraction=fraction, voltage=voltage, charging=charging)
        self._judge(share - empty, now_ns)

    def _judge(self, share: float, now_ns: int) -> None:
        """Decide whether it is empty: below 0 is what its owner calls so."""
        if share >= 0.0:
            self._low_since_ns = None
        elif self._low_since_ns is None:
            self._low_since_ns = now_ns
        if self._low_since_ns is not None and now_ns - self._low_since_ns >= EMPTY_FOR_NS:
            self._is_empty = True
        elif share >= RECOVERED_SHARE:
            self._is_empty = False

    def alarms(self) -> tuple[str, ...]:
        """Return the codes that hold now."""
        return (codes.BATTERY,) if self._is_empty else ()
