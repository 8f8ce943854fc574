"""The settings of the robot on the page."""

from typing import TYPE_CHECKING, Any

import pytest
from support.pages import PageOf, page_of

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError, FootprintConfig, RobotConfig, RobotSection
from trolley.config.changeable_settings import Name, all_keys, describe, with_values
from trolley.messages import ConfigChanges, Settings
from trolley.messages.request_params import SetConfig, WhichConfig
from trolley.runtime.service import Service, answers
from trolley_viz.features.settings.panel import GROUPS, PLACE, SEARCH
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Browser, Stage


class PretendSettings(Service):
    """Answers for settings as base does, without a file."""

    name = "settings"

    def __init__(self) -> None:
        section = RobotSection(name="trolley", footprint=FootprintConfig(radius_m=0.2))
        self.config = RobotConfig(robot=section)
        self.is_saved = True
        self.asked: list[SetConfig] = []
        self.num_told = 0

    @answers(requests.CONFIG_GET)
    def tell(self, _: WhichConfig) -> Settings:
        self.num_told += 1
        return Settings(settings=self.described(list(all_keys())))

    @answers(requests.CONFIG_SET)
    def set(self, params: SetConfig) -> Settings:
        self.asked.append(params)
        if params.section == "base.limits":
            raise Refused(codes.BAD_REQUEST, "Somebody is editing robot.toml; try again.")
        try:
            self.config = with_values(self.config, params.section, params.values)
        except ConfigError as error:
            why = f"[planner] controller cannot be zap. Allowed: mppi ({error})."
            raise Refused(codes.BAD_REQUEST, why) from error
        self.publish(topics.CONFIG, ConfigChanges(stamp_ns=self.monotonic_ns, changes=[]))
        return Settings(settings=self.described([Name(params.section, k) for k in params.values]))

    def described(self, names: list[Name]) -> Any:
        return [describe(one, self.config, self.config, is_saved=self.is_saved) for one in names]


@pytest.fixture
def browser(stage: "Stage") -> "Browser":
    return stage.browse()  # type: ignore[no-any-return]


@pytest.fixture
def robot(stage: "Stage") -> PretendSettings:
    return stage.runtime.add(PretendSettings())


def opened(stage: "Stage", title: str) -> PageOf:
    """A folder of the page that its person has opened."""
    for control in stage.page().controls.all.values():
        if control.look.kind == "folder" and control.look.label == title:
            control.handle(True)
    stage.runtime.run(0.6)
    return page_of(stage).within(title)


