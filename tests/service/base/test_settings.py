"""Settings that are changed while the robot runs: what counts, what is saved, what is refused."""

import math
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import PoseConfig, RobotConfig, load_config
from trolley.config.kept_settings import load_with_kept
from trolley.messages import ChangedSetting, ConfigChanges, Setting, Settings
from trolley.messages.request_params import SetConfig, WhichConfig
from trolley.runtime import codec
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley_base.settings_file import Saved, SettingsFiles

from .conftest import MakeConfig, Rig

FILE = """\
# The cat's robot.
[robot]
name = "trolley"   # as on its collar
footprint = { length_m = 0.3, width_m = 0.24 }

[base.simulated]
world = "hall"

[base.limits]
max_speed_mps = 0.4   # the carpet

[planner]
# max_speed_mps = 0.5  # number above 0 and at most 5
"""


class Filed(Rig):
    """Base that was started with a file."""

    def __init__(self, file: Path, state: Path) -> None:
        self.file = file
        self.kept = state / "trolley" / "settings.toml"
        super().__init__(load_with_kept(file, state).config, state)

    @property
    def changes(self) -> list[ChangedSetting]:
        """What counts now, whatever stands in files."""
        (reply,) = self.lockstep.get(topics.CONFIG.key(self.lockstep.robot))
        return codec.decode(ConfigChanges, reply.payload, reply.encoding).changes

    def get(self, section: str, key: str) -> Setting:
        (found,) = self.lockstep.ask(
            requests.CONFIG_GET, WhichConfig(section=section, key=key)
        ).settings
        return found

    def set(self, section: str, *, save: bool = True, **values: Any) -> Settings:
        params = SetConfig(section=section, values=values, save=save)
        return self.lockstep.ask(requests.CONFIG_SET, params)

    def says(self) -> dict[str, Any]:
        """What stands in the file."""
        return tomllib.loads(self.file.read_text())

    def read_anew(self) -> RobotConfig:
        """What a service that starts now runs with."""
        return load_with_kept(self.file, self.kept.parents[1]).config

    def started_anew(self) -> None:
        """Restart base with what stands in the files now."""
        self.restart(self.read_anew())
        self.run(0.2)


@pytest.fixture
def filed(make_config: MakeConfig, tmp_path: Path) -> Iterator[Filed]:
    make_config()  # writes the world
    file = tmp_path / "robot.toml"
    file.write_text(FILE)
    rig = Filed(file, tmp_path / "state")
    rig.run(0.2)
    yield rig
    rig.lockstep.close()


def test_a_limit_holds_from_the_next_period_on(filed: Filed) -> None:
    robots = filed.lockstep.record(topics.ROBOT)
    filed.drive(1.5, 0.4)
    assert filed.truth.twist.vx == pytest.approx(0.4, abs=0.01)
    filed.set("base.limits", max_speed_mps=0.15)
    filed.drive(0.5, 0.4)
    assert filed.driven[-1].twist.vx == pytest.approx(0.15, abs=0.001)
    speeds = [command.twist.vx for command in filed.driven[-6:]]
    assert speeds == sorted(speeds, reverse=True), "it slows down, and never speeds up again"
    assert robots[-1].max_speed == 0.15
    assert filed.state.mode == "ok"


def test_a_change_never_sets_the_robot_off(filed: Filed) -> None:
    filed.set("base.limits", max_speed_mps=0.2)
    filed.set("planner", max_speed_mps=1.0)
    filed.run(2.0)
    assert all(command.twist.is_zero for command in filed.driven)


