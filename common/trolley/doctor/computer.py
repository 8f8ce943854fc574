"""Checks of the computer itself: system, clock, processor, memory, disk, Wi-Fi."""

import dataclasses

from trolley.doctor.finding import Finding, note, ok, problem, warning

MB = 10**6
OLDEST_PYTHON, NEWEST_PYTHON = (3, 11), (3, 13)
FIRST_YEAR, LAST_YEAR = 2026, 2100
"""A clock that says less or more was never set."""
HOT_C, TOO_HOT_C = 75.0, 85.0
"""A Raspberry Pi slows down at 80 °C, and again at 85 °C."""
WEAK_DBM, LOST_DBM = -70.0, -80.0
DRIVERS_OF_THEIR_OWN = ("intel_pstate", "amd-pstate-epp")
"""Whose `powersave` is no fixed low speed but the usual setting."""

# Bits of `vcgencmd get_throttled` (Raspberry Pi documentation, "vcgencmd"): 0-3 now, 16-19 since
# the start: under-voltage, capped frequency, throttled, soft temperature limit.
UNDER_VOLTAGE, SLOWED = 1 << 0, 1 << 1 | 1 << 2 | 1 << 3
SINCE_START = 16
POWER_REMEDY = "Use a stronger supply and a short, thick cable; motors need a supply of their own."


@dataclasses.dataclass(frozen=True)
class System:
    """What runs here."""

    bits: int
    """Word size of the programs, which may be less than the processor's [bits]."""
    python: tuple[int, int]
    system: str
    machine: str


def check_system(facts: System) -> list[Finding]:
    """Whether Trolley can be installed on this at all."""
    python = ".".join(map(str, facts.python))
    if facts.system != "Linux":
        return [problem("system", f"This is {facts.system}.", "Trolley needs 64-bit Linux.")]
    if facts.bits != 64:
        return [
            problem(
                "system",
                f"The programs here are {facts.bits}-bit; numba is not available for that.",
                "Install a 64-bit system, such as Raspberry Pi OS (64-bit).",
            )
        ]
    if not OLDEST_PYTHON <= facts.python <= NEWEST_PYTHON:
        return [problem("system", f"Python {python} is not supported.", "Use Python 3.11 to 3.13.")]
    return [ok("system", f"64-bit Linux on {facts.machine}, Python {python}.")]


@dataclasses.dataclass(frozen=True)
class WallClock:
    """The host's clock."""

    year: int
    is_synchronised: bool


def check_clock(facts: WallClock) -> list[Finding]:
    """Whether the host knows the time."""
    if not FIRST_YEAR <= facts.year < LAST_YEAR:
        return [
            problem(
                "clock",
                f"The clock of this computer says it is the year {facts.year}.",
                "Connect it to the internet, or set the time: "
                "`sudo date -s '2026-05-01 12:00'`; certificates are refused until then.",
            )
        ]
    if not facts.is_synchronised:
        return [
            warning(
                "clock",
                "The clock of this computer is not synchronised, so scheduled tours do not start "
                "and nothing is dated.",
                "`sudo timedatectl set-ntp true`, and make sure that it reaches the internet.",
            )
        ]
    return [ok("clock", "The clock is synchronised.")]


@dataclasses.dataclass(frozen=True)
class Processor:
    """The processor; what is None or empty this computer does not tell."""

    cores: int
    load: float | None = None
    """Processes that run or wait, on average over a minute."""
    governors: tuple[str, ...] = ()
    driver: str = ""
    throttled: int | None = None
    """The word of `vcgencmd get_throttled`."""
    celsius: float | None = None
    """Temperature of its hottest sensor."""


def check_processor(facts: Processor) -> list[Finding]:
    """Whether the processor is as fast as it can be."""
    return [
        *_check_governor(facts),
        *_check_power(facts.throttled),
        *_check_temperature(facts.celsius),
        *_check_load(facts),
    ]


def _check_governor(facts: Processor) -> list[Finding]:
    slow = {"powersave"} & {*facts.governors}
    if slow and facts.driver not in DRIVERS_OF_THEIR_OWN:
        return [
            warning(
                "processor",
                "The processor is set to its lowest speed (governor powersave).",
                "`echo ondemand | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor`",
            )
        ]
    if not facts.governors:
        return [ok("processor", "Its speed cannot be set from here.")]
    return [ok("processor", f"Governor {', '.join(sorted({*facts.governors}))}.")]


def _check_power(word: int | None) -> list[Finding]:
    if word is None:
        return []
    if word & UNDER_VOLTAGE:
        return [problem("power", "The supply voltage is too low now.", POWER_REMEDY)]
    if word >> SINCE_START & UNDER_VOLTAGE:
        return [
            warning("power", "The supply voltage was too low since the last start.", POWER_REMEDY)
        ]
    if word & SLOWED:
        return [
            warning(
                "power", "The processor is being slowed down (heat).", "Cool it: heat sink, fan."
            )
        ]
    if word >> SINCE_START & SLOWED:
        return [note("power", "The processor was slowed down since the last start (heat).")]
    return [ok("power", "The supply voltage is good.")]


