"""Breaks one thing of a driving robot and sees what happens."""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from bench.faults.robot import STANDS_MPS, Missing, Rig, describe
from bench.faults.saved import lost

from trolley import codes, requests

# Commands hold for 0.5 s at most; then the robot brakes from 0.5 m/s at 0.8 m/s².
COMMAND_LOST_S = 0.5 + 0.7
# A motor board that does not obey is found out within this time.
TOLD_S = 0.5
# The pose is stale after 1 s; the planner says zero then.
POSE_LOST_S = 1.0 + COMMAND_LOST_S
# What a beam should see and none has seen is forgotten after 0.5 s, at the next scan or the one
# after it; until then the robot turns on.
BLIND_S = 0.8
BACK_WITHIN_S = 90.0
# For so long we watch that nothing sets off by itself.
WATCHED_S = 2.0
# What the network and the observer's 20 Hz add to a time.
GRAIN_S = 0.15


@dataclass
class Outcome:
    """A row of the table."""

    fault: str
    happened: str
    stood_s: float | None = None
    """None: it kept driving."""
    back_s: float | None = None
    """None: there was nothing to recover from."""
    lost: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """What is not as required."""
    has_robot: bool = True

    @property
    def cells(self) -> list[str]:
        """Return the cells of the row."""
        stood = "keeps driving" if self.stood_s is None else f"{self.stood_s:.2f} s"
        back = "at once" if self.back_s is None else f"{self.back_s:.1f} s"
        return [
            self.fault,
            self.happened,
            stood if self.has_robot else "–",
            back if self.has_robot else "–",
            "; ".join(self.lost) or "nothing",
            "; ".join(self.wrong) or "ok",
        ]


@dataclass(frozen=True)
class Fault:
    """What is broken, and what must happen then.

    Attributes:
        name: of the row.
        happens: what happens then, in words.
        apply: breaks it, and may return when that came about (local monotonic time) [s].
        undo: mends it again, None: it mends itself.
        lasts_s: between the two [s].
        stands_s: the robot must stand so long after `apply` [s]; None: it may drive on.
        until_found: whether it need not stand if it knows where it is before that.
        asks: whether the trip waits for a person afterwards.
        restarts: the service that must be restarted.
    """

    name: str
    happens: str
    apply: Callable[[Rig], float | None]
    undo: Callable[[Rig], None] | None = None
    lasts_s: float = 0.0
    stands_s: float | None = None
    until_found: bool = False
    asks: bool = False
    restarts: str | None = None


def disturb(rig: Rig, fault: Fault) -> Outcome:
    """Break a thing while the robot drives."""
    outcome = Outcome(fault.name, fault.happens)
    try:
        _disturb(rig, fault, outcome)
    except Missing as missing:
        outcome.wrong.append(f"{missing} ({describe(rig)})")
    return outcome


def _disturb(rig: Rig, fault: Fault, outcome: Outcome) -> None:
    rig.wait_for_driving()
    before, collisions = rig.saved(), rig.collisions
    restarts = rig.restarts
    began_s = time.monotonic()
    began_s = fault.apply(rig) or began_s
    if fault.stands_s is not None:
        limit_s = fault.stands_s + GRAIN_S

        def is_settled() -> bool:
            """Whether it stands, or has no reason to any more."""
            is_found = fault.until_found and rig.is_found_since(began_s + GRAIN_S)
            return rig.stood_after(began_s) is not None or is_found

        rig.wait(is_settled, 10.0, "the robot stands")
        outcome.stood_s = rig.stood_after(began_s)
        took_s = time.monotonic() - began_s if outcome.stood_s is None else outcome.stood_s
        if took_s > limit_s:
            outcome.wrong.append(f"stood only after {took_s:.2f} s, {limit_s:.2f} allowed")
    time.sleep(max(0.0, fault.lasts_s - (time.monotonic() - began_s)))
    mended_s = time.monotonic() if fault.lasts_s > 0.0 else began_s
    if fault.undo is not None:
        fault.undo(rig)
    if (name := fault.restarts) is not None:
        rig.wait(lambda: rig.restarts[name] > restarts[name], BACK_WITHIN_S, f"{name} is back")
    if fault.asks:
        _let_it_go_on(rig, outcome)
    rig.wait_for_driving(BACK_WITHIN_S)
    if outcome.stood_s is not None:
        outcome.back_s = time.monotonic() - mended_s
    outcome.lost = lost(before, rig.saved())
    if rig.collisions > collisions:
        outcome.wrong.append(f"{rig.collisions - collisions} collisions")


