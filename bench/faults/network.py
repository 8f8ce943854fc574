"""A robot and a home router on a bad radio link: how long gaps last, and if old commands move it.

    sudo python -m bench.faults.network [--only cut] [--write]

Two network namespaces stand for the hosts (needs root): in one all services of a simulated robot,
in the other the home router; TLS with certificates between them. For each trouble: how long the
home hears no pose after the trouble is over, how old the oldest message is that comes then, the
longest silence between the robot's own services, and whether the robot moved by an old command or
goal. `--write` puts the table into docs/network.md; exit code 1 if a robot did move.
"""

import argparse
import dataclasses
import itertools
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import tomli_w
from bench.harness.paths import DOCS, ROOT

sys.path.append(str(ROOT / "tests"))
from support.onlooker import Onlooker, Seen
from support.wifi import ADDRESSES, HOME, NETWORK, ROBOT, Wifi, why_not

from trolley.cli.demo_robot import Choices, settings
from trolley.geometry import Pose2D
from trolley.security.keyring import Keyring

NAME = "kiwi"
LOCAL = "tcp/127.0.0.1:7447"
PROGRAM = "from trolley.cli import main; main()"
FAR = Pose2D(5.3, 1.4, 0.0)
STANDS_MPS = 0.005
STOPS_S = 0.1
"""A short cut ends before the robot, which brakes, stands."""
LEASE_S = 1.0
"""Silence after which a connection counts as lost, with all that waits in it."""
PAGE = DOCS / "network.md"
BEGIN, END = "<!-- bench/faults/network.py -->", "<!-- end -->"


@dataclasses.dataclass(frozen=True)
class Row:
    """A line of the table; seconds, None where there is nothing to tell."""

    trouble: str
    back_s: float | None
    oldest_s: float | None
    local_gap_s: float
    remark: str
    is_good: bool = True

    def cells(self) -> list[str]:
        """As text."""
        return [
            self.trouble,
            _seconds(self.back_s),
            _seconds(self.oldest_s),
            _seconds(self.local_gap_s),
            self.remark if self.is_good else f"**{self.remark}**",
        ]


def _seconds(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} s"