def _check_temperature(celsius: float | None) -> list[Finding]:
    if celsius is None:
        return [ok("temperature", "This computer does not report its temperature.")]
    text = f"The processor is at {celsius:.0f} °C."
    if celsius >= TOO_HOT_C:
        return [problem("temperature", text, "Cool it: heat sink, fan, air to its case.")]
    if celsius >= HOT_C:
        return [warning("temperature", text, "Cool it before it slows down: heat sink, fan.")]
    return [ok("temperature", text)]


def _check_load(facts: Processor) -> list[Finding]:
    if facts.load is None:
        return []
    text = f"{facts.load:.1f} programs are competing for {facts.cores} cores"
    if facts.load > 1.5 * facts.cores:
        return [
            warning(
                "processor",
                f"The computer is overloaded: {text}.",
                "`trolley top` shows what the services use, `top` the rest; end what is not "
                "needed, or view from another computer.",
            )
        ]
    return [ok("processor", f"Load: {text}.")]


@dataclasses.dataclass(frozen=True)
class Memory:
    """The memory [bytes]."""

    total: int
    available: int
    swap_total: int = 0
    swap_free: int = 0
    killed: int = 0
    """Programs that the kernel ended for lack of memory since the start."""


def check_memory(facts: Memory) -> list[Finding]:
    """Whether there is memory left."""
    remedy = "`trolley top` shows what the services use; run the viewer on another computer."
    text = f"{facts.available // MB} of {facts.total // MB} MB are free."
    found: list[Finding] = []
    if facts.available < 40 * MB:
        found.append(problem("memory", f"Memory is used up: {text}", remedy))
    elif facts.available < 120 * MB:
        found.append(warning("memory", f"Memory is scarce: {text}", remedy))
    else:
        found.append(ok("memory", text))
    swapped = facts.swap_total - facts.swap_free
    if swapped > 100 * MB and swapped > facts.swap_total // 2:
        found.append(
            warning(
                "memory",
                f"{swapped // MB} MB are swapped out, which slows everything down.",
                remedy,
            )
        )
    if facts.killed:
        found.append(
            warning(
                "memory",
                f"For lack of memory the system has killed {facts.killed} programs since it "
                "started.",
                "`journalctl -k | grep -i 'out of memory'` names them; " + remedy,
            )
        )
    return found


@dataclasses.dataclass(frozen=True)
class Disk:
    """The file system that the state lies on."""

    path: str
    free: int
    """Bytes for ordinary users."""
    is_read_only: bool = False
    files: int = 0
    """How many it can hold; 0: as many as there is room for."""
    files_free: int = 0


def check_disk(facts: Disk) -> list[Finding]:
    """Whether something can be saved."""
    where = facts.path
    if facts.is_read_only:
        return [
            problem(
                "disk",
                f"{where} is read-only, so nothing can be saved.",
                "`sudo dmesg | tail` may say why (a worn SD card?); after a repair: "
                "`sudo mount -o remount,rw /`.",
            )
        ]
    text = f"{facts.free // MB} MB are free for {where}."
    clean = "`sudo journalctl --vacuum-size=100M`, `sudo apt clean`, or delete old recordings."
    if facts.free < 100 * MB:
        return [problem("disk", f"The disk is full: {text}", clean)]
    if facts.files and facts.files_free < max(1000, facts.files // 100):
        return [
            problem(
                "disk",
                f"Only {facts.files_free} more files fit on the disk of {where}.",
                "Delete something that consists of many small files.",
            )
        ]
    if facts.free < 500 * MB:
        return [warning("disk", f"The disk is nearly full: {text}", clean)]
    return [ok("disk", text)]


@dataclasses.dataclass(frozen=True)
class Wifi:
    """A wireless connection."""

    name: str
    level_dbm: float
    saves_power: bool | None
    """None: unknown, since `iw` is missing."""


def check_loopback(*, is_up: bool | None) -> list[Finding]:
    """Whether this computer's programs reach each other (None: unknown)."""
    if is_up is False:
        return [
            problem(
                "network",
                "This computer's programs cannot reach each other: its loopback interface is down.",
                "`sudo ip link set lo up`; let the network settings do that at each start.",
            )
        ]
    return [ok("network", "This computer's programs can reach each other.")]


def check_wifi(networks: list[Wifi]) -> list[Finding]:
    """Whether the wireless network is strong, and awake."""
    if not networks:
        return [ok("wi-fi", "This computer uses no Wi-Fi.")]
    found: list[Finding] = []
    for one in networks:
        text = f"{one.name} receives {one.level_dbm:.0f} dBm"
        nearer = "Move the access point or the aerial, or use the 2.4 GHz band."
        if one.level_dbm < LOST_DBM:
            found.append(problem("wi-fi", f"The Wi-Fi is very weak: {text}.", nearer))
        elif one.level_dbm < WEAK_DBM:
            found.append(warning("wi-fi", f"The Wi-Fi is weak: {text}.", nearer))
        else:
            found.append(ok("wi-fi", f"{text}."))
        if one.saves_power:
            found.append(
                warning(
                    "wi-fi",
                    f"{one.name} saves power, which delays everything by up to a second.",
                    f"`sudo iw dev {one.name} set power_save off`; for good: "
                    "`sudo nmcli connection modify NAME wifi.powersave 2`.",
                )
            )
        elif one.saves_power is None:
            found.append(
                note(
                    "wi-fi",
                    f"Whether {one.name} saves power is unknown: `iw` is missing.",
                    "`sudo apt install iw`",
                )
            )
    return found
