"""Several robots on one lock-step bus."""

from pathlib import Path

from trolley import requests, topics
from trolley.messages import BaseState
from trolley.messages.request_params import Nothing
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every


class Base(Service):
    """Says its robot's name, and hears those of all."""

    name = "base"

    def __init__(self) -> None:
        self.heard: list[tuple[str, str]] = []

    def start(self) -> None:
        self.watch(topics.BASE, robot="*", then=self._hear)
        self.state.write("here.toml", BaseState(stamp_ns=0, mode="ok"))

    def _hear(self, state: BaseState, robot: str) -> None:
        self.heard.append((robot, state.message))

    @every(1.0, clock="local")
    def tell(self) -> None:
        self.publish(topics.BASE, BaseState(stamp_ns=0, mode="ok", message=self.robot))

    @answers(requests.BASE_STOP)
    def stop_it(self, params: Nothing) -> BaseState:
        del params
        return BaseState(stamp_ns=0, mode="stopped", message=self.robot)


def test_each_has_its_own_keys_state_and_requests_and_hears_the_others(tmp_path: Path) -> None:
    with Lockstep("one", state=tmp_path) as lockstep:
        one, two = lockstep.add(Base()), lockstep.add(Base(), "two")
        said = lockstep.record(topics.BASE, robot="two")
        lockstep.run(1.5)
        assert set(one.heard) == set(two.heard) == {("one", "one"), ("two", "two")}
        assert {state.message for state in said} == {"two"}
        assert lockstep.ask(requests.BASE_STOP).message == "one"
        assert lockstep.ask(requests.BASE_STOP, robot="two").message == "two"
        assert set(lockstep.nodes) == {"base", "two/base"}
        assert {path.parent.name for path in tmp_path.rglob("here.toml")} == {"one", "two"}


def test_who_subscribes_later_hears_what_comes_then() -> None:
    with Lockstep("one") as lockstep:
        lockstep.add(Base())
        lockstep.run(2.5)
        late = lockstep.record(topics.BASE)
        lockstep.run(2.0)
        assert len(late) == 2
