"""What doctor says of a computer, good and bad."""

from dataclasses import replace
from pathlib import Path

import pytest

from trolley.doctor import Level
from trolley.doctor.computer import (
    Disk,
    Memory,
    Processor,
    System,
    WallClock,
    Wifi,
    check_clock,
    check_disk,
    check_loopback,
    check_memory,
    check_processor,
    check_system,
    check_wifi,
)
from trolley.doctor.computer_facts import (
    Host,
    read_clock,
    read_disk,
    read_loopback,
    read_memory,
    read_processor,
    read_system,
    read_wifi,
)
from trolley.doctor.finding import Finding

MB = 10**6
PI = System(64, (3, 11), "Linux", "aarch64")
GOOD_DISK = Disk("/var/lib/trolley", 5000 * MB, files=100_000, files_free=90_000)
GOOD_MEMORY = Memory(total=1000 * MB, available=500 * MB)


def worst(findings: list[Finding]) -> Level:
    """The worst level; each that needs something done says what."""
    for finding in findings:
        assert finding.sentence.endswith((".", "!")), finding
        assert finding.remedy or finding.level <= Level.NOTE, finding
    return max((finding.level for finding in findings), default=Level.OK)


@pytest.mark.parametrize(
    ("facts", "level"),
    [
        (PI, Level.OK),
        (replace(PI, bits=32, machine="armv7l"), Level.PROBLEM),
        (replace(PI, python=(3, 10)), Level.PROBLEM),
        (replace(PI, python=(3, 14)), Level.PROBLEM),
        (replace(PI, system="Darwin"), Level.PROBLEM),
    ],
)
def test_system(facts: System, level: Level) -> None:
    assert worst(check_system(facts)) is level


@pytest.mark.parametrize(
    ("facts", "level"),
    [
        (WallClock(2026, is_synchronised=True), Level.OK),
        (WallClock(2026, is_synchronised=False), Level.WARNING),
        (WallClock(1970, is_synchronised=False), Level.PROBLEM),
        (WallClock(2155, is_synchronised=True), Level.PROBLEM),
    ],
)
def test_clock(facts: WallClock, level: Level) -> None:
    assert worst(check_clock(facts)) is level


@pytest.mark.parametrize(
    ("facts", "level", "word"),
    [
        (Processor(4), Level.OK, "cannot be set"),
        (Processor(4, governors=("ondemand",) * 4), Level.OK, "ondemand"),
        (Processor(4, governors=("ondemand", "powersave")), Level.WARNING, "lowest speed"),
        (Processor(4, governors=("powersave",), driver="intel_pstate"), Level.OK, "powersave"),
        (Processor(4, throttled=0), Level.OK, "voltage is good"),
        (Processor(4, throttled=0x50005), Level.PROBLEM, "too low now"),
        (Processor(4, throttled=0x50000), Level.WARNING, "was too low"),
        (Processor(4, throttled=0x20002), Level.WARNING, "slowed down"),
        (Processor(4, throttled=0x40000), Level.NOTE, "was slowed down"),
        (Processor(4, celsius=50.0), Level.OK, "50 °C"),
        (Processor(4, celsius=78.0), Level.WARNING, "78 °C"),
        (Processor(4, celsius=90.0), Level.PROBLEM, "90 °C"),
        (Processor(4, load=3.0), Level.OK, "3.0 programs"),
        (Processor(4, load=9.0), Level.WARNING, "overloaded"),
    ],
)
def test_processor(facts: Processor, level: Level, word: str) -> None:
    found = check_processor(facts)
    assert worst(found) is level
    assert any(word in finding.sentence for finding in found if finding.level is level)


@pytest.mark.parametrize(
    ("facts", "level"),
    [
        (GOOD_MEMORY, Level.OK),
        (replace(GOOD_MEMORY, available=100 * MB), Level.WARNING),
        (replace(GOOD_MEMORY, available=20 * MB), Level.PROBLEM),
        (replace(GOOD_MEMORY, swap_total=400 * MB, swap_free=390 * MB), Level.OK),
        (replace(GOOD_MEMORY, swap_total=400 * MB, swap_free=50 * MB), Level.WARNING),
        (replace(GOOD_MEMORY, killed=1), Level.WARNING),
    ],
)
def test_memory(facts: Memory, level: Level) -> None:
    assert worst(check_memory(facts)) is level


@pytest.mark.parametrize(
    ("facts", "level"),
    [
        (GOOD_DISK, Level.OK),
        (replace(GOOD_DISK, files=0, files_free=0), Level.OK),  # btrfs knows no such limit
        (replace(GOOD_DISK, free=300 * MB), Level.WARNING),
        (replace(GOOD_DISK, free=1 * MB), Level.PROBLEM),
        (replace(GOOD_DISK, files_free=10), Level.PROBLEM),
        (replace(GOOD_DISK, is_read_only=True), Level.PROBLEM),
    ],
)
def test_disk(facts: Disk, level: Level) -> None:
    assert worst(check_disk(facts)) is level


