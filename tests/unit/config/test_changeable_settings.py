"""Which settings may be changed while the robot runs, and what services make of it."""

from typing import Any

import pytest

from trolley.config import ConfigError, FootprintConfig, RobotConfig, RobotSection
from trolley.config.changeable_settings import (
    AFTER_RESTART,
    AT_ONCE,
    Name,
    acts,
    all_keys,
    describe,
    parse_value,
    service_of,
    value_of,
    with_changes,
    with_values,
)
from trolley.messages import ChangedSetting
from trolley.runtime.live_config import LiveConfig
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService
from trolley_tour.service import TourService

CONFIG = RobotConfig(
    robot=RobotSection(name="trolley", footprint=FootprintConfig(radius_m=0.2)),
)


def names(table: Any) -> set[Name]:
    return {Name(section, key) for section, keys in table.items() for key in keys}


def test_the_tables_name_settings_that_there_are_and_each_once() -> None:
    assert names(AT_ONCE) | names(AFTER_RESTART) <= set(all_keys())
    assert names(AT_ONCE).isdisjoint(names(AFTER_RESTART))


def test_who_takes_settings_at_once_listens_for_them() -> None:
    """`base` owns them and takes its own without the wire."""
    services = (LocalizerService(CONFIG), PlannerService(CONFIG), TourService(CONFIG))
    listening = {
        one.name for one in services if any(isinstance(part, LiveConfig) for part in one.parts)
    }
    assert listening | {"base"} == {service_of(section) for section in AT_ONCE}


@pytest.mark.parametrize(
    "name",
    [
        Name("base.limits", "deceleration_mps2"),
        Name("base.limits", "angular_acceleration_radps2"),
        Name("base.limits", "slope"),
        Name("base", "stop_margin_m"),
        Name("base.chassis", "delay_s"),
        Name("base.chassis", "watchdog_s"),
    ],
)
def test_what_the_stop_field_reckons_with_stays_in_the_file(name: Name) -> None:
    assert acts(name) == "file"


@pytest.mark.parametrize("section", ["robot", "zenoh", "viz", "mqtt", "base.lidar", "map"])
def test_who_and_where_the_robot_is_stays_in_the_file(section: str) -> None:
    found = [name for name in all_keys() if name.section == section]
    assert found
    assert {acts(name) for name in found} == {"file"}


def test_values_are_checked_as_in_the_file() -> None:
    changed = with_values(CONFIG, "planner", {"max_speed_mps": 1})
    assert changed.planner.max_speed_mps == 1.0
    assert with_values(changed, "planner", {"max_speed_mps": None}) == CONFIG
    for values in ({"max_speed_mps": 9.0}, {"zap": 1}, {"max_speed_mps": "1"}):
        with pytest.raises(ConfigError, match=r"planner|zap"):
            with_values(CONFIG, "planner", values)


def test_a_service_takes_what_it_understands() -> None:
    changes = [
        ChangedSetting(section="planner", key="rollouts", value=100),
        ChangedSetting(section="planner", key="wings", value=2),
        ChangedSetting(section="planner", key="frame", value="odom"),
    ]
    config, left_out = with_changes(CONFIG, changes)
    assert config == with_values(CONFIG, "planner", {"rollouts": 100})
    assert left_out == [Name("planner", "wings"), Name("planner", "frame")]


def test_each_setting_has_words_and_a_value() -> None:
    for name in all_keys():
        told = describe(name, CONFIG, CONFIG, is_saved=True)
        assert told.allowed, name
        assert told.meaning or name.section.startswith("base."), name
        if told.default is not None and name.section != "base.simulated.battery":
            assert value_of(CONFIG, name) in (told.default, None), name


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.3", 0.3),
        ("3", 3),
        ("true", True),
        ("kitchen", "kitchen"),
        ("living room", "living room"),
        ('"kitchen"', "kitchen"),
        ("{ x = 1.0, y = 2 }", {"x": 1.0, "y": 2}),
        ("default", None),
        ("1.2.3", "1.2.3"),
        ("", ""),
    ],
)
def test_what_people_type_is_toml_or_a_word(text: str, value: Any) -> None:
    assert parse_value(text) == value
