"""Record what every topic carries in fixed drives, and compare it after a change of the code.

    python -m bench.stack.record_wire write FILE [--only SCENARIO ...]
    python -m bench.stack.record_wire compare FILE [--only SCENARIO ...]

The drives run in lock-step, so the same code writes the same record, byte for byte. This judges a
change that should change nothing: write with the old code, compare with the new. Sentences
for people (fields called `message`) are left out. The recorded drives need TROLLEY_DATA.
"""

import argparse
import gzip
import hashlib
import json
import math
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from bench.harness.paths import WORLDS
from numpy.typing import NDArray

from trolley.config import RobotConfig, load_config
from trolley.runtime.bus import Sample
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_mapper.service import MapperService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

Pose = dict[str, float]
Fields = dict[str, NDArray[Any]]
Record = dict[str, list[Any]]
Services = tuple[Callable[[RobotConfig], Service], ...]

ROBOT = "trolley"
JSON = "application/json"
DRIVING: Services = (BaseService, LocalizerService, PlannerService, TourService)
HOME: Pose = {"x": 0.549, "y": 0.218, "yaw": 0.2578}
CORRIDOR: Pose = {"x": 5.315, "y": 1.366, "yaw": 2.0 * math.atan2(-0.49845, 0.86692)}
ENTRANCE: Pose = {"x": 5.775, "y": -1.246, "yaw": 2.0 * math.atan2(-0.95949, 0.28175)}
KITCHEN: Pose = {"x": 2.149, "y": -2.706, "yaw": 2.0 * math.atan2(-0.99147, 0.13033)}
OFFICE: tuple[Pose, ...] = (
    {"x": 1.0, "y": 4.6, "yaw": 0.0},
    {"x": 9.5, "y": 4.6, "yaw": 0.0},
    {"x": 2.0, "y": 4.5, "yaw": 3.0},
    {"x": 9.8, "y": 7.0, "yaw": 0.0},
)
HOUSE: tuple[Pose, ...] = (
    {"x": 1.5, "y": 1.0, "yaw": 0.0},
    {"x": 6.1, "y": 8.6, "yaw": 0.0},
    {"x": 13.3, "y": 3.4, "yaw": 0.0},
)
SQUARE = [[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]
STILL = {"vx": 0.0, "vy": 0.0, "wz": 0.0}


def without_sentences(item: Any) -> Any:
    """A decoded message without what is written for people; bytes as their hash."""
    if isinstance(item, dict):
        return {k: without_sentences(v) for k, v in item.items() if k != "message"}
    if isinstance(item, list):
        return [without_sentences(one) for one in item]
    if isinstance(item, bytes):
        return f"{len(item)}:{hashlib.sha256(item).hexdigest()[:16]}"
    return item


class Tape:
    """Records all that is put on a bus, by key, and the replies to what is asked."""

    def __init__(self, bus: Lockstep) -> None:
        self.record: Record = {}
        self._bus = bus
        bus.bus.subscribe("**", self._hear)

    def _hear(self, sample: Sample) -> None:
        heard = self.record.setdefault(sample.key, [])
        if sample.is_delete:
            heard.append("deleted")
        else:
            heard.append(without_sentences(msgspec.msgpack.decode(sample.payload)))

    def send(self, request: str, **params: Any) -> None:
        """Ask, and let the reply come when it comes."""
        key = f"trolley/{ROBOT}/@do/{request}"
        replies = self.record.setdefault(key, [])
        self._bus.bus.get(
            key,
            json.dumps(params).encode(),
            JSON,
            2.0,
            lambda reply: replies.append(without_sentences(msgspec.json.decode(reply.payload))),
            lambda: None,
        )

    def ask(self, request: str, robot: str = ROBOT, **params: Any) -> None:
        """Ask as any program would, and wait for the reply."""
        key = f"trolley/{robot}/@do/{request}"
        replies = self._bus.get(key, json.dumps(params).encode(), JSON)
        answers = [msgspec.json.decode(reply.payload) for reply in replies]
        self.record.setdefault(key, []).append(without_sentences(answers))


def make_config(
    rest: str = "", start: Pose | None = None, map_file: Path | None = None, name: str = ROBOT
) -> RobotConfig:
    """A robot of 0.30 x 0.24 m; `rest` is more TOML."""
    text = f'[robot]\nname = "{name}"\nfootprint = {{ length_m = 0.30, width_m = 0.24 }}\n'
    if map_file is not None:
        text += f'[map]\nfile = "{map_file}"\n'
    if start is not None:
        text += "[start]\npose = {{ x = {x}, y = {y}, yaw = {yaw} }}\n".format(**start)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.toml"
        path.write_text(text + rest)
        return load_config(path)


def simulated(world: str, seed: int, start: Pose | None = None) -> str:
    """The TOML of a robot in one of the worlds."""
    text = f'[base.simulated]\nworld = "{WORLDS / world}.toml"\nseed = {seed}\n'
    return (
        text
        if start is None
        else text + "start = {{ x = {x}, y = {y}, yaw = {yaw} }}\n".format(**start)
    )


def start_all(
    bus: Lockstep, config: RobotConfig, services: Services = DRIVING, robot: str | None = None
) -> None:
    """Start services, those of a robot of another name under that name."""
    for service in services:
        bus.add(service(config), robot)


def tour() -> Record:
    """The demo's tour, with all that a person may ask on the way, and services that die."""
    config = make_config(simulated("apartment", 7), CORRIDOR, WORLDS / "apartment.yaml")
    with Lockstep(ROBOT, 7) as bus:
        tape = Tape(bus)
        start_all(bus, config)
        bus.run(8.0)
        _drive_a_tour(bus, tape)
        _drive_to_goals(bus, tape)
        _correct_the_pose(bus, tape)
        for name, service, dead_s, alive_s in (
            ("localizer", LocalizerService, 3.0, 6.0),
            ("base", BaseService, 0.0, 5.0),
        ):
            bus.kill(name)
            if dead_s:
                bus.run(dead_s)
            bus.add(service(config))
            bus.run(alive_s)
    return tape.record


def _drive_a_tour(bus: Lockstep, tape: Tape) -> None:
    tape.ask("pose/capture")
    tape.ask("pose/capture", name="here", icon="home")
    tape.ask("map/list")
    stops = [{"pose": CORRIDOR}, {"pose": ENTRANCE, "dwell": 1.0}, {"pose": KITCHEN}]
    tape.ask("tours/put", name="round", stops=stops)
    tape.ask("tour/start", name="round")
    bus.run(10.0)
    tape.ask("tour/pause")
    bus.run(2.0)
    tape.ask("tour/resume")
    bus.run(6.0)
    tape.ask("base/stop")
    bus.run(2.0)
    tape.ask("goal/send", pose=KITCHEN)
    tape.ask("base/resume")
    tape.ask("tour/resume")
    bus.run(60.0)
    tape.ask("tour/history", limit=3)


def _drive_to_goals(bus: Lockstep, tape: Tape) -> None:
    tape.ask("goal/preview", pose=CORRIDOR)
    tape.ask("goal/preview", pose={"x": 100.0, "y": 0.0, "yaw": 0.0})
    area = [[4.0, -3.5], [5.0, -3.5], [5.0, -2.0], [4.0, -2.0]]
    tape.ask("zones/put", name="slow", kind="speed", speed=0.1, points=area)
    tape.ask("zones/put", name="bad", kind="keepout", points=[[0, 0], [1, 1]])
    tape.ask("goal/send", name="here", id="home", speed=0.4)
    bus.run(6.0)
    tape.ask("goal/pause", id="home")
    bus.run(1.0)
    tape.ask("goal/resume", id="home")
    bus.run(4.0)
    tape.ask("goal/cancel", id="nobody")
    tape.ask("goal/cancel")
    bus.run(1.0)


def _correct_the_pose(bus: Lockstep, tape: Tape) -> None:
    tape.ask("pose/set", pose={"x": 4.0, "y": 0.0, "yaw": 0.0})
    bus.run(3.0)
    tape.ask("pose/find")
    bus.run(12.0)
    tape.ask("zones/delete", name="slow")
    tape.ask("map/load", name="apartment")
    bus.run(3.0)
    tape.ask("tour/offer", pose=KITCHEN)


def people() -> Record:
    """Goals among the people of the office."""
    config = make_config(simulated("office", 3), OFFICE[0], WORLDS / "office.yaml")
    with Lockstep(ROBOT, 3) as bus:
        tape = Tape(bus)
        start_all(bus, config)
        bus.run(6.0)
        for index, pose in enumerate(OFFICE[1:]):
            tape.ask("goal/send", pose=pose, id=f"g{index}", xy_tolerance=0.15, yaw_tolerance=3.2)
            bus.run(30.0)
    return tape.record


def robots() -> Record:
    """Three robots that meet in one house."""
    with Lockstep("r0", 5) as bus:
        tape = Tape(bus)
        for index, place in enumerate(HOUSE):
            rest = simulated("house", 5 + index, place)
            config = make_config(rest, place, WORLDS / "house.yaml", f"r{index}")
            start_all(bus, config, robot=f"r{index}")
        bus.run(6.0)
        for index in range(3):
            goal = {"id": "g0", "xy_tolerance": 0.3, "yaw_tolerance": 3.2}
            tape.ask("goal/send", robot=f"r{index}", pose=HOUSE[(index + 1) % 3], **goal)
        bus.run(45.0)
    return tape.record


def mapping() -> Record:
    """A map made by exploring, undone a little, saved, edited and extended."""
    config = make_config(simulated("apartment", 11), HOME)
    with Lockstep(ROBOT, 11) as bus:
        tape = Tape(bus)
        start_all(bus, config, (*DRIVING, MapperService))
        bus.run(3.0)
        tape.ask("map/new", name="mine", explore=True)
        bus.run(75.0)
        tape.ask("map/explore", on=False)
        bus.run(2.0)
        tape.ask("map/pause", on=True)
        bus.run(1.0)
        tape.ask("map/pause", on=False)
        tape.ask("map/undo", seconds=10.0)
        bus.run(5.0)
        tape.ask("map/save", name="mine")
        bus.run(8.0)
        tape.ask("map/list")
        turn, wall = (
            {"op": "turn", "angle": 0.05},
            {"op": "wall", "points": [[0.0, 0.0], [1.0, 0.0]]},
        )
        erase = {"op": "erase", "points": [[0.0, 0.5], [1.0, 0.5]]}
        tape.ask("map/edit", name="mine", ops=[turn, wall, erase])
        tape.ask("map/edit", name="mine", ops=[{"op": "nonsense"}])
        bus.run(5.0)
        tape.ask("map/extend", name="mine")
        bus.run(2.0)
        tape.ask("map/explore", on=True)
        bus.run(20.0)
        tape.ask("map/cancel")
        bus.run(5.0)
    return tape.record


@dataclass(frozen=True)
class RecordedDrive:
    """A recorded drive that a stand-in for base puts on the bus."""

    name: str
    odom: str
    """The field of the file that holds the odometry."""
    map_name: str
    service: type[LocalizerService | MapperService]
    num_scans: int

    def __call__(self) -> Record:
        """Play it to the service, which a mapper begins by making a map."""
        folder = Path(os.environ["TROLLEY_DATA"])
        with np.load(folder / f"{self.name}.npz") as data:
            fields = dict(data)
        start = _pose(fields["reference"][0])
        is_mapper = self.service is MapperService
        with Lockstep(ROBOT, 1) as bus:
            tape = Tape(bus)
            config = make_config(start=start, map_file=folder / f"{self.map_name}.yaml")
            bus.add(self.service(config))
            _put(bus, "robot", stamp_ns=1, name=ROBOT, title="", footprint=SQUARE,
                 drive="differential", max_speed=1.0, max_wz=2.0, deceleration=0.5)  # fmt: skip
            _put(bus, "clock", stamp_ns=1, rate=1.0, epoch=1)
            _put_laser(bus, fields)
            for index, stamp_ns in enumerate(self._stamps(fields)):
                if is_mapper and index == 20:
                    tape.send("map/new", name="new")
                bus.run(max(0.0, stamp_ns * 1e-9 - bus.now_s))
                if index % 10 == 0:
                    _put_laser(bus, fields)
                _put(bus, "clock", stamp_ns=stamp_ns, rate=1.0, epoch=1)
                pose = _pose(fields[self.odom][index])
                _put(bus, "odom", stamp_ns=stamp_ns, pose=pose, twist=STILL)
                _put_scan(bus, fields, index, stamp_ns)
            bus.run(0.5)
            if is_mapper:
                tape.ask("map/save", name="new")
            bus.run(1.0)
        return tape.record

    def _stamps(self, fields: Fields) -> list[int]:
        since = fields["stamps"] - fields["stamps"][0]
        return (1 + np.round(since * 1e9).astype(np.int64))[: self.num_scans].tolist()


def _pose(values: NDArray[np.float64]) -> Pose:
    return dict(zip(("x", "y", "yaw"), (float(value) for value in values), strict=True))


def _put(bus: Lockstep, topic: str, **message: Any) -> None:
    bus.put(f"trolley/{ROBOT}/{topic}", msgspec.msgpack.encode(message), "application/msgpack")


def _put_laser(bus: Lockstep, fields: Fields) -> None:
    pose = _pose(fields.get("laser_in_base", np.zeros(3)))
    _put(bus, "tf/laser", stamp_ns=1, parent="base_link", child="laser", pose=pose)


def _put_scan(bus: Lockstep, fields: Fields, index: int, stamp_ns: int) -> None:
    millimetres = fields["ranges_mm"][index]
    ranges = np.where(millimetres == 65535, np.inf, millimetres / 1000.0).astype(np.float32)
    _put(
        bus,
        "scan",
        stamp_ns=stamp_ns,
        frame="laser",
        angle_min=float(fields["angle_min"]),
        angle_increment=float(fields["angle_increment"]),
        time_increment=0.0,
        range_min=0.05,
        range_max=float(fields["range_max"]),
        ranges=ranges.tobytes(),
    )


CREATE3 = ("create3-rplidar-mac", "odom", "mac_1st_floor_final")
FREIBURG = ("freiburg-079", "odom_signed", "freiburg-079")
SCENARIOS: dict[str, Callable[[], Record]] = {
    "tour": tour,
    "people": people,
    "robots": robots,
    "mapping": mapping,
    "create3": RecordedDrive(*CREATE3, LocalizerService, 354),
    "freiburg": RecordedDrive(*FREIBURG, LocalizerService, 1500),
    "create3-mapper": RecordedDrive(*CREATE3, MapperService, 354),
    "freiburg-mapper": RecordedDrive(*FREIBURG, MapperService, 500),
}


def differences(before: Record, after: Record) -> Iterator[str]:
    """What differs, key by key: the first message that is not the same."""
    for key in sorted(before.keys() | after.keys()):
        old, new = before.get(key, []), after.get(key, [])
        if old == new:
            continue
        pairs = enumerate(zip(old, new, strict=False))
        at = next((i for i, (one, other) in pairs if one != other), min(len(old), len(new)))
        yield f"{key}: {len(old)} and {len(new)} messages, the first difference is at {at}:"
        yield f"  before {str(old[at : at + 1])[:600]}\n  after  {str(new[at : at + 1])[:600]}"


def main() -> None:
    """Write a record, or compare with one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=("write", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="*", choices=tuple(SCENARIOS))
    options = parser.parse_args()
    before: dict[str, Record] = {}
    if options.what == "compare":
        before = pickle.loads(gzip.decompress(options.file.read_bytes()))
    after: dict[str, Record] = {}
    is_same = True
    names = options.only or list(SCENARIOS)
    if "TROLLEY_DATA" not in os.environ:
        left_out = [one for one in names if isinstance(SCENARIOS[one], RecordedDrive)]
        names = [one for one in names if one not in left_out]
        print(f"TROLLEY_DATA is not set; left out: {', '.join(left_out) or 'nothing'}")
    for name in names:
        after[name] = SCENARIOS[name]()
        count = sum(map(len, after[name].values()))
        print(f"{name}: {count} messages on {len(after[name])} keys", flush=True)
        for line in differences(before[name], after[name]) if before else ():
            is_same = False
            print(line)
    if options.what == "write":
        options.file.write_bytes(gzip.compress(pickle.dumps(after), 1))
    else:
        print("the same" if is_same else "NOT the same")
        sys.exit(not is_same)


if __name__ == "__main__":
    main()
