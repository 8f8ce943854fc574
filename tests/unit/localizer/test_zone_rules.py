"""What a zone may be, and the file that comes with a map."""

from pathlib import Path

import msgspec
import pytest

from trolley import codes, topics
from trolley.codes import Refused
from trolley.messages import Zone, Zones
from trolley.zones import MAX_ZONES, check_zone, with_zone, without_zone
from trolley_localizer.zone_rules import mirror_lines, read_seeds

MIRROR = Zone(name="hall", kind="mirror", points=[(0.0, 0.0), (1.0, 0.0)])
SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
BOW_TIE = [(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]


def test_the_name_of_the_key_is_normalised_and_rules() -> None:
    assert check_zone(MIRROR, "hall") == MIRROR
    decomposed = Zone(name="", kind="keepout", points=SQUARE)
    assert check_zone(decomposed, "Ku\u0308che").name == "K\u00fcche"


@pytest.mark.parametrize(
    ("zone", "name"),
    [
        (MIRROR, "kitchen"),
        (MIRROR, ".hidden"),
        (Zone(name="a", kind="mirror", points=[(1.0, 1.0), (1.0, 1.0)]), "a"),
        (Zone(name="a", kind="keepout", points=[(0.0, 0.0), (1.0, 0.0)]), "a"),
        (Zone(name="a", kind="keepout", points=BOW_TIE), "a"),
        (Zone(name="a", kind="keepout", points=[(0.0, 0.0), (1e300, 0.0), (0.0, 1e300)]), "a"),
        (Zone(name="a", kind="mirror", points=[(-1e308, 0.0), (1e308, 0.0)]), "a"),
        (Zone(name="a", kind="speed", points=SQUARE), "a"),
        (Zone(name="a", kind="keepout", points=SQUARE, speed=0.2), "a"),
    ],
)
def test_what_is_no_zone_is_refused(zone: Zone, name: str) -> None:
    with pytest.raises(Refused) as refused:
        check_zone(zone, name)
    assert refused.value.code == codes.BAD_REQUEST


def test_zones_are_replaced_by_name_and_deleted() -> None:
    zones = with_zone([], MIRROR)
    moved = check_zone(Zone(name="hall", kind="glass", points=[(0.0, 0.0), (2.0, 0.0)]), "hall")
    zones = with_zone(zones, moved)
    assert zones == [moved]
    assert without_zone(zones, "hall") == ([], moved)
    with pytest.raises(Refused):
        without_zone([], "hall")


def test_there_is_an_end_to_zones() -> None:
    many = [Zone(name=f"z{i}", kind="mirror", points=MIRROR.points) for i in range(MAX_ZONES)]
    with pytest.raises(Refused) as refused:
        with_zone(many, MIRROR)
    assert refused.value.code == codes.TOO_LARGE


def test_zones_never_outgrow_the_message_that_tells_them() -> None:
    """A planner drops a message that is too large, with all no-go areas in it."""
    zones: list[Zone] = []
    points = [(0.5, 1.5), (2.5, 1.5)] * 5000
    mirrors = [Zone(name=f"m{i}", kind="mirror", points=points) for i in range(6)]
    for mirror in mirrors[:5]:
        zones = with_zone(zones, mirror)
    with pytest.raises(Refused) as refused:
        with_zone(zones, mirrors[5])
    assert refused.value.code == codes.TOO_LARGE
    message = Zones(stamp_ns=2**63 - 1, map="m" * 64, zones=zones)
    assert len(msgspec.msgpack.encode(message)) <= topics.ZONES.max_bytes


def test_mirrors_and_glass_are_lines_to_the_localizer() -> None:
    keepout = Zone(name="stairs", kind="keepout", points=SQUARE)
    assert [line.shape for line in mirror_lines([MIRROR, keepout])] == [(2, 2)]


def test_seeds_lie_beside_the_map(tmp_path: Path) -> None:
    assert read_seeds(tmp_path / "home.yaml") == []
    file = tmp_path / "home.zones.toml"
    file.write_text('[[zones]]\nname = "hall"\nkind = "mirror"\npoints = [[0, 0], [1, 0]]\n')
    assert read_seeds(tmp_path / "home.yaml") == [MIRROR]
    for broken in (
        "[[zones",
        "[[zones]]\nname = 3\n",
        '[[zones]]\nname = ".x"\nkind = "mirror"\npoints = [[0, 0], [1, 0]]\n',
    ):
        file.write_text(broken)
        problem = read_seeds(tmp_path / "home.yaml")
        assert isinstance(problem, str)
        assert "home.zones.toml" in problem