def test_a_limit_is_not_raised_above_what_people_wrote(filed: Filed) -> None:
    with pytest.raises(Refused, match=r"\[base.limits\] max_speed_mps may be at most 0.4") as found:
        filed.set("base.limits", max_speed_mps=0.5)
    assert found.value.code == codes.BAD_REQUEST
    filed.set("base.limits", max_speed_mps=0.1)
    filed.started_anew()
    done = filed.set("base.limits", max_speed_mps=0.4)
    assert "It counts after a restart of the base." in done.message
    setting = filed.get("base.limits", "max_speed_mps")
    assert (setting.value, setting.next) == (0.1, 0.4), "the stop field reckons with less"
    filed.drive(1.5, 0.4)
    assert filed.truth.twist.vx <= 0.101
    with pytest.raises(Refused, match=r"at most 0\.4"):
        filed.set("base.limits", max_speed_mps=0.45)
    filed.started_anew()
    assert filed.get("base.limits", "max_speed_mps").value == 0.4


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("base.limits", "deceleration_mps2", 0.5),
        ("base.limits", "slope", 0.0),
        ("base", "stop_margin_m", 0.0),
        ("base", "sources", {"planner": 100}),
        ("base", "driver", "hardware"),
        ("base.lidar", "range_max_m", 2.0),
        ("robot", "name", "other"),
        ("viz", "host", "0.0.0.0"),
        ("viz", "always_ask", False),
        ("zenoh", "keys", "/tmp"),
        ("mqtt", "password_file", "/etc/passwd"),
        ("tour", "history_days", 1),
    ],
)
def test_what_the_robot_is_and_who_may_reach_it_stays_in_the_file(
    filed: Filed, section: str, key: str, value: Any
) -> None:
    with pytest.raises(Refused) as found:
        filed.set(section, **{key: value})
    assert found.value.code == codes.ONLY_IN_FILE
    assert f"[{section}] {key}" in found.value.message
    assert filed.file.read_text() == FILE
    assert filed.get(section, key).acts == "file"


@pytest.mark.parametrize(
    ("section", "values", "code", "words"),
    [
        (
            "planner",
            {"max_speed_mps": 7.0},
            codes.BAD_REQUEST,
            r"max_speed_mps cannot be 7.0. Allowed: number above 0 and at",
        ),
        (
            "planner",
            {"max_speed_mps": -0.1},
            codes.BAD_REQUEST,
            "max_speed_mps cannot be",
        ),
        (
            "planner",
            {"max_speed_mps": "fast"},
            codes.BAD_REQUEST,
            "max_speed_mps cannot be",
        ),
        (
            "planner",
            {"max_speed_mps": [[]]},
            codes.BAD_REQUEST,
            "max_speed_mps cannot be",
        ),
        ("planner", {"controller": "zap"}, codes.BAD_REQUEST, "controller cannot be"),
        (
            "planner",
            {"max_sped_mps": 0.3},
            codes.UNKNOWN_NAME,
            "no setting 'max_sped_mps'. Did you mean max_speed_mps",
        ),
        ("planer", {"max_speed_mps": 0.3}, codes.UNKNOWN_NAME, "no section 'planer'.*planner"),
        ("planner", {}, codes.BAD_REQUEST, "which setting"),
        (
            "planner",
            {"clearance_m": 0.1, "fade_s": 0.0},
            codes.BAD_REQUEST,
            "fade_s cannot be",
        ),
        (
            "planner",
            {"max_speed_mps": math.nan},
            codes.BAD_REQUEST,
            "max_speed_mps cannot be NaN. A",
        ),
        ("planner", {"max_speed_mps": math.inf}, codes.BAD_REQUEST, "max_speed_mps cannot be Inf"),
        ("start", {"pose": "a\x7fb"}, codes.BAD_REQUEST, "names no place"),
        ("start", {"pose": ""}, codes.BAD_REQUEST, "names no place"),
        ("start", {"pose": "../../etc"}, codes.BAD_REQUEST, "names no place"),
        ("start", {"pose": "x" * 100_000}, codes.BAD_REQUEST, "names no place"),
        ("start", {"pose": {"x": 1.0}}, codes.BAD_REQUEST, r"\[start\] pose cannot be"),
        (
            "start",
            {"pose": {"x": 0.0, "y": 0.0, "yaw": 0.0, "orientation": [0.0, 0.0, 0.0, 1.0]}},
            codes.BAD_REQUEST,
            r"start",
        ),
    ],
)
def test_a_bad_value_changes_nothing_and_the_sentence_names_it(
    filed: Filed, section: str, values: dict[str, Any], code: str, words: str
) -> None:
    with pytest.raises(Refused, match=words) as found:
        filed.set(section, **values)
    assert found.value.code == code
    assert filed.file.read_text() == FILE
    assert filed.changes == []


