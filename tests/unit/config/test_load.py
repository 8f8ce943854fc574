"""`robot.toml`: defaults, what it refuses, and how it says so."""

import math
from pathlib import Path

import pytest

from trolley.config import ConfigError, PoseConfig, find_config, load_config

MINIMAL = '[robot]\nname = "robby"\nfootprint = {radius_m = 0.2}\n'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(MINIMAL)
    return path


def test_everything_that_can_be_guessed_has_a_default(file: Path):
    config = load_config(file)
    assert config.robot.name == "robby"
    assert config.zenoh.connect == ["tcp/127.0.0.1:7447"]
    assert config.map.file is None
    assert config.start.pose is None
    assert config.planner.frame == "map"


def test_paths_count_from_the_file(file: Path, tmp_path: Path):
    config = load_config(file)
    assert config.path("maps/home.yaml") == tmp_path / "maps" / "home.yaml"
    assert config.path("/srv/home.yaml") == Path("/srv/home.yaml")
    assert config.path("~/home.yaml") == Path.home() / "home.yaml"
    # Of a user who is not there; such a name is also that of a file that an office program locks.
    assert config.path("~no body/home.yaml") == tmp_path / "~no body" / "home.yaml"


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("[planner]\nmax_sped_mps = 1.0", "[planner] unknown key `max_sped_mps`"),
        ("[plan]\n", "unknown key `plan`. Did you mean planner?"),
        ("[planner]\nmax_speed = 1.0", "unknown key `max_speed`. Did you mean max_speed_mps"),
        ("critics_per_s = 1.0", "[robot] unknown key `critics_per_s`. There are "),
        ("[localizer]\nmap = 'x'", "[localizer] unknown key `map`"),
        (
            "[base]\nmax_speed_mps = 1.0",
            "unknown key `max_speed_mps`; it belongs in [base.limits], [planner]",
        ),
        ("[lidar]\n", "unknown key `lidar`; it belongs in [base.lidar]"),
        ("[base.scans.left]\nmodel = 'x'", "[base.scans[...]] unknown key `model`"),
        ("folder = 'x'", "[robot] unknown key `folder`"),
        ('[planner]\nmax_speed_mps = "fast"', "[planner.max_speed_mps]"),
        ("[planner]\nmax_speed_mps = -1.0", "[planner.max_speed_mps]"),
        ("[planner]\nmax_speed_mps = nan", "[planner.max_speed_mps]"),
        ("[planner]\nmax_speed_mps = inf", "[planner.max_speed_mps]"),
        ('[planner]\nframe = "base"', "[planner.frame] it may be `map` or `odom`, not 'base'"),
        ("[zenoh]\nconnect = []", "[zenoh.connect]"),
        ("[zenoh]\nconnect = ['127.0.0.1:7447']", "not an endpoint"),
        ("[zenoh]\nuplink = ['tls/home.lan']", "not an endpoint"),
        (
            f"[zenoh]\nconnect = ['unixsock-stream//{'x' * 107}']",
            "a Unix socket's path has 107 bytes at most, this one 108",
        ),
        ("[zenoh]\nconnect = ['tcp/127.0.0.1:99999']", "its port must be from 1 to 65535"),
        ("[zenoh]\nuplink = ['tls/home.lan:0']", "its port must be from 1 to 65535"),
        (
            "[zenoh]\nconnect = ['quic/127.0.0.1:7447']",
            "the protocol is one of tcp, tls and unixsock-stream",
        ),
        ("[zenoh]\nconnect = ['tcp/0.0.0.0:7447']", "no router listens at 'tcp/0.0.0.0:7447'"),
        ("[zenoh]\nconnect = ['tcp/kiwi.local:7447']", "tls/home.local:7448"),
        (
            "[zenoh]\nuplink = ['quic/home.lan:7448']",
            "the protocol is one of tcp, tls and unixsock-stream",
        ),
        ("[zenoh]\nuplink = ['tcp/home.lan:7447']", "over TLS"),
        ("[zenoh]\ndownsample = {pose = 1.0}", "`downsample` knows scan"),
        ("[zenoh]\ndownsample = {scan = 0.0}", "[zenoh.downsample"),
        ("[start]\npose = {x = 1.0, y = 2.0}", "yaw or orientation"),
        (
            "[start]\npose = {x = 1.0, y = 2.0, yaw = 90}",
            "[start.pose] yaw 90 is more than a full turn: angles are in radians",
        ),
        ("[start]\npose = {x = 1.0, y = 2.0, yaw = nan}", "[start"),
        ("[start]\npose = {x = 1.0, y = 2.0, orientation = [1.0, 0.0, 0.0, 1.0]}", "tilted"),
        ("[robot]\n", "TOML"),
        ("a = ", "TOML"),
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "9" * 5000, "TOML"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_key(file: Path, more: str, told: str):
    file.write_text(MINIMAL + more)
    with pytest.raises(ConfigError) as error:
        load_config(file)
    assert str(file) in str(error.value)
    assert told in str(error.value)