class House:
    """The two hosts and what runs on them."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        """Start all and wait until the home hears where the robot is."""
        self._folder = folder
        self.wifi = stack.enter_context(Wifi())
        ring = Keyring(folder / "ring")
        now = datetime.now(UTC)
        ring.create(now)
        until = now + timedelta(days=30)
        router = ring.issue("router", "home", until, [ADDRESSES[HOME]], replace=False)
        robot = ring.issue("robot", NAME, until, replace=False)
        self._home_keys = router.folder
        self._router: subprocess.Popen[bytes] | None = None
        stack.callback(self.stop_router)
        self.start_router()
        toml = settings(Choices(name=NAME, seed=1))
        toml["zenoh"] = {
            "connect": [LOCAL],
            "uplink": [f"tls/{ADDRESSES[HOME]}:7448"],
            "keys": str(robot.folder),
        }
        path = folder / "robot.toml"
        path.write_text(tomli_w.dumps(toml), encoding="utf-8")
        up = self.wifi.start(
            ROBOT,
            ["-c", PROGRAM, "up", "--no-viz", "--config", str(path)],
            folder / "robot.log",
            {"TROLLEY_STATE": str(folder / "state")},
        )
        stack.callback(_end, up)
        self.at_home = Onlooker(self.wifi.namespace(HOME), LOCAL, NAME, hears_all=True)
        stack.callback(self.at_home.close)
        self.on_robot = Onlooker(self.wifi.namespace(ROBOT), LOCAL, NAME)
        stack.callback(self.on_robot.close)
        if self.next_pose(0.0, 300.0) is None:
            raise SystemExit(f"the robot did not come up:\n{(folder / 'robot.log').read_text()}")

    def start_router(self) -> None:
        """Start the home router."""
        self._router = self.wifi.start(
            HOME,
            ["-c", PROGRAM, "router", "--keys", str(self._home_keys)],
            self._folder / "router.log",
            {"TROLLEY_CONFIG": ""},
        )

    def stop_router(self) -> None:
        """Kill the home router."""
        if self._router is not None:
            self._router.kill()
            self._router.wait()
            self._router = None

    def pause_router(self, is_paused: bool) -> None:
        """Freeze the home router, or continue it."""
        assert self._router is not None
        self._router.send_signal(signal.SIGSTOP if is_paused else signal.SIGCONT)

    def next_pose(self, since_s: float, patience_s: float) -> Seen | None:
        """The first pose that the home hears after a moment."""
        deadline_s = time.monotonic() + patience_s
        while time.monotonic() < deadline_s:
            seen = self.at_home.seen("pose", since_s)
            if seen:
                return seen[0]
            time.sleep(0.05)
        return None

    def delays_s(self, name: str, since_s: float) -> list[float]:
        """How much later the home heard each message of a stream than a program on the robot."""
        there = {one.stamp_s: one.at_s for one in self.on_robot.seen(name)}
        heard = self.at_home.seen(name, since_s)
        return [one.at_s - there[one.stamp_s] for one in heard if one.stamp_s in there]

    def row(self, trouble: str, began_s: float, over_s: float, remark: str, good: bool) -> Row:
        """What was heard since a trouble began and after it was over."""
        first = self.next_pose(over_s, 90.0)
        time.sleep(2.0)
        streams = ("clock", "odom", "pose", "truth")
        late = [delay for name in streams for delay in self.delays_s(name, over_s)]
        return Row(
            trouble,
            None if first is None else first.at_s - over_s,
            max(late, default=None),
            longest_gap_s(self.on_robot.seen("odom", began_s - 1.0)),
            remark,
            good,
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.wait(30.0)


def longest_gap_s(seen: list[Seen]) -> float:
    """The longest silence between two messages."""
    times = [one.at_s for one in seen]
    return max((b - a for a, b in itertools.pairwise(times)), default=float("inf"))


def fastest_mps(seen: list[Seen]) -> float:
    """The highest true speed that was seen."""
    return max((one.what for one in seen), default=0.0)


def cut(house: House, seconds: float, is_held: bool = True) -> Row:
    """Nothing gets through; the teleop key is released as the cut begins, or before it ends."""
    began_s = time.monotonic()
    house.at_home.drive(0.15, began_s + 1.0 + (0.9 * seconds if is_held else 0.0))
    time.sleep(1.0)
    moved = fastest_mps(house.on_robot.seen("truth", began_s))
    house.wifi.is_cut = True
    cut_s = time.monotonic()
    answer = None
    if seconds >= 4.0:
        time.sleep(0.3)
        answer = house.at_home.send_goal(FAR)
    time.sleep(max(0.0, cut_s + seconds - time.monotonic()))
    house.wifi.is_cut = False
    over_s = time.monotonic()
    hand = "held on" if is_held else "let go"
    what = f"nothing gets through for {seconds:g} s, the hand {hand}"
    row = house.row(what, began_s, over_s, "", good=True)
    after = fastest_mps(house.on_robot.seen("truth", over_s + STOPS_S))
    sent = {one.stamp_s: one.at_s for one in house.at_home.seen("teleop")}
    came = house.on_robot.seen("teleop", over_s)
    oldest_s = max((one.at_s - sent[one.stamp_s] for one in came), default=0.0)
    states = {one.what for one in house.on_robot.seen("goal", cut_s)}
    words = [f"drove {moved:.2f} m/s before, {after:.2f} after it"]
    words.append(f"{len(came)} commands came late, {oldest_s:.2f} s at most" if came else "")
    # With the key held, it drives on after a short cut; what is older than a second never comes.
    good = oldest_s < LEASE_S + 0.3 and (after < STANDS_MPS or (is_held and bool(came)))
    if answer is not None:
        words.append(f"goal: {answer.code} after {answer.took_s:.1f} s")
        good = good and answer.code != "ok" and answer.took_s < 2.0
        if states & {"planning", "driving", "arrived"}:
            words.append("GOAL EXECUTED")
            good = False
    return dataclasses.replace(row, remark=", ".join(filter(None, words)), is_good=good)


def router_restart(house: House) -> Row:
    """The home router is killed and comes back after 2 s."""
    began_s = time.monotonic()
    house.stop_router()
    time.sleep(2.0)
    house.start_router()
    return house.row("home router killed, started 2 s later", began_s, time.monotonic(), "", True)


def router_frozen(house: House) -> Row:
    """The home router is frozen: its connections stand, and nothing is read."""
    began_s = time.monotonic()
    house.pause_router(True)
    time.sleep(10.0)
    house.pause_router(False)
    return house.row("home router frozen for 10 s", began_s, time.monotonic(), "", True)


def other_address(house: House) -> Row:
    """The robot gets another address."""
    began_s = time.monotonic()
    house.wifi.set_address(ROBOT, f"{NETWORK}.{30 + int(began_s) % 200}")
    return house.row("the robot's address changes", began_s, time.monotonic(), "", True)


def loss(house: House, share: float, delay_s: float) -> Row:
    """Packets are lost and late for 30 s."""
    house.wifi.loss, house.wifi.delay_s, house.wifi.jitter_s = share, delay_s, 0.3 * delay_s
    time.sleep(3.0)
    began_s = time.monotonic()
    time.sleep(30.0)
    poses = house.at_home.seen("pose", began_s)
    ages = sorted(house.delays_s("pose", began_s))
    stop = house.at_home.stop()
    house.wifi.loss, house.wifi.delay_s, house.wifi.jitter_s = 0.0, 0.0, 0.0
    remark = (
        f"{len(poses) / 30.0:.1f} poses/s, median age "
        f"{ages[len(ages) // 2] if ages else float('nan'):.2f} s, longest gap "
        f"{longest_gap_s(poses):.1f} s; stop: {stop.code} after {stop.took_s:.1f} s"
    )
    return Row(
        f"{share:.0%} lost, {1000 * delay_s:.0f} ms each way",
        None,
        ages[-1] if ages else None,
        longest_gap_s(house.on_robot.seen("odom", began_s)),
        remark,
    )


TROUBLES: dict[str, list[Callable[[House], Row]]] = {
    "cut": [
        lambda house: cut(house, 0.5, is_held=False),
        *(lambda house, s=seconds: cut(house, s) for seconds in (0.5, 1.0, 2.0, 5.0, 20.0, 60.0)),
    ],
    "restart": [router_restart],
    "frozen": [router_frozen],
    "address": [other_address],
    "loss": [
        lambda house, one=one: loss(house, *one)
        for one in ((0.05, 0.05), (0.15, 0.1), (0.3, 0.05), (0.3, 0.2))
    ],
}


def table(rows: list[Row]) -> str:
    """The rows as Markdown."""
    head = [
        "what happens",
        "pose is back after",
        "oldest message then",
        "longest silence on the robot",
        "more",
    ]
    lines = [head, ["---"] * len(head), *(row.cells() for row in rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def main() -> int:
    """Run the troubles and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=sorted(TROUBLES), action="append")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    reason = why_not()
    if reason is not None:
        print(f"not measured: {reason}")
        return 0
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        house = House(Path(folder), stack)
        for name in options.only or TROUBLES:
            for trouble in TROUBLES[name]:
                rows.append(trouble(house))
                print("  ".join(rows[-1].cells()), flush=True)
                time.sleep(2.0)
    if options.write:
        text = PAGE.read_text(encoding="utf-8")
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        PAGE.write_text(f"{before}{BEGIN}\n{table(rows)}\n{END}{after}", encoding="utf-8")
    else:
        print(table(rows))
    return 0 if all(row.is_good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