def _let_it_go_on(rig: Rig, outcome: Outcome) -> None:
    """Resume as a person would; before that, nothing may move."""
    rig.wait(lambda: rig.tour and rig.tour.state == "paused", BACK_WITHIN_S, "the trip waits")
    rig.wait(lambda: rig.speed < STANDS_MPS, 5.0, "the robot stands")
    watched_s = time.monotonic()
    time.sleep(WATCHED_S)
    moved = rig.fastest_between(watched_s, time.monotonic())
    if moved > STANDS_MPS:
        outcome.wrong.append(f"set off by itself with {moved:.2f} m/s")
    end_s = time.monotonic() + BACK_WITHIN_S
    while rig.tour is not None and rig.tour.state == "paused":
        if rig.base is not None and rig.base.is_halted:
            rig.ask_patiently(requests.BASE_RESUME)
        rig.ask_patiently(requests.TOUR_RESUME)
        time.sleep(0.5)
        if time.monotonic() > end_s:
            raise Missing("the trip continues")


def _signal(service: str, number: signal.Signals) -> Callable[[Rig], None]:
    return lambda rig: rig.signal(service, number)


def _gone(rig: Rig) -> None:
    rig.stop_router()


def _back(rig: Rig) -> None:
    rig.start_router()


class HowItStands(NamedTuple):
    """What must happen where a service goes away; the words of `Fault`."""

    happens: str
    stands_s: float | None = None
    asks: bool = False
    until_found: bool = False


HOW_IT_STANDS = {
    "base": HowItStands(
        "the board stops by itself; the trip waits for a person", COMMAND_LOST_S, asks=True
    ),
    "localizer": HowItStands(
        "the planner stops if it has no pose for 1 s; the trip continues",
        POSE_LOST_S,
        until_found=True,
    ),
    "planner": HowItStands("base holds without commands; the trip continues", COMMAND_LOST_S),
    "tour": HowItStands("the robot continues to its goal; the trip is resumed"),
    "viz": HowItStands("nothing but the page stops"),
    "router": HowItStands("base holds without commands; the trip continues", COMMAND_LOST_S),
}


def _killed() -> list[Fault]:
    return [
        Fault(f"kill -9 of {service}", apply=_signal(service, signal.SIGKILL), **how._asdict())
        for service, how in HOW_IT_STANDS.items()
        if service != "router"
    ]


def _frozen() -> list[Fault]:
    """SIGSTOP for 4 s, which everything survives, and for good, which the watchdog ends."""
    faults: list[Fault] = []
    for service, how in HOW_IT_STANDS.items():
        stop, go = _signal(service, signal.SIGSTOP), _signal(service, signal.SIGCONT)
        # A base that was frozen for a while comes back in the same run: the goal continues.
        faults.append(
            Fault(
                f"{service} frozen for 4 s",
                "it continues where it was" if how.stands_s is None else "stops, then continues",
                stop,
                go,
                4.0,
                how.stands_s,
            )
        )
        if service != "router":  # in the terminal it is not a child of the supervisor
            how = how._replace(happens=f"the watchdog restarts it; {how.happens}")
            name = f"{service} frozen for good"
            faults.append(Fault(name, apply=stop, restarts=service, **how._asdict()))
    return faults


def _without_router() -> list[Fault]:
    how = HOW_IT_STANDS["router"]._asdict()
    return [
        Fault(f"router gone for {seconds:g} s", apply=_gone, undo=_back, lasts_s=seconds, **how)
        for seconds in (1.0, 5.0, 30.0)
    ]


def _planner_cut_off() -> list[Fault]:
    happens = "base holds without commands; the trip continues"
    return [
        Fault(
            "planner cut off for 5 s, not told",
            happens,
            lambda rig: rig.proxy.cut(),
            lambda rig: rig.proxy.mend(),
            5.0,
            COMMAND_LOST_S,
        ),
        Fault(
            "planner's link broken for 5 s",
            happens,
            lambda rig: rig.proxy.break_off(),
            lambda rig: rig.proxy.mend(),
            5.0,
            COMMAND_LOST_S,
        ),
    ]


def _refused(rig: Rig) -> None:
    rig.device_fault("linorobot:refuse+5")


def _disobeys(fault: str) -> Callable[[Rig], float | None]:
    """Break the board, and wait until base says so."""

    def apply(rig: Rig) -> float | None:
        broken_s = time.monotonic()
        rig.device_fault(f"linorobot:{fault}")
        rig.wait(lambda: rig.base and rig.base.reason == codes.DOES_NOT_OBEY, 10.0, "base says so")
        return broken_s

    return apply


