"""The latch, the stop field and the silences, through the whole service."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trolley import codes, requests, topics
from trolley.geometry import Twist2D
from trolley.messages import BaseState
from trolley.runtime.bus import Reply
from trolley_base.persistence import LATCH_FILE
from trolley_base.simulation.simulated_hardware import SimulatedChassis

from .conftest import EXACT, REAL, MakeRig, Rig


def test_stop_stands_and_resume_lets_drive_again(rig: Rig) -> None:
    rig.drive(1.0, 0.3)
    reply = rig.lockstep.ask(requests.BASE_STOP)
    assert (reply.mode, reply.reason) == ("stopped", codes.BUTTON)
    assert reply.message
    rig.drive(1.0, 0.3)
    assert rig.truth.twist.is_zero
    assert rig.state.mode == "stopped"
    assert rig.lockstep.ask(requests.BASE_RESUME).mode == "ok"
    rig.drive(0.5, 0.3)
    assert rig.truth.twist.vx > 0.2


def test_after_resume_only_new_commands_drive(rig: Rig) -> None:
    rig.lockstep.ask(requests.BASE_STOP)
    rig.send(Twist2D(0.3, 0.0, 0.0), valid_for=0.5)
    rig.lockstep.ask(requests.BASE_RESUME)
    rig.run(0.4)
    assert rig.truth.twist.is_zero


@pytest.mark.parametrize("payload", [b"", b"{}", b'{"x": 1}', b"\xc1garbage", b"[" * 100_000])
def test_stop_works_whatever_the_payload_holds_and_for_all_robots(rig: Rig, payload: bytes) -> None:
    rig.drive(0.5, 0.3)
    (reply,) = rig.lockstep.get("trolley/*/@do/base/stop", payload)
    assert not reply.is_error
    assert json.loads(reply.payload)["mode"] == "stopped"
    rig.run(0.5)
    assert rig.truth.twist.is_zero


def test_reading_everything_moves_and_stops_nothing(rig: Rig) -> None:
    rig.drive(1.0, 0.2)
    replies = rig.lockstep.get("trolley/trolley/**")
    assert not [reply for reply in replies if reply.is_error]
    rig.drive(0.2, 0.2)
    assert rig.state.mode == "ok"


def test_the_latch_outlives_a_restart(rig: Rig) -> None:
    rig.lockstep.ask(requests.BASE_STOP)
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.state.mode == "stopped"
    assert rig.truth.twist.is_zero
    rig.lockstep.ask(requests.BASE_RESUME)
    rig.restart()
    rig.drive(1.0, 0.3)
    assert rig.state.mode == "ok"
    assert rig.truth.twist.vx > 0.2


def test_a_stop_is_answered_when_no_crash_can_undo_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    monkeypatch.setattr(rig.base, "work", lambda fn, then: jobs.append((fn, then)))
    rig.drive(0.5, 0.3)
    jobs.clear()
    replies = ask_to_stop(rig)
    assert rig.state.mode == "stopped"
    assert replies == []
    for fn, then in jobs:
        then(fn())
    assert [json.loads(reply.payload)["mode"] for reply in replies] == ["stopped"]
    rig.restart()
    rig.run(0.1)
    assert rig.state.mode == "stopped"


def test_a_stop_is_saved_later_where_the_disk_was_full(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def fail(path: Path, *_: object, **__: object) -> None:
        tried.append(path.name)
        raise OSError(28, "No space left on device")

    healths = rig.lockstep.record(topics.HEALTH, "base")
    with monkeypatch.context() as full:
        full.setattr("trolley.runtime.state.write_atomically", fail)
        assert rig.lockstep.ask(requests.BASE_STOP).mode == "stopped"
        rig.run(6.0)
        assert tried.count(LATCH_FILE) in (2, 3), "now and then, not over and over"
        assert healths[-1].state == "degraded"
        assert "would be forgotten if base restarted" in healths[-1].message
        assert "No space left on device" in healths[-1].message
    rig.run(6.0)
    assert healths[-1].state == "ok"
    rig.restart()
    rig.run(0.1)
    assert rig.state.mode == "stopped"


def test_a_stop_does_not_queue_behind_the_saves_of_a_flood(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    monkeypatch.setattr(rig.base, "work", lambda fn, then: jobs.append((fn, then)))
    rig.drive(0.5, 0.3)
    jobs.clear()
    published = len(rig.states)
    for _ in range(100):
        rig.lockstep.ask(requests.BASE_RESUME)
    assert len(rig.states) - published < 10  # what says nothing new is not said
    replies = ask_to_stop(rig)
    for _ in range(100):
        rig.lockstep.ask(requests.BASE_RESUME)
    more = ask_to_stop(rig)
    for _ in range(3):
        assert len(jobs) < 10  # one is being written, and where the robot stands now and then
        done, jobs[:] = list(jobs), []
        for fn, then in done:
            then(fn())
    assert [json.loads(reply.payload)["mode"] for reply in replies + more] == ["stopped"] * 2
    rig.restart()
    rig.run(0.1)
    assert rig.state.mode == "stopped"


def test_a_button_that_is_pressed_while_a_resume_is_saved_is_saved_after_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.lockstep.ask(requests.BASE_STOP)
    jobs: list[tuple[Callable[[], object], Callable[[Any], None]]] = []
    monkeypatch.setattr(rig.base, "work", lambda fn, then: jobs.append((fn, then)))
    assert rig.lockstep.ask(requests.BASE_RESUME).mode == "ok"
    read = SimulatedChassis.read
    with monkeypatch.context() as pressed:
        pressed.setattr(
            SimulatedChassis, "read", lambda self: replace(read(self), alarms=(codes.BUTTON,))
        )
        rig.run(0.1)
    assert rig.state.mode == "stopped"
    while jobs:
        fn, then = jobs.pop(0)
        then(fn())
    rig.restart()
    rig.run(0.1)
    assert rig.state.mode == "stopped"


def test_a_stop_is_answered_though_the_disk_hangs(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.base, "work", lambda fn, then: None)
    healths = rig.lockstep.record(topics.HEALTH, "base")
    replies = ask_to_stop(rig)
    rig.run(0.8)
    assert replies == []
    rig.run(0.4)
    assert [json.loads(reply.payload)["mode"] for reply in replies] == ["stopped"]
    rig.run(1.0)
    assert "the disk does not answer" in healths[-1].message


def ask_to_stop(rig: Rig) -> list[Reply]:
    """Ask, and return where the answers will stand."""
    replies: list[Reply] = []
    rig.lockstep.bus.get("trolley/*/@do/base/stop", b"", "", 2.0, replies.append, lambda: None)
    rig.run(0.02)
    return replies


def test_it_stops_five_centimetres_before_a_wall(rig: Rig) -> None:
    rig.drive(12.0, 0.5)
    assert rig.truth.twist.is_zero
    assert rig.truth.clearance == pytest.approx(0.05, abs=0.006)
    assert (rig.state.mode, rig.state.reason) == ("held", codes.STOP_FIELD)
    rig.drive(2.0, -0.5)
    assert rig.truth.clearance > 0.5
    assert rig.state.mode == "ok"


@pytest.mark.parametrize("delay_s", [pytest.param(0.1, marks=pytest.mark.slow), 0.3])
def test_motors_that_follow_late_stop_before_the_wall_as_well(
    make_rig: MakeRig, delay_s: float
) -> None:
    motors = f"[motors]\ndelay_s = {delay_s}\njitter_s = 0.05\nuneven = 0.1\n"
    rig = make_rig(errors=EXACT + motors, simulated={"start": {"x": 0.0, "y": 0.0, "yaw": 0.3}})
    rig.drive(12.0, 0.5)
    assert rig.truth.twist.is_zero
    assert rig.truth.collisions == 0
    assert 0.03 < rig.truth.clearance < 0.15
    rig.drive(2.0, -0.5)
    assert rig.truth.clearance > 0.3
    rig.drive(4.0, 0.5, 0.5)
    assert rig.truth.collisions == 0


def test_after_a_stop_before_a_post_it_turns_clear(make_rig: MakeRig) -> None:
    rig = make_rig(things="[[circle]]\nx = 1.0\ny = 0.0\nradius_m = 0.05")
    rig.drive(5.0, 0.4)
    assert rig.truth.clearance == pytest.approx(0.05, abs=0.01)
    rig.drive(3.0, 0.0, 1.0)
    assert rig.truth.pose.yaw > 1.0
    rig.drive(2.0, 0.4)
    assert rig.truth.clearance > 0.2
    assert rig.truth.collisions == 0


def test_a_turn_in_place_beside_a_box_stops_before_the_corner_meets_it(
    make_rig: MakeRig,
) -> None:
    # The gap of 3 cm is less than the 7 cm that the corners stick out beyond the sides.
    box = "[[box]]\nx = 0.0\ny = 0.20\nlength_m = 0.6\nwidth_m = 0.1"
    rig = make_rig(things=box)
    rig.drive(3.0, 0.0, 1.0)
    assert rig.truth.collisions == 0
    assert rig.truth.clearance > 0.005
    rig.drive(3.0, 0.0, -1.0)
    assert rig.truth.collisions == 0
    rig.drive(4.0, 0.3)
    assert rig.truth.pose.x > 0.5, "along the box it gets out"


def test_a_box_that_is_put_in_its_way_stops_it(make_rig: MakeRig) -> None:
    person = "[[person]]\npath = [[1.2, 0.0]]\nradius_m = 0.1"
    rig = make_rig(things=person)
    rig.drive(8.0, 0.5)
    assert rig.truth.collisions == 0
    assert rig.truth.clearance == pytest.approx(0.05, abs=0.01)


def cluttered(seed: int) -> str:
    """A dozen boxes and posts anywhere but where the robot starts."""
    rng = np.random.default_rng(seed)
    things: list[str] = []
    for index, (x, y) in enumerate(rng.uniform([-2.8, -1.8], [2.8, 1.8], (16, 2))):
        yaw, length, width = rng.uniform([0.0, 0.05, 0.03], [3.1, 0.4, 0.3])
        if np.hypot(x, y) < 0.55:
            continue
        where = f"x = {x:.3f}\ny = {y:.3f}"
        things.append(
            f"[[box]]\n{where}\nyaw = {yaw:.3f}\nlength_m = {length:.3f}\nwidth_m = {width:.3f}"
            if index % 2
            else f"[[circle]]\n{where}\nradius_m = {0.5 * width:.3f}"
        )
    return "\n".join(things)


ROBOTS = [
    {"footprint": {"length_m": 0.3, "width_m": 0.25}},
    {"footprint": {"radius_m": 0.18}},
    {"footprint": {"polygon_m": [[0.2, -0.1], [0.25, 0], [0.2, 0.1], [-0.1, 0.15], [-0.1, -0.15]]}},
    {"footprint": {"length_m": 0.5, "width_m": 0.3}},
]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
)
def test_whatever_is_commanded_it_drives_into_nothing_that_stands(
    make_rig: MakeRig, seed: int
) -> None:
    rig = make_rig(things=cluttered(seed), robot=ROBOTS[seed], seed=seed, errors=REAL)
    rng = np.random.default_rng(seed)
    for _ in range(12):
        vx, wz = rng.uniform([-0.3, -1.6], [0.6, 1.6]) * (rng.random(2) < 0.7)
        rig.drive(0.1 * int(rng.integers(5, 30)), float(vx), float(wz))
    assert rig.truth.collisions == 0
    moved = sum(abs(a.twist.vx) + abs(a.twist.wz) for a in rig.truths) * 0.05
    assert moved > 3.0, "it was not just held all the time"


def test_a_lidar_that_falls_silent_stops_the_robot(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.drive(1.0, 0.2)
    lidar = rig.base.hardware.lidar
    silent = type(lidar.read())((), lidar.read().link)
    monkeypatch.setattr(lidar, "read", lambda: silent)
    rig.drive(0.4, 0.2)
    assert rig.state.mode == "ok"
    rig.drive(0.3, 0.2)
    assert rig.driven[-1].twist.is_zero
    assert (rig.state.mode, rig.state.reason) == ("held", codes.SCAN_LOST)
    monkeypatch.undo()
    rig.drive(1.0, 0.2)
    assert rig.state.mode == "ok"
    assert rig.truth.twist.vx == pytest.approx(0.2)


def test_a_covered_lidar_is_as_good_as_silent(make_rig: MakeRig) -> None:
    rig = make_rig(errors="[lidar]\ndrop_out = 0.0\ninvalid = 1.0")
    rig.drive(1.0, 0.2)
    assert rig.truth.twist.is_zero
    assert rig.state.reason == codes.SCAN_LOST


def test_at_the_end_the_robot_stands_and_says_so(rig: Rig) -> None:
    states: list[BaseState] = rig.states
    rig.drive(1.0, 0.3)
    rig.lockstep.nodes.pop("base").close()
    assert (states[-1].mode, states[-1].reason) == ("held", codes.SHUTDOWN)
    assert rig.driven[-1].twist.is_zero
    assert rig.lockstep.get("trolley/trolley/@do/base/stop") == []


def test_health_tells_of_a_lost_lidar(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    healths = rig.lockstep.record(topics.HEALTH, "base")
    lidar = rig.base.hardware.lidar
    silent = type(lidar.read())((), lidar.read().link)
    rig.run(1.0)
    assert {health.state for health in healths} == {"ok"}
    monkeypatch.setattr(lidar, "read", lambda: silent)
    rig.run(2.0)
    assert healths[-1].state == "degraded"
    assert healths[-1].message == codes.SENTENCES[codes.SCAN_LOST]