def test_nothing_is_asked_before_somebody_looks(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    stage.runtime.run(3.0)
    assert robot.num_told == 0
    opened(stage, "Settings: speed")
    assert robot.num_told == 1
    stage.runtime.run(5.0)
    assert robot.num_told == 1


def test_a_speed_is_shown_and_changed(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    page = opened(stage, "Settings: speed")
    assert page.value("Highest speed (m/s)") == 0.5
    for passed in (0.3, 0.25, 0.2):  # as a slider is dragged
        page.type("Highest speed (m/s)", passed)
        stage.runtime.run(0.2)
    assert robot.asked == []
    stage.runtime.run(1.5)
    assert [(one.section, one.values) for one in robot.asked] == [
        ("planner", {"max_speed_mps": 0.2})
    ]
    assert browser.notices[-1] == ("Changed", "It counts at once. It is saved.")
    assert page.value("Highest speed (m/s)") == 0.2


def test_what_somebody_else_changes_is_shown(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    page = opened(stage, "Settings: speed")
    stage.runtime.ask(
        requests.CONFIG_SET, SetConfig(section="planner", values={"clearance_m": 0.1})
    )
    stage.runtime.run(1.0)
    assert page.value("Keep away where there is room (m)") == 0.1


def test_what_is_refused_is_said_and_the_field_shows_what_is(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    page = opened(stage, "Settings: speed")
    page.type("Limit for all, by hand too (m/s)", 0.8)
    stage.runtime.run(1.5)
    assert browser.notices[-1] == ("Not changed", "Somebody is editing robot.toml; try again.")
    stage.runtime.run(4.0)
    assert page.value("Limit for all, by hand too (m/s)") == 0.5


def test_what_could_not_be_saved_is_said(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    robot.is_saved = False
    opened(stage, "Settings: waiting").type("Drive home below this charge (%)", 30.0)
    stage.runtime.run(1.5)
    assert robot.asked[-1].values == {"low_battery": 0.3}
    assert "It could not be saved" in browser.notices[-1][1]


def test_a_whole_number_stays_one(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    opened(stage, "Settings: position").type("Beams to compare with", 150.0)
    stage.runtime.run(1.5)
    assert robot.asked[-1].values == {"num_beams": 150}


def test_the_start_is_a_place_coordinates_or_a_search(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    page = opened(stage, "Settings: start")
    question = "If it does not know that, it"
    assert page.value(question) == SEARCH
    assert not page.is_shown("Place")
    assert not page.is_shown("Even if it knows where it was")
    page.choose(question, PLACE)
    stage.runtime.run(0.5)
    assert page.options("Place") == ("kitchen",)
    page.tick("Even if it knows where it was")
    page.press("Save the start")
    stage.runtime.run(0.5)
    assert robot.asked[-1].values == {"pose": "kitchen", "always": True}
    page.choose(question, "is at these coordinates")
    stage.runtime.run(0.5)
    page.press("Where it is now")
    assert page.value("x (m)") == 1.5
    page.type("Heading (°)", 90.0)
    page.press("Save the start")
    stage.runtime.run(0.5)
    assert robot.asked[-1].values["pose"] == {"x": 1.5, "y": 0.0, "yaw": 1.5708}
    assert page.value("Heading (°)") == 90.0
    page.choose(question, SEARCH)
    page.press("Save the start")
    stage.runtime.run(0.5)
    assert robot.asked[-1].values == {"pose": None, "always": False}


def test_every_setting_can_be_read_and_those_that_may_be_changed(
    stage: "Stage", browser: "Browser", robot: PretendSettings
) -> None:
    page = opened(stage, "Settings: all by name")
    assert len(page.options("Setting")) == len(all_keys())
    page.choose("Setting", "viz.host")
    stage.runtime.run(0.5)
    assert "only be changed in robot.toml" in page.text()
    assert page.button("Change").is_disabled
    page.choose("Setting", "planner.controller")
    stage.runtime.run(0.5)
    assert page.value("Value, as in robot.toml") == '"mppi"'
    page.type("Value, as in robot.toml", "pursuit")
    page.press("Change")
    stage.runtime.run(0.5)
    assert robot.config.planner.controller == "pursuit"
    page.type("Value, as in robot.toml", "zap")
    page.press("Change")
    stage.runtime.run(0.5)
    assert browser.notices[-1][0] == "Not changed"
    assert "controller cannot be" in browser.notices[-1][1]


def test_without_base_it_says_why_there_are_none(stage: "Stage", browser: "Browser") -> None:
    page = opened(stage, "Settings: speed")
    assert "is not running" in page.text()
    assert not page.is_shown("Highest speed (m/s)")


def test_who_may_only_look_has_no_settings(stage: "Stage", robot: PretendSettings) -> None:
    stage.browse(1, Visitor("eve", role="viewer"))
    labels = page_of(stage, 1).labels
    assert not any(label.startswith("Settings") for label in labels)


def test_all_that_is_shown_may_be_changed_at_once() -> None:
    config = PretendSettings().config
    for words in (one for group in GROUPS.values() for one in group):
        setting = describe(Name(words.section, words.key), config, config, is_saved=True)
        assert setting.acts == "at_once"
        if words.most is not None:
            assert setting.greatest is not None
            assert words.most / words.factor <= setting.greatest


@pytest.mark.parametrize("tells", [True, False])
def test_what_was_changed_of_one_robot_is_not_sent_to_the_next(
    stage: "Stage", browser: "Browser", robot: PretendSettings, *, tells: bool
) -> None:
    stage.runtime.add(type(stage.robot)(), robot="kart")
    kart = PretendSettings()
    if tells:
        stage.runtime.add(kart, robot="kart")
    page = opened(stage, "Settings: speed")
    page.type("Highest speed (m/s)", 0.2)
    stage.session.follow("kart")
    stage.runtime.run(2.0)
    assert kart.asked == []
    stage.session.follow("trolley")
    stage.runtime.run(2.0)
    assert page.value("Highest speed (m/s)") == 0.5
    assert robot.asked == []