def test_it_is_saved_in_the_place_that_explains_it_and_comments_stay(filed: Filed) -> None:
    done = filed.set("planner", max_speed_mps=0.3, clearance_m=0.05)
    assert done.message == f"It counts at once. Saved in {filed.file}."
    text = filed.file.read_text()
    assert text.startswith(FILE.partition("[planner]")[0])
    assert filed.says()["planner"] == {"max_speed_mps": 0.3, "clearance_m": 0.05}
    again = filed.set("planner", max_speed_mps=0.3)
    assert again.message == "It counts at once. That is what robot.toml says."
    assert filed.file.read_text() == text
    filed.set("base.limits", max_speed_mps=0.35)
    assert "max_speed_mps = 0.35   # the carpet" in filed.file.read_text()


def test_null_is_the_default(filed: Filed) -> None:
    filed.set("planner", max_speed_mps=0.3)
    done = filed.set("planner", max_speed_mps=None)
    assert (done.settings[0].value, done.settings[0].default) == (0.5, 0.5)
    assert "max_speed_mps" not in filed.says().get("planner", {})
    assert filed.changes[0].value == 0.5


def test_what_has_no_line_stays_without(filed: Filed) -> None:
    done = filed.set("tour", low_battery=None)
    assert done.message == "It counts at once. That is what robot.toml says."
    assert done.settings[0].value == 0.2
    filed.set("planner", max_speed_mps=None)
    assert filed.file.read_text() == FILE


@pytest.mark.parametrize(
    "pose", ["kitchen", {"x": 1.0, "y": -0.5, "yaw": 1.5}, {"x": 1, "y": 2, "yaw": 0}, None]
)
def test_where_the_robot_starts_counts_at_the_next_start(filed: Filed, pose: Any) -> None:
    filed.set("start", pose="elsewhere")
    done = filed.set("start", pose=pose, always=True)
    assert "It counts after a restart of the localizer." in done.message
    assert filed.get("start", "pose").next == load_pose(filed)
    assert filed.says()["start"].get("pose") == pose
    assert filed.says()["start"]["always"] is True
    assert filed.changes == [], "no service takes it up now"


def load_pose(filed: Filed) -> Any:
    return msgspec.to_builtins(load_config(filed.file).start.pose)


# The file is other people's, too.


def test_what_somebody_else_wrote_meanwhile_is_kept(filed: Filed) -> None:
    filed.file.write_text(FILE.replace("# max_speed_mps = 0.5 ", "patience_s = 9.0 "))
    filed.set("planner", max_speed_mps=0.3)
    assert filed.says()["planner"] == {"patience_s": 9.0, "max_speed_mps": 0.3}
    assert "# number above 0" in filed.file.read_text()


def test_what_somebody_set_otherwise_meanwhile_is_not_overwritten(filed: Filed) -> None:
    edited = FILE.replace("# max_speed_mps = 0.5 ", "max_speed_mps = 0.2 ")
    filed.file.write_text(edited)
    with pytest.raises(Refused, match=r"now says max_speed_mps = 0\.2, not 0\.5") as found:
        filed.set("planner", max_speed_mps=0.3)
    assert found.value.code == codes.FILE_CHANGED
    assert filed.file.read_text() == edited
    assert filed.changes == []
    assert filed.set("planner", max_speed_mps=0.2).message.startswith("It counts at once")