@pytest.mark.parametrize(
    ("networks", "level"),
    [
        ([], Level.OK),
        ([Wifi("wlan0", -50.0, saves_power=False)], Level.OK),
        ([Wifi("wlan0", -50.0, saves_power=None)], Level.NOTE),
        ([Wifi("wlan0", -50.0, saves_power=True)], Level.WARNING),
        ([Wifi("wlan0", -75.0, saves_power=False)], Level.WARNING),
        ([Wifi("wlan0", -90.0, saves_power=False)], Level.PROBLEM),
    ],
)
def test_wifi(networks: list[Wifi], level: Level) -> None:
    assert worst(check_wifi(networks)) is level


WIRELESS = """\
Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan0: 0000   45.  -65.  -256        0      0      0      0      0        0
"""
FILES = {
    "proc/loadavg": "0.52 0.58 0.59 1/467 12345\n",
    "proc/meminfo": "MemTotal: 948280 kB\nMemAvailable: 312000 kB\nSwapTotal: 102396 kB\n"
    "SwapFree: 102000 kB\n",
    "proc/vmstat": "nr_free_pages 100\noom_kill 2\n",
    "proc/net/wireless": WIRELESS,
    "sys/class/thermal/thermal_zone0/temp": "61234\n",
    "sys/class/thermal/thermal_zone1/temp": "broken\n",
    "sys/devices/platform/soc/soc:firmware/get_throttled": "50000\n",
    **{
        f"sys/devices/system/cpu/cpu{i}/cpufreq/{name}": text
        for i in range(4)
        for name, text in {"scaling_governor": "ondemand\n", "scaling_driver": "cpufreq-dt"}.items()
    },
}


@pytest.fixture
def raspberry_pi(tmp_path: Path) -> Host:
    """A Raspberry Pi 3 as its files show it; of programs it has `iw`."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def run(words: object) -> str | None:
        return "Power save: on\n" if words == ["iw", "dev", "wlan0", "get", "power_save"] else None

    return Host(tmp_path, run)


def test_a_computer_is_read_from_its_files(raspberry_pi: Host) -> None:
    processor = read_processor(raspberry_pi)
    assert processor == Processor(
        4, 0.52, ("ondemand",) * 4, "cpufreq-dt", throttled=0x50000, celsius=61.234
    )
    memory = read_memory(raspberry_pi)
    assert memory is not None
    assert (memory.available, memory.killed) == (312_000 * 1024, 2)
    assert read_wifi(raspberry_pi) == [Wifi("wlan0", -65.0, saves_power=True)]


def test_the_firmware_is_asked_where_the_kernel_does_not_tell(tmp_path: Path) -> None:
    host = Host(tmp_path, lambda words: "throttled=0x1\n" if words[0] == "vcgencmd" else None)
    assert read_processor(host).throttled == 1


@pytest.mark.parametrize(("flags", "level"), [("0x9", Level.OK), ("0x8", Level.PROBLEM)])
def test_a_loopback_that_is_down_is_told(tmp_path: Path, flags: str, level: Level) -> None:
    host = Host(tmp_path, lambda _: None)
    assert worst(check_loopback(is_up=read_loopback(host))) is Level.OK
    (tmp_path / "sys/class/net/lo").mkdir(parents=True)
    (tmp_path / "sys/class/net/lo/flags").write_text(f"{flags}\n")
    assert worst(check_loopback(is_up=read_loopback(host))) is level


def test_wifi_is_found_without_the_kernels_table(tmp_path: Path) -> None:
    for name in ("wlan0", "wlan1"):
        (tmp_path / "sys/class/net" / name / "phy80211").mkdir(parents=True)
    said: dict[tuple[str, ...], str] = {
        ("iw", "dev", "wlan0", "link"): "Connected to 00:11:22\n\tsignal: -58 dBm\n",
        ("iw", "dev", "wlan0", "get", "power_save"): "Power save: off\n",
        ("iw", "dev", "wlan1", "link"): "Not connected.\n",
    }
    host = Host(tmp_path, lambda words: said.get(tuple(words)))
    assert read_wifi(host) == [Wifi("wlan0", -58.0, saves_power=False)]


def test_a_computer_that_tells_nothing_is_no_error(tmp_path: Path) -> None:
    host = Host(tmp_path, lambda _: None)
    processor = read_processor(host)
    assert (processor.load, processor.throttled, processor.celsius) == (None, None, None)
    assert worst(check_processor(processor)) is Level.OK
    assert read_memory(host) is None
    assert read_wifi(host) == []


def test_this_computer_can_be_read(tmp_path: Path) -> None:
    assert worst(check_system(read_system())) is Level.OK
    assert read_clock().year >= 2026
    there = read_disk(tmp_path / "not" / "there" / "yet")
    assert there.free > 0
    assert not there.is_read_only
