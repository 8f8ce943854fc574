"""Periods, time, work, health, and how services end."""

from typing import Any

import pytest
from support.samples import make_clock, make_places

from trolley import requests, topics
from trolley.messages import Health, Offer
from trolley.messages.request_params import AskOffer
from trolley.runtime import codec
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, answers, every, on
from trolley.topics import Qos

SECOND = 1_000_000_000


class Ticker(Service):
    """Notes when its periods come: in robot time and in local time."""

    name = "planner"

    def __init__(self) -> None:
        self.robot_ticks: list[int] = []
        self.local_ticks: list[int] = []

    @every(0.1)
    def tick(self) -> None:
        assert self.now_ns is not None
        self.robot_ticks.append(self.now_ns)

    @every(0.5, clock="local")
    def tick_locally(self) -> None:
        self.local_ticks.append(self.monotonic_ns)


class Base(Service):
    """Owns robot time as far as it publishes the clock, at a rate of its own."""

    name = "base"

    def __init__(self, rate: float = 1.0, start: int = 0) -> None:
        self.rate = rate
        self.epoch = start

    def now(self, monotonic_ns: int) -> int:
        return self.epoch + round(self.rate * monotonic_ns)

    @every(0.1, clock="local")
    def publish_clock(self) -> None:
        stamp_ns = self.now(self.monotonic_ns)
        self.publish(topics.CLOCK, make_clock(stamp_ns, self.epoch, self.rate))


class OwnTime(Base):
    """Lives by its own robot time, as the real base does."""

    def __init__(self, rate: float = 1.0, start: int = 0) -> None:
        super().__init__(rate, start)
        self.own_time = self
        self.ticks: list[int] = []

    @every(0.2)
    def tick(self) -> None:
        self.ticks.append(self.stamp_ns)