def test_a_file_that_is_broken_by_now_is_left_alone(filed: Filed) -> None:
    filed.file.write_text(FILE + "zap = [")
    with pytest.raises(Refused, match="cannot be used as it is") as found:
        filed.set("planner", max_speed_mps=0.3)
    assert found.value.code == codes.FILE_CHANGED
    assert filed.file.read_text() == FILE + "zap = ["


def test_two_settings_that_may_not_be_together_are_refused_as_at_the_start(filed: Filed) -> None:
    filed.set("start", pose={"x": 0.0, "y": 0.0, "yaw": 0.0})
    edited = filed.file.read_text().replace("yaw = 0.0", "yaw = 0.0, orientation = [0, 0, 0, 1]")
    filed.file.write_text(edited)
    with pytest.raises(Refused) as found:
        filed.set("start", always=True)
    assert found.value.code == codes.FILE_CHANGED
    assert filed.file.read_text() == edited


Spoil = Callable[[Path], object]


def no_room_anywhere(file: Path) -> None:
    """Neither robot.toml nor what takes its place can be written."""
    file.chmod(0o444)
    (file.parent / "state" / "trolley" / "settings.toml").mkdir()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda file: file.unlink(), "is gone"),
        (no_room_anywhere, "is write-protected, and .*settings.toml cannot be written: "),
    ],
)
def test_what_cannot_be_saved_counts_until_base_is_restarted_and_is_said(
    filed: Filed, spoil: Spoil, words: str
) -> None:
    spoil(filed.file)
    done = filed.set("planner", max_speed_mps=0.3)
    assert "It counts at once. Not saved, so only until base is restarted" in done.message
    assert re.search(words, done.message)
    assert not done.settings[0].saved
    assert [(one.value, one.saved) for one in filed.changes] == [(0.3, False)]
    with pytest.raises(Refused, match=words) as found:
        filed.set("start", pose="kitchen")
    assert found.value.code == codes.NOT_SAVED
    filed.restart()
    filed.run(0.2)
    assert filed.changes == []
    assert filed.get("planner", "max_speed_mps").value == 0.5


# Where robot.toml cannot be written.


@pytest.fixture
def protected(filed: Filed) -> Filed:
    """Base with a robot.toml that it may not write."""
    filed.file.chmod(0o444)
    return filed


def test_what_robot_toml_cannot_take_is_kept_and_counts_after_a_restart(protected: Filed) -> None:
    done = protected.set("planner", max_speed_mps=0.3)
    assert done.message == (
        f"It counts at once. Saved in {protected.kept}, since {protected.file} is write-protected. "
        "If you edit it in robot.toml later, that counts."
    )
    assert (done.settings[0].saved, done.settings[0].source) == (True, "settings_toml")
    protected.set("start", pose={"x": 1.0, "y": 2.0, "yaw": 0.0})
    protected.set("tour", low_battery=0.4)
    assert protected.file.read_text() == FILE
    config = protected.read_anew()
    assert (config.planner.max_speed_mps, config.tour.low_battery) == (0.3, 0.4)
    assert config.start.pose == PoseConfig(x=1.0, y=2.0, yaw=0.0)
    protected.started_anew()
    assert [(one.key, one.value) for one in protected.changes] == [
        ("max_speed_mps", 0.3),
        ("low_battery", 0.4),
    ], "services that ran on hear it again"
    assert protected.get("start", "pose").source == "settings_toml"
    assert protected.get("planner", "clearance_m").source == "default"
    assert protected.get("base.limits", "max_speed_mps").source == "robot_toml"


def test_an_edit_of_robot_toml_counts_from_then_on(protected: Filed) -> None:
    protected.set("planner", max_speed_mps=0.3, clearance_m=0.07)
    edited = FILE.replace("# max_speed_mps = 0.5 ", "max_speed_mps = 0.2 ")
    protected.file.write_text(edited)
    protected.started_anew()
    assert protected.get("planner", "max_speed_mps").value == 0.2
    assert protected.get("planner", "clearance_m").value == 0.07
    protected.file.write_text(FILE)
    protected.started_anew()
    assert protected.get("planner", "max_speed_mps").value == 0.5, "what was edited away stays so"
    assert protected.get("planner", "clearance_m").value == 0.07


