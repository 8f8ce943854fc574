"""Keeps an inertial unit on an I2C bus going: a thread that reads it, and stores what it read.

What fails is tried again: a read at the next period, after several the whole chip, with pauses that
grow. The robot drives on by its wheels meanwhile.
"""

import errno
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from trolley.config.hardware import ImuConfig
from trolley.messages import Imu
from trolley.serial_diagnosis import own_unit
from trolley_base.drivers.boards.lino_messages import turned
from trolley_base.drivers.imus import CHIPS
from trolley_base.drivers.imus.bus import Bus
from trolley_base.drivers.imus.models import PERIOD_S, Chip, ImuError, Sample
from trolley_base.drivers.interface import Note
from trolley_base.units import NS_PER_S

MOST_STORED = 64
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
MOST_ERRORS = 5
"""Reads that fail in a row: then the chip is started anew."""
MOST_SAME = 50
"""No reading is the same so often: noise moves its last digit. A chip that has lost its supply for
a moment sleeps, and repeats itself."""
SILENT_S = 1.0
"""A chip that has had nothing to say for this long has stopped."""
LAG_S = 0.005
"""How much older than its reading a measurement is: the low pass, and half of a sample [s]."""


class I2cImu:
    """One chip and its thread.

    Args:
        config: which, where, and how it is mounted.
        open_bus: opens a bus by its number.
    """

    def __init__(self, config: ImuConfig, open_bus: Callable[[int], Bus]) -> None:
        self._config = config
        self._facts = CHIPS[config.chip]
        self._address = config.address or self._facts.address
        self._open_bus = open_bus
        self._lock = threading.Lock()
        self._samples: deque[tuple[int, Sample]] = deque(maxlen=MOST_STORED)
        self._counts: Counter[str] = Counter()
        self._trouble = ""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="imu", daemon=True)

    def start(self) -> None:
        """Begin to open the bus and to read."""
        self._thread.start()

    def take(
        self, robot_ns: Callable[[int], int]
    ) -> tuple[tuple[Imu, ...], tuple[Note, ...], dict[str, int]]:
        """Return what was measured since the last call, what there is to say, and counts.

        Args:
            robot_ns: turns local monotonic time into robot time [ns].
        """
        with self._lock:
            samples, counts = list(self._samples), dict(self._counts)
            self._samples.clear()
            self._counts.clear()
            trouble = self._trouble
        axes = self._config.axes
        found = tuple(
            Imu(
                stamp_ns=robot_ns(at_ns),
                angular_velocity=turned(sample.rates, axes),
                linear_acceleration=turned(sample.accelerations, axes),
            )
            for at_ns, sample in samples
        )
        notes = (Note("warning", "imu/trouble", trouble),) if trouble else ()
        return found, notes, counts

    def close(self) -> None:
        """End the thread, and let go of the bus."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._end.is_set():
            try:
                bus = self._open_bus(self._config.bus)
                try:
                    chip = self._facts.make(self._address)
                    chip.begin(bus, self._wait)
                    pause_s = FIRST_PAUSE_S
                    self._serve(bus, chip)
                finally:
                    bus.close()
            except (OSError, ImuError) as error:
                self._say(self._explain(error))
                self._count("imu/lost")
            self._end.wait(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _wait(self, seconds: float) -> None:
        self._end.wait(seconds)

    def _serve(self, bus: Bus, chip: Chip) -> None:
        """Read the chip until it fails.

        Raises:
            OSError: it does not answer any more.
            ImuError: it does, but measures nothing.
        """
        errors = same = 0
        before: Sample | None = None
        next_s = heard_s = time.monotonic()
        while not self._end.is_set():
            begun_ns = time.monotonic_ns()
            try:
                sample = chip.read(bus)
            except OSError:
                errors += 1
                self._count("imu/errors")
                if errors >= MOST_ERRORS:
                    raise
            else:
                errors = 0
                if sample is not None:
                    heard_s = time.monotonic()
                    same = same + 1 if sample == before else 0
                    before = sample
                    self._keep((begun_ns + time.monotonic_ns()) // 2, sample)
                if same >= MOST_SAME:
                    raise ImuError("repeats one and the same reading: it hangs, or sleeps")
                if time.monotonic() - heard_s > SILENT_S:
                    raise ImuError("has stopped measuring")
            next_s = max(next_s + PERIOD_S, time.monotonic())
            self._end.wait(next_s - time.monotonic())

    def _keep(self, read_ns: int, sample: Sample) -> None:
        if not all(map(math.isfinite, (*sample.rates, *sample.accelerations))):
            return
        with self._lock:
            self._samples.append((read_ns - round(LAG_S * NS_PER_S), sample))
            self._trouble = ""

    def _say(self, text: str) -> None:
        with self._lock:
            self._trouble = text

    def _count(self, name: str) -> None:
        with self._lock:
            self._counts[name] += 1

    def _explain(self, error: OSError | ImuError) -> str:
        title = f"{self._facts.title} at 0x{self._address:02X} of /dev/i2c-{self._config.bus}"
        if isinstance(error, ImuError):
            return f"The {title} {error}."
        if isinstance(error, FileNotFoundError):
            return (
                f"/dev/i2c-{self._config.bus} is not there: switch I2C on (on a Raspberry Pi: "
                "raspi-config, Interface Options, I2C), or name another [base.imu] bus."
            )
        if isinstance(error, PermissionError):
            if (unit := own_unit()) is not None:
                return (
                    f"/dev/i2c-{self._config.bus} may not be used by {unit}: `sudo systemctl edit "
                    f"{unit}`, write [Service] and below it SupplementaryGroups=i2c and "
                    "DeviceAllow=char-89 rw, and restart it."
                )
            return (
                f"/dev/i2c-{self._config.bus} may not be used: put this user into the group i2c "
                "(sudo usermod -aG i2c $USER), and log in again."
            )
        if error.errno in (errno.EREMOTEIO, errno.ENXIO, errno.EIO, errno.ETIMEDOUT):
            return (
                f"No answer from the {title}: check its wiring and supply; "
                f"`i2cdetect -y {self._config.bus}` shows which addresses answer."
            )
        return f"The {title} cannot be read: {error.strerror or error}."