def _ignores_a_stop(rig: Rig) -> float | None:
    """Stop a robot whose board ignores all; that must be reported, and end once it is fixed."""
    rig.device_fault("linorobot:deaf")
    stopped_s = time.monotonic()
    rig.ask(requests.BASE_STOP)
    rig.wait(lambda: rig.base and rig.base.not_stopped, 5.0, "NOT STOPPED is said")
    told_s = time.monotonic() - stopped_s
    rig.device_fault("linorobot:ok")
    if told_s > TOLD_S + GRAIN_S:
        raise Missing(f"NOT STOPPED is said within {TOLD_S} s; it took {told_s:.2f} s")
    return time.monotonic()


def _drives_by_itself(rig: Rig) -> float | None:
    """Stop it, wait until it stands, and let its board drive."""
    rig.ask(requests.BASE_STOP)
    rig.wait(lambda: rig.speed < STANDS_MPS, 5.0, "the robot stands")
    time.sleep(2.0)
    began_s = time.monotonic()
    rig.device_fault("linorobot:drives=0.15")
    rig.wait(lambda: rig.base and rig.base.not_stopped, 5.0, "NOT STOPPED is said")
    told_s = time.monotonic() - began_s
    time.sleep(1.0)
    rig.device_fault("linorobot:ok")
    if told_s > TOLD_S + GRAIN_S:
        raise Missing(f"NOT STOPPED is said within {TOLD_S} s; it took {told_s:.2f} s")
    return time.monotonic()


def _mend_board(rig: Rig) -> None:
    rig.device_fault("linorobot:ok")


def _obedience() -> list[Fault]:
    return [
        Fault(
            "board ignores a stop",
            "NOT STOPPED is shown within 0.5 s until the board is mended; the trip waits",
            _ignores_a_stop,
            stands_s=COMMAND_LOST_S,
            asks=True,
        ),
        Fault(
            "board drives by itself",
            "NOT STOPPED is shown within 0.5 s until the board is mended; the trip waits",
            _drives_by_itself,
            stands_s=COMMAND_LOST_S,
            asks=True,
        ),
        Fault(
            "left motor dead",
            "base stops and says which wheel; the trip waits for a person",
            _disobeys("motor=left"),
            _mend_board,
            stands_s=TOLD_S + COMMAND_LOST_S,
            asks=True,
        ),
        Fault(
            "board's port takes nothing for 5 s",
            "the board stops by itself; base holds and says so; the trip continues",
            _refused,
            None,
            5.0,
            COMMAND_LOST_S,
        ),
    ]


def _devices() -> list[Fault]:
    lidar, board = "ld19", "linorobot"
    return [
        Fault(
            "lidar silent for 5 s",
            "base holds 0.5 s after the last scan; the trip continues",
            lambda rig: rig.device_fault(f"{lidar}:silence+5"),
            None,
            5.0,
            0.5 + COMMAND_LOST_S,
        ),
        Fault(
            "lidar sees nothing 60° ahead for 10 s",
            "base holds before what it has not seen, and lets it turn; the trip continues",
            lambda rig: rig.device_fault(f"{lidar}:blind+10"),
            None,
            10.0,
            10.0,  # a turn that is under way goes on: the blind side comes to where it was seen
        ),
        Fault(
            "95 % of the lidar's beams fail for 10 s",
            "base holds before what it has not seen; the trip continues",
            lambda rig: rig.device_fault(f"{lidar}:fail+10"),
            None,
            10.0,
            BLIND_S + COMMAND_LOST_S,
        ),
        Fault(
            "lidar covered for 5 s",
            "base holds 0.5 s after the last scan that saw anything; the trip continues",
            lambda rig: rig.device_fault(f"{lidar}:cover+5"),
            None,
            5.0,
            0.5 + COMMAND_LOST_S,
        ),
        Fault(
            "lidar unplugged for 5 s",
            "base holds and reopens the port; the trip continues",
            lambda rig: rig.device_fault(f"{lidar}:unplug+5"),
            None,
            5.0,
            0.5 + COMMAND_LOST_S,
        ),
        Fault(
            "board unplugged for 5 s",
            "the board stops by itself; base reopens the port; the trip continues",
            lambda rig: rig.device_fault(f"{board}:unplug+5"),
            None,
            5.0,
            COMMAND_LOST_S,
        ),
        Fault(
            "board silent for 5 s",
            "base holds without odometry; the trip continues",
            lambda rig: rig.device_fault(f"{board}:silence+5"),
            None,
            5.0,
            0.5 + COMMAND_LOST_S,
        ),
    ]


FAULTS: dict[str, Callable[[], list[Fault]]] = {
    "killed": _killed,
    "frozen": _frozen,
    "router": _without_router,
    "network": _planner_cut_off,
    "devices": _devices,
    "obedience": _obedience,
}
