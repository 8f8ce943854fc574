"""Drivers of other packages: found by their entry points; one that is of no use stops nothing."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import pytest

from trolley import drivers
from trolley.cli.init import render
from trolley.doctor.devices import check_drivers
from trolley.doctor.finding import Level
from trolley.drivers import Driver, Drivers, DriverUnusable, guarded, read_settings
from trolley_base.drivers.boards.models import BoardDriver
from trolley_base.drivers.lidars.models import LidarDriver

Install = Callable[..., None]

GOOD = """
from typing import Annotated
from msgspec import Meta, Struct
from trolley_base.drivers.lidars.models import LidarDriver
from trolley_base.drivers.lidars import ld19

class OwnSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    "What its calibration sheet says."
    add_m: Annotated[float, Meta(ge=-0.1, le=0.1)] = 0.0
    "Added to each distance."

DRIVERS = {
    name: LidarDriver(ld19.FACTS, ld19.DRIVERS["ld19"].make, api=1, settings=OwnSettings)
    for name in ("good", "ld19", "Bad-Name")
}
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package with one module, as pip leaves it: `install("acme", text, "good")`."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(package: str, text: str, *names: str, group: str = drivers.LIDARS) -> None:
        (tmp_path / f"{package}.py").write_text(text)
        info = tmp_path / f"{package}-2.1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 2.1\n")
        lines = [f"{name} = {package}:DRIVERS\n" for name in names]
        (info / "entry_points.txt").write_text(f"[{group}]\n" + "".join(lines))
        monkeypatch.delitem(sys.modules, package, raising=False)

    return put


def test_a_driver_of_another_package_is_one_like_ours(install: Install) -> None:
    install("acme", GOOD, "good")
    known = Drivers(LidarDriver)
    assert known.added == ("good",)
    assert known.names[0] == "rplidar_a1"
    assert known.names[-1] == "good"
    assert known["good"].facts.title == "LD19"
    assert known.refused() == []
    text = render({})
    choice = f'or "{known.names[-2]}" or a driver of another package or "good"'
    assert choice in " ".join(text.split("\n# "))
    assert "# With good: What its calibration sheet says.\n# [base.lidar.settings]\n" in text
    assert [one.level for one in check_drivers()] == [Level.OK]


def test_only_the_driver_that_is_asked_for_is_imported(install: Install) -> None:
    install("acme", GOOD, "good")
    install("worse", "raise SystemExit('import it and die')", "worse")
    known = Drivers(LidarDriver)
    assert known.find("good")
    assert {"acme", "worse"} & set(sys.modules) == {"acme"}
    assert known.find("ld19")
    fresh = Drivers(LidarDriver)
    assert fresh.find("ld19")
    assert "_entries" not in vars(fresh), "other packages were asked for one of ours"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import no_such_library\nDRIVERS = {}", "ModuleNotFoundError: No module named"),
        ("this is no Python", "cannot be imported (SyntaxError"),
        ("raise SystemExit('no display')", "cannot be imported (SystemExit: no display)"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("DRIVER = None", "AttributeError"),
        ("DRIVERS = [1]", "acme:DRIVERS is not a dict that has 'good'"),
        ("DRIVERS = {'other': 1}", "acme:DRIVERS is not a dict that has 'good'"),
        ("DRIVERS = {'good': object()}", "acme:DRIVERS has no driver of a lidar there"),
        (
            "from trolley_base.drivers.boards.hoverboard import DRIVERS as theirs\n"
            "DRIVERS = {'good': theirs['hoverboard']}",
            "acme:DRIVERS has no driver of a lidar there",
        ),
        (GOOD.replace("api=1", "api=7"), "written for version 7 of the interface of drivers"),
        (GOOD.replace("api=1", "api=1, spins=True"), "TypeError"),
        (GOOD.replace("api=1, ", ""), "TypeError"),
    ],
)
def test_a_driver_that_cannot_be_used_is_named_with_the_reason(
    install: Install, text: str, why: str
) -> None:
    install("acme", text, "good")
    install("fine", GOOD.replace('"good"', '"fine"'), "fine")
    known = Drivers(LidarDriver)
    (refused,) = known.refused()
    assert str(refused).startswith("The driver of the lidar good in acme 2.1 is not used: ")
    assert why in str(refused)
    assert list(known)[-2:] == ["coin_d4", "fine"]
    assert known.get("good") is None
    with pytest.raises(DriverUnusable, match=r"acme 2\.1 is not used"):
        known.find("good")
    said = {one.level: one for one in check_drivers()}
    assert why in said[Level.WARNING].sentence
    assert "The driver fine can be used." in said[Level.OK].sentence


def test_a_name_that_is_taken_or_none_is_refused(install: Install) -> None:
    install("acme", GOOD, "ld19", "good", "Bad-Name")
    install("zebra", GOOD, "good")
    known = Drivers(LidarDriver)
    why = {(one.name, one.package): one.why for one in known.refused()}
    assert "Trolley itself has one" in why["ld19", "acme 2.1"]
    assert "acme 2.1 has one of this name" in why["good", "zebra 2.1"]
    assert "characters of a-z" in why["Bad-Name", "acme 2.1"]
    assert len(why) == 3
    assert known.find("ld19").page == "ld19.md"
    assert known.find("good").settings.__module__ == "acme"
    with pytest.raises(DriverUnusable, match=r"no lidar .Bad-Name.*Bad-Name in acme 2\.1"):
        known.find("Bad-Name")
    with pytest.raises(DriverUnusable, match="there is no motor board 'ld19', only linorobot,"):
        Drivers(BoardDriver).find("ld19")


def test_all_of_ours_can_be_used_and_have_a_page() -> None:
    pages = Path(__file__).parents[2] / "docs/hardware"
    for group in (drivers.BOARDS, drivers.LIDARS):
        known = Drivers(Driver, group)
        assert known.refused() == []
        for driver in known.values():
            assert (pages / driver.page.partition("#")[0]).exists()
            assert driver.emulator


def test_what_fails_while_it_is_asked_gives_nothing_and_says_so() -> None:
    noted: list[str] = []
    assert guarded(lambda number: 1 / number, noted.append)(0) is None
    assert noted == ["ZeroDivisionError: division by zero"]
    assert guarded(lambda number: 1 / number, noted.append)(2) == 0.5


class OwnSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    add_m: Annotated[float, msgspec.Meta(ge=-0.1, le=0.1)]


def test_settings_of_a_driver_are_checked_by_what_it_declares() -> None:
    table = "base.lidar.settings"
    assert read_settings({"add_m": 0.05}, OwnSettings, table) == OwnSettings(add_m=0.05)
    for plain, why in (
        ({}, r"\[base.lidar.settings\] missing key `add_m`"),
        ({"add_m": 1}, r"\[base.lidar.settings.add_m\] it must be at most 0.1"),
        ({"add_m": 0.0, "x": 1}, r"\[base.lidar.settings\] unknown key `x`"),
    ):
        with pytest.raises(DriverUnusable, match=why):
            read_settings(plain, OwnSettings, table)