@pytest.mark.parametrize("rate", [0.25, 1.0, 4.0])
def test_periods_count_robot_time(lockstep: Lockstep, rate: float):
    ticker = lockstep.add(Ticker())
    lockstep.add(Base(rate))
    lockstep.run(4.0)
    wanted = round(40 * rate)
    assert wanted <= len(ticker.robot_ticks) <= wanted + 1
    steps = [b - a for a, b in zip(ticker.robot_ticks, ticker.robot_ticks[1:], strict=False)]
    assert all(abs(step - SECOND // 10) < SECOND // 500 for step in steps)
    assert ticker.local_ticks == [i * SECOND // 2 for i in range(9)]


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_who_owns_robot_time_lives_by_it(lockstep: Lockstep, rate: float):
    base = lockstep.add(OwnTime(rate, start=1_790_000_000 * SECOND))
    lockstep.run(2.0)
    assert len(base.ticks) == round(10 * rate) + 1
    assert base.ticks[0] == base.epoch
    assert base.stamp_ns == base.now(lockstep.now_ns)


def test_robot_periods_rest_without_robot_time(lockstep: Lockstep):
    ticker = lockstep.add(Ticker())
    lockstep.run(2.0)
    assert ticker.robot_ticks == []
    assert ticker.now_ns is None
    assert ticker.stamp_ns == 0
    lockstep.add(Base())
    lockstep.run(1.0)
    before = len(ticker.robot_ticks)
    assert before >= 9
    lockstep.kill("base")
    lockstep.run(5.0)
    assert len(ticker.robot_ticks) <= before + 10  # for 1 s it is still known
    resting = len(ticker.robot_ticks)
    lockstep.add(Base())
    lockstep.run(1.0)
    # It goes on at its pace: what was missed is not made up for.
    assert 9 <= len(ticker.robot_ticks) - resting <= 12


def test_a_jump_of_robot_time_is_one_tick_not_many(lockstep: Lockstep):
    ticker = lockstep.add(Ticker())
    lockstep.publish(topics.CLOCK, make_clock(0))
    lockstep.run(0.5)
    lockstep.run(1.0)  # while base is silent nobody can say what it ought to be
    before = len(ticker.robot_ticks)
    lockstep.publish(topics.CLOCK, make_clock(3600 * SECOND))
    assert len(ticker.robot_ticks) == before + 1
    lockstep.run(0.5)
    assert len(ticker.robot_ticks) <= before + 7


def test_a_new_epoch_with_an_earlier_time_does_not_silence_periods(lockstep: Lockstep):
    ticker = lockstep.add(Ticker())
    lockstep.publish(topics.CLOCK, make_clock(5000 * SECOND, epoch=5000 * SECOND))
    lockstep.run(0.3)
    lockstep.run(2.0)
    before = len(ticker.robot_ticks)
    lockstep.publish(topics.CLOCK, make_clock(10 * SECOND, epoch=10 * SECOND))
    lockstep.run(0.5)
    assert len(ticker.robot_ticks) >= before + 5


def test_health_tells_state_and_counters(lockstep: Lockstep):
    health = lockstep.record(topics.HEALTH)
    ticker = lockstep.add(Ticker())
    lockstep.run(3.0)
    assert [one.state for one in health] == ["ok"] * 5  # at once, and every second from then on
    ticker.count("things", 2)
    ticker.count("things")
    ticker.set_health("degraded", "no scan")
    assert health[-1] == Health(
        stamp_ns=0, state="degraded", message="no scan", counters={"things": 3}, up=3.0
    )
    ticker.set_health("degraded", "no scan")
    assert len(health) == 6
    (reply,) = lockstep.get("trolley/*/health/*")
    assert reply.key == "trolley/trolley/health/planner"


def test_health_names_the_files_that_were_set_aside(lockstep: Lockstep):
    class Keeper(Service):
        name = "planner"

        def start(self) -> None:
            self.state.read("places.toml", Health)

    folder = lockstep.state / "trolley"
    folder.mkdir(parents=True)
    (folder / "places.toml").touch()
    health = lockstep.record(topics.HEALTH)
    keeper = lockstep.add(Keeper())
    lockstep.run(0.1)
    said = "places.toml could not be read and was set aside."
    assert (health[-1].state, health[-1].message) == ("degraded", said)
    keeper.set_health("failed", "No scan.")
    assert (health[-1].state, health[-1].message) == ("failed", f"No scan. {said}")
    keeper.set_health("ok")
    assert (health[-1].state, health[-1].message) == ("degraded", said)


def test_work_is_done_aside_and_handed_back(lockstep: Lockstep):
    ticker = lockstep.add(Ticker())
    done: list[Any] = []
    ticker.work(lambda: 42, done.append)
    ticker.work(lambda: done.append("no one waits"))
    assert done == ["no one waits"]
    lockstep.run(0.1)
    assert done == ["no one waits", 42]


def test_what_the_service_began_is_not_lost_in_a_flood(
    lockstep: Lockstep, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("trolley.runtime.inbox.MAX_WAITING", 3)

    class Flooded(Ticker):
        heard = 0

        @on(topics.POSES)
        def hear(self, _places: Any) -> None:
            self.heard += 1

    service = lockstep.add(Flooded())
    done: list[Any] = []
    for i in range(10):
        payload = codec.encode(make_places(i), "json")
        lockstep.bus.put("trolley/trolley/poses", payload, codec.MIME["json"], Qos.STATE)
    service.work(lambda: "saved", done.append)
    service.get(topics.POSES, then=done.append)
    lockstep.run(1.5)
    assert service.heard == 3
    assert done == ["saved", {}]
    (reply,) = lockstep.get("trolley/trolley/health/planner")
    assert b'"inbox/dropped":7' in reply.payload


def test_the_last_word_is_said(lockstep: Lockstep):
    class Leaving(Ticker):
        def stop(self) -> None:
            self.publish(topics.POSES, make_places(9))

    heard = lockstep.record(topics.POSES)
    lockstep.add(Leaving())
    lockstep.kill("planner")
    assert heard == []
    lockstep.add(Leaving())
    lockstep.close()
    assert heard == [make_places(9)]


def test_the_same_seed_gives_the_same_ids_and_a_restart_gives_new_ones():
    def ids(seed: int) -> list[str]:
        with Lockstep(seed=seed) as lockstep:
            first = lockstep.add(Ticker())
            found = [first.new_id(), first.new_id()]
            lockstep.kill("planner")
            return [*found, lockstep.add(Ticker()).new_id()]

    assert ids(1) == ids(1)
    assert ids(1) != ids(2)
    assert len(set(ids(1))) == 3
    assert all(len(one) == 12 and one.isalnum() and one.islower() for one in ids(3))


def test_an_exception_ends_the_run(lockstep: Lockstep):
    class Faulty(Service):
        name = "planner"

        @on(topics.POSES)
        def hear(self, _places: Any) -> None:
            raise ZeroDivisionError

    lockstep.add(Faulty())
    with pytest.raises(ZeroDivisionError):
        lockstep.publish(topics.POSES, make_places(1))


def test_services_that_never_settle_are_found_out(
    lockstep: Lockstep, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("trolley.runtime.lockstep.MAX_ROUNDS", 10)

    class Echo(Service):
        def __init__(self, name: str) -> None:
            self.name = name  # pyrefly: ignore[read-only]

        @on(topics.POSES)
        def hear(self, places: Any) -> None:
            self.publish(topics.POSES, make_places(places.stamp_ns + 1))

    lockstep.add(Echo("tour"))
    with pytest.raises(RuntimeError, match="kept answering"):
        lockstep.publish(topics.POSES, make_places(1))


class Preparing(Service):
    """Takes long before it can do anything."""

    name = "tour"

    def __init__(self, lockstep: Lockstep) -> None:
        self._lockstep = lockstep
        self.answers_meanwhile: list[object] = []

    def prepare(self) -> None:
        self.answers_meanwhile += self._lockstep.get("trolley/trolley/@do/tour/offer?name=a")

    @answers(requests.TOUR_OFFER)
    def offer(self, _params: AskOffer) -> Offer:
        return Offer(free=True)


def test_nothing_waits_for_a_service_that_prepares(lockstep: Lockstep):
    service = lockstep.add(Preparing(lockstep))
    assert service.answers_meanwhile == []
    assert len(lockstep.get("trolley/trolley/@do/tour/offer?name=a")) == 1
