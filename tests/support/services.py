"""Services that the process tests run: `python -m support.run_service support.services:Keeper`."""

import os
import time
from pathlib import Path

import msgspec

from trolley import requests, topics
from trolley.config import RobotConfig
from trolley.messages import BaseState, SavedPose, SavedPoses
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Service, answers, every, gets, on


class Kept(msgspec.Struct):
    """What `Keeper` saves."""

    poses: list[SavedPose]


class Keeper(Service):
    """Keeps saved poses as `tour` does, and obeys stops."""

    name = "tour"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._poses: dict[str, SavedPose] = {}
        self._stamp_ns = 0

    def start(self) -> None:
        kept = self.state.read("kept.toml", Kept)
        self._poses = {} if kept is None else {pose.name: pose for pose in kept.poses}
        self._publish()

    def stop(self) -> None:
        self.publish(topics.BASE, BaseState(stamp_ns=0, mode="ok", message="bye"))
        self._save()

    @on(topics.SAVED_POSE)
    def put(self, pose: SavedPose, name: str) -> None:
        self._poses[name] = msgspec.structs.replace(pose, name=name)
        self._save()
        self._publish()

    @answers(requests.POSES_PUT)
    def put_asked(self, pose: SavedPose) -> SavedPose:
        self.put(pose, pose.name)
        return pose

    @answers(requests.BASE_STOP)
    def stop_robot(self, _params: Nothing) -> BaseState:
        self.count("stops")
        return BaseState(stamp_ns=0, mode="stopped")

    @gets(topics.SAVED_POSE)
    def get(self, _parameters: dict[str, str]) -> dict[tuple[str, ...], SavedPose]:  # pyrefly: ignore[bad-override]
        return {(name,): pose for name, pose in self._poses.items()}

    def _publish(self) -> None:
        self._stamp_ns += 1
        self.publish(
            topics.POSES, SavedPoses(stamp_ns=self._stamp_ns, poses=[*self._poses.values()])
        )

    def _save(self) -> None:
        kept = Kept(poses=[*self._poses.values()])
        self.work(lambda: self.state.write("kept.toml", kept))


class Listener(Service):
    """Tells how many poses it knows: as its health's message."""

    name = "viz"
    one_per_host = True

    def __init__(self, config: RobotConfig) -> None:
        self._config = config

    @on(topics.POSES)
    def hear(self, poses: SavedPoses) -> None:
        self.set_health("ok", f"{len(poses.poses)} poses, stamp {poses.stamp_ns}")


class Renewed(Service):
    """Begins anew each time that the file named by RENEWED is there, and removes it at its end."""

    name = "mapper"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config

    @every(0.05, clock="local")
    def tick(self) -> None:
        self.is_spent = Path(os.environ["RENEWED"]).exists()

    def stop(self) -> None:
        self.work(lambda: Path(os.environ["RENEWED"]).unlink(missing_ok=True))


class Sleeper(Service):
    """Blocks its thread once the file named by SLEEPER exists, and says so in one beside it."""

    name = "localizer"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config

    @every(0.05, clock="local")
    def tick(self) -> None:
        blocker = Path(os.environ["SLEEPER"])
        while blocker.exists():
            blocker.with_suffix(".met").touch()
            time.sleep(0.05)


class Faulty(Service):
    """Fails as FAULT says: in a method, in `stop`, or in a job."""

    name = "planner"

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._fault = os.environ["FAULT"]

    def start(self) -> None:
        if self._fault == "start":
            raise RuntimeError("no start")
        if self._fault == "work":
            self.work(self._fail)

    def stop(self) -> None:
        self.publish(topics.BASE, BaseState(stamp_ns=0, mode="ok", message="bye"))
        if self._fault == "stop":
            raise RuntimeError("no stop")
        if self._fault == "save":
            self.work(self._fail)

    @every(0.3, clock="local")
    def tick(self) -> None:
        if self._fault == "tick":
            raise RuntimeError("no tick")

    def _fail(self) -> None:
        raise OSError("no disk")