def test_a_footprint_that_is_a_number_is_told_what_to_give(file: Path) -> None:
    file.write_text("[robot]\nname = 'a'\nfootprint = 0.3\n")
    ways = "{length_m, width_m}, {radius_m} or {polygon_m = [[x, y], ...]}"
    with pytest.raises(ConfigError) as error:
        load_config(file)
    assert str(error.value) == f"{file}: [robot.footprint] give {ways}, not a number"


@pytest.mark.parametrize(
    "robot",
    [
        'name = "Robby"\nfootprint = {radius_m = 0.2}',
        'name = ""\nfootprint = {radius_m = 0.2}',
        f'name = "{"r" * 33}"\nfootprint = {{radius_m = 0.2}}',
        'name = "../r"\nfootprint = {radius_m = 0.2}',
        'name = "r\\n"\nfootprint = {radius_m = 0.2}',
        'name = "r"',
        'name = "r"\nfootprint = {}',
        'name = "r"\nfootprint = {length_m = 0.4}',
        'name = "r"\nfootprint = {radius_m = 0.2, length_m = 0.4, width_m = 0.3}',
        'name = "r"\nfootprint = {radius_m = 0.0}',
        'name = "r"\nfootprint = {polygon_m = [[0.0, 0.0], [1.0, 0.0]]}',
        'name = "r"\nfootprint = {radius_m = 0.2}\ndrive = "tank"',
    ],
)
def test_a_robot_that_cannot_be_is_refused(file: Path, robot: str):
    file.write_text(f"[robot]\n{robot}\n")
    with pytest.raises(ConfigError, match="robot"):
        load_config(file)


def test_a_file_that_cannot_be_read_says_why(tmp_path: Path):
    with pytest.raises(ConfigError, match="No such file"):
        load_config(tmp_path / "absent.toml")
    with pytest.raises(ConfigError, match="directory"):
        load_config(tmp_path)
    (tmp_path / "noise").write_bytes(b"[robot]\n\nname = 'caf\xe9'\n")
    with pytest.raises(ConfigError, match="line 3 is not UTF-8 text; save it as UTF-8"):
        load_config(tmp_path / "noise")


def test_a_byte_order_mark_is_named(file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    with pytest.raises(ConfigError, match="byte order mark; save it as UTF-8 without"):
        load_config(file)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("title = \u201cKiwi\u201d", "(at line 4, column 9); text stands in straight quotes"),
        ("title = \u201eKiwi\u201c", "(at line 4, column 9); text stands in straight quotes"),
        ("[planner]\nmax_speed_mps = 0,3", "(at line 5, column 18); decimals have a point: 0.5"),
        ("[start]\npose = {x = -0,5, y = 0}", "; decimals have a point: 0.5"),
        ("points = [[0.2,0.1], [0.2.0,1]]", "Unclosed array (at line 4, column 26)"),
        ("title = Kiwi", "(at line 4, column 9)"),
    ],
)
def test_what_people_type_in_place_of_toml_is_named(file: Path, line: str, told: str) -> None:
    file.write_text(f"[robot]\nname = 'a'\nfootprint = {{radius_m = 0.2}}\n{line}\n")
    with pytest.raises(ConfigError) as error:
        load_config(file)
    assert told in str(error.value)
    assert (";" in told) == (";" in str(error.value))


def test_the_file_is_found_where_it_is_named(tmp_path: Path):
    one, other = tmp_path / "one", tmp_path / "other"
    assert find_config(one, {"TROLLEY_CONFIG": str(other)}) == one
    assert find_config(None, {"TROLLEY_CONFIG": str(other)}) == other


def test_a_pose_may_be_given_as_a_quaternion():
    straight = PoseConfig(x=1.0, y=2.0, orientation=(0.0, 0.0, 2.0, 2.0)).as_pose()
    assert straight.yaw == pytest.approx(math.pi / 2)
    assert PoseConfig(x=1.0, y=2.0, yaw=1.5 * math.pi).as_pose().yaw == pytest.approx(-math.pi / 2)
