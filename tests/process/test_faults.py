"""The program that breaks a robot: two of its faults, and that it sees what is wrong."""

import dataclasses
import signal
from collections.abc import Generator

import pytest
from bench.faults.cases import COMMAND_LOST_S, FAULTS, POSE_LOST_S, Fault, disturb
from bench.faults.robot import Rig
from bench.faults.saved import lost

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Generator[Rig]:
    with Rig(tmp_path_factory.mktemp("rig")) as running:
        running.prepare()
        yield running


def test_robot_stands_while_its_planner_is_cut_off_and_drives_again(rig: Rig) -> None:
    fault = FAULTS["network"]()[0]
    outcome = disturb(rig, dataclasses.replace(fault, lasts_s=2.0))
    assert outcome.wrong == []
    assert outcome.lost == []
    assert outcome.stood_s is not None


def test_a_frozen_planner_is_started_again(rig: Rig) -> None:
    fault = Fault(
        "planner frozen for good",
        "",
        lambda rig: rig.signal("planner", signal.SIGSTOP),
        stands_s=COMMAND_LOST_S,
        restarts="planner",
    )
    outcome = disturb(rig, fault)
    assert outcome.wrong == []
    assert "planner hangs; killing it" in rig.reports


def test_a_robot_that_has_found_itself_again_need_not_have_stood(rig: Rig) -> None:
    fault = Fault("a moment", "", lambda _: None, stands_s=POSE_LOST_S, until_found=True)
    outcome = disturb(rig, fault)
    assert outcome.wrong == []
    assert outcome.stood_s is None


def test_what_is_lost_is_seen(rig: Rig) -> None:
    before = rig.saved()
    assert {"poses.toml", "tours.toml", "zones/apartment.toml"} <= set(before.kept)
    assert lost(before, before) == []
    other = dataclasses.replace(
        before,
        kept={**before.kept, "poses.toml": b""},
        trips=frozenset(),
        broken=("tours.toml.broken-1",),
    )
    found = " ".join(lost(before, other))
    for word in ("poses.toml has changed", "from the history", "tours.toml.broken-1 is broken"):
        assert word in found
