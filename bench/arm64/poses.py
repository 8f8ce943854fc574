"""A drive through the localizer: its poses, which have to be the same on every processor.

    python -m bench.arm64.poses record DRIVE.mcap
    python -m bench.arm64.poses follow DRIVE MAP.yaml POSES

`record` drives the demo's tour in lock-step and records it. `follow` lets base play a drive to the
localizer, in lock-step as well, and writes a line of JSON for each pose: stamp [ns], state, and x,
y [m], yaw [rad], or null while it has none.
"""

import argparse
import json
import sys
from pathlib import Path

from bench.harness.drives import (
    CORRIDOR,
    ENTRANCE,
    KITCHEN,
    drive_tour,
    make_config,
    simulated,
)
from bench.harness.paths import WORLDS
from bench.stack.tour import START

from trolley import topics
from trolley.geometry import Pose2D
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime.bus import Sample
from trolley.runtime.lockstep import Lockstep
from trolley_base.recording.recorded_device import load_recording
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService

ROBOT = "trolley"
SEED = 0
STOPS = {"corridor": CORRIDOR, "entrance": ENTRANCE, "kitchen": KITCHEN}


def record(path: Path) -> None:
    """Record the demo's tour, from when the robot knows where it is."""
    world, map_file = WORLDS / "apartment.toml", WORLDS / "apartment.yaml"
    with RecordingWriter(path, ROBOT, {}) as writer:
        recorder = Recorder(writer, ROBOT)

        def begin(bus: Lockstep) -> None:
            everything = f"{ROBOT}/{ROBOT}/**"
            bus.bus.subscribe(everything, lambda sample: recorder.take(sample, bus.now_ns, 0))
            for reply in bus.get(f"{everything}?format=msgpack"):
                latest = Sample(reply.key, reply.payload, reply.encoding)
                recorder.take(latest, bus.now_ns, 0, is_latest=True)

        drive = drive_tour(simulated(world, map_file, START, SEED), SEED, STOPS, on_ready=begin)
        writer.finish()
    if not drive.arrived:
        sys.exit(f"The tour to be recorded ended as {drive.state}: {drive.why}")


def follow(path: Path, map_file: Path, out: Path) -> None:
    """Write the poses that the localizer finds on a drive, from where the file says it starts."""
    recording = load_recording(path)
    rest = f'[base]\ndriver = "recording"\nrecording = {{ file = "{path.resolve()}" }}\n'
    config = make_config(map_file, recording.map_T_start or Pose2D.identity(), rest)
    with Lockstep() as bus:
        poses = bus.record(topics.POSE)
        bus.add(LocalizerService(config))
        bus.add(BaseService(config))
        bus.run(recording.stamps_ns[-1] * 1e-9 + 0.5)
    with out.open("w") as file:
        for one in poses:
            found = None if one.pose is None else (one.pose.x, one.pose.y, one.pose.yaw)
            file.write(json.dumps([one.stamp_ns, one.state, found]) + "\n")


def main() -> None:
    """Record a drive, or follow one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    recording = tasks.add_parser("record")
    recording.add_argument("drive", type=Path)
    following = tasks.add_parser("follow")
    following.add_argument("drive", type=Path)
    following.add_argument("map", type=Path)
    following.add_argument("poses", type=Path)
    options = parser.parse_args()
    if options.task == "record":
        record(options.drive)
    else:
        follow(options.drive, options.map, options.poses)


if __name__ == "__main__":
    main()