def test_a_kept_limit_lies_below_what_people_wrote(protected: Filed) -> None:
    protected.set("base.limits", max_speed_mps=0.1)
    protected.started_anew()
    protected.drive(1.5, 0.4)
    assert protected.truth.twist.vx == pytest.approx(0.1, abs=0.001)
    with pytest.raises(Refused, match=r"at most 0\.4"):
        protected.set("base.limits", max_speed_mps=0.5)
    protected.set("base.limits", max_speed_mps=0.4)
    protected.started_anew()
    assert protected.get("base.limits", "max_speed_mps").source == "robot_toml"
    assert protected.get("base.limits", "max_speed_mps").value == 0.4


def test_an_edited_limit_is_the_highest_even_where_it_is_what_was_kept(protected: Filed) -> None:
    protected.set("base.limits", max_speed_mps=0.1)
    protected.file.write_text(FILE.replace("max_speed_mps = 0.4", "max_speed_mps = 0.1"))
    protected.started_anew()
    with pytest.raises(Refused, match=r"at most 0\.1"):
        protected.set("base.limits", max_speed_mps=0.2)


def test_a_limit_is_not_kept_above_what_robot_toml_says(filed: Filed) -> None:
    filed.set("base.limits", max_speed_mps=0.1)
    filed.file.chmod(0o444)
    done = filed.set("base.limits", max_speed_mps=0.3)
    assert "a limit is never kept above what it says" in done.message
    assert not done.settings[0].saved
    filed.kept.write_text(
        "[set.base.limits]\nmax_speed_mps = 0.9\n[instead_of.base.limits]\nmax_speed_mps = 0.1\n"
    )
    filed.started_anew()
    assert filed.get("base.limits", "max_speed_mps").value == 0.1


def test_default_in_place_of_what_robot_toml_says_is_kept(protected: Filed) -> None:
    protected.file.write_text(FILE + 'patience_s = 9.0\n[start]\npose = "kitchen"\n')
    protected.started_anew()
    protected.set("start", pose=None)
    protected.set("planner", patience_s=None)
    config = protected.read_anew()
    assert config.start.pose is None
    assert config.planner.patience_s == protected.get("planner", "patience_s").default
    protected.set("start", pose="kitchen")
    assert load_pose(protected) == msgspec.to_builtins(protected.read_anew().start.pose)


def test_a_robot_toml_that_can_be_written_again_takes_what_is_set(protected: Filed) -> None:
    protected.set("planner", max_speed_mps=0.3, clearance_m=0.07)
    protected.file.chmod(0o644)
    done = protected.set("planner", max_speed_mps=0.2)
    assert done.message == f"It counts at once. Saved in {protected.file}."
    assert done.settings[0].source == "robot_toml"
    assert protected.says()["planner"] == {"max_speed_mps": 0.2}
    assert "max_speed_mps" not in protected.kept.read_text()
    protected.started_anew()
    assert protected.get("planner", "max_speed_mps").value == 0.2
    assert protected.get("planner", "clearance_m").value == 0.07


def test_back_to_what_robot_toml_says_nothing_is_kept(protected: Filed) -> None:
    protected.set("planner", max_speed_mps=0.3)
    done = protected.set("planner", max_speed_mps=None)
    assert done.message == "It counts at once. That is what robot.toml says."
    protected.started_anew()
    assert protected.get("planner", "max_speed_mps").value == 0.5
    assert protected.read_anew().kept == ()


@pytest.mark.parametrize(
    "content", ["zap", "", "schema = 99\n", "[set]\n", "[set]\n[zap]\na = 1\n"]
)
def test_a_broken_file_of_kept_settings_is_set_aside_and_said(
    protected: Filed, content: str
) -> None:
    protected.kept.write_text(content)
    loaded = load_with_kept(protected.file, protected.kept.parents[1])
    assert "what is set there does not count" in loaded.troubles[0]
    protected.started_anew()
    (aside,) = protected.kept.parent.glob("settings.toml.*-*")
    assert aside.read_text() == content
    assert protected.get("planner", "max_speed_mps").value == 0.5
    protected.set("planner", max_speed_mps=0.3)
    assert protected.read_anew().planner.max_speed_mps == 0.3


def test_what_is_kept_and_not_allowed_does_not_count_and_is_not_lost(protected: Filed) -> None:
    protected.kept.write_text(
        '[set]\nviz = { host = "0.0.0.0" }\n'
        "planner = { max_speed_mps = 99.0, clearance_m = 0.07 }\n"
        "[instead_of]\n"
    )
    loaded = load_with_kept(protected.file, protected.kept.parents[1])
    assert len(loaded.troubles) == 2
    assert "[viz] host is set only in robot.toml" in loaded.troubles[0]
    assert "[planner.max_speed_mps]" in loaded.troubles[1]
    protected.started_anew()
    assert protected.get("planner", "max_speed_mps").value == 0.5
    assert protected.get("planner", "clearance_m").value == 0.07
    protected.set("tour", low_battery=0.4)
    kept = tomllib.loads(protected.kept.read_text())["set"]
    assert kept["viz"] == {"host": "0.0.0.0"}
    assert kept["planner"]["max_speed_mps"] == 99.0


def test_two_changes_in_a_row_are_both_saved(filed: Filed) -> None:
    """The second is asked before base has heard what became of the first."""
    files = SettingsFiles(
        filed.file, load_config(filed.file), StateFolder(filed.kept.parent, Log("t")), []
    )
    assert files.save("planner", {"max_speed_mps": 0.3}) == Saved(True, is_written=True)
    assert files.save("planner", {"max_speed_mps": 0.2}) == Saved(True, is_written=True)
    assert filed.says()["planner"] == {"max_speed_mps": 0.2}


def test_without_a_file_it_counts_and_says_so(rig: Rig) -> None:
    asked = SetConfig(section="planner", values={"max_speed_mps": 0.3})
    done = rig.lockstep.ask(requests.CONFIG_SET, asked)
    assert "runs without a robot.toml" in done.message
    assert done.settings[0].value == 0.3


def test_asked_not_to_save_it_does_not(filed: Filed) -> None:
    done = filed.set("planner", save=False, max_speed_mps=0.3)
    assert "you asked not to save it" in done.message
    assert filed.file.read_text() == FILE


def test_a_service_that_ran_on_hears_what_was_set_before_base_was_restarted(filed: Filed) -> None:
    filed.set("planner", max_speed_mps=0.3)
    filed.started_anew()
    assert [one.value for one in filed.changes] == [0.3]
    filed.file.write_text(FILE)
    filed.started_anew()
    assert filed.changes == [], "the file rules"


def test_every_setting_is_told_with_all_there_is_to_say(filed: Filed) -> None:
    told = filed.lockstep.ask(requests.CONFIG_GET, WhichConfig())
    assert told.file == str(filed.file)
    assert len(told.settings) > 100
    speed = filed.get("planner", "max_speed_mps")
    assert (speed.value, speed.default, speed.least, speed.greatest) == (0.5, 0.5, 0.0, 5.0)
    assert (speed.unit, speed.acts, speed.service) == ("m/s", "at_once", "planner")
    assert "Highest speed" in speed.meaning
    assert filed.get("planner", "controller").choices == ["mppi", "pursuit"]
    assert filed.get("localizer", "max_particles").acts == "restart"
    with pytest.raises(Refused, match="no setting 'zap'"):
        filed.get("planner", "zap")
