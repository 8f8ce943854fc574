"""Commands as far as they need no robot."""

import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, version
from pathlib import Path

import click
import msgspec
import pytest
from click.testing import CliRunner

from trolley.cli import COMMANDS, PLUGINS, cli, plugins
from trolley.cli.go import go_command
from trolley.cli.init import render
from trolley.cli.options import FloatRange
from trolley.config import RobotConfig, load_config
from trolley.config.describe import sections


def walk(
    command: click.Command, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command and group, and its path."""
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from walk(below, (*path, name))


MAP = "image: home.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
MAP += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.fixture
def runner() -> CliRunner:
    return CliRunner()


@pytest.mark.parametrize("path", [path for path, _ in walk(cli)], ids=" ".join)
def test_every_command_explains_itself(runner: CliRunner, path: tuple[str, ...]) -> None:
    result = runner.invoke(cli, [*path, "--help"])
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert lines[0].startswith("Usage:")
    assert len(lines[2].strip()) > 10


def test_no_number_may_be_nan() -> None:
    numbers = (type(click.FLOAT), click.FloatRange)
    careless = [
        f"{' '.join(path)}: {parameter.name}"
        for path, command in walk(cli)
        for parameter in command.params
        for kind in (
            parameter.type.types if isinstance(parameter.type, click.Tuple) else [parameter.type]
        )
        if isinstance(kind, numbers) and not isinstance(kind, FloatRange)
    ]
    assert careless == []


def test_the_table_of_commands_has_the_words_of_the_help() -> None:
    context = click.Context(cli)
    assert [name for name in COMMANDS if cli.get_command(context, name) is None] == []


def test_what_services_bring_along_is_listed_in_its_own_words(runner: CliRunner) -> None:
    context = click.Context(cli)
    listed = " ".join(runner.invoke(cli, ["--help"], terminal_width=300).output.split())
    for name in cli.list_commands(context):
        if name not in COMMANDS:
            command = cli.get_command(context, name)
            assert command is not None
            assert f"{name} {command.get_short_help_str(limit=1000)}" in listed


@pytest.mark.programs
def test_the_list_of_commands_imports_none_of_them() -> None:
    program = """
import sys
from click.testing import CliRunner
from trolley.cli import cli
assert "emulate" in CliRunner().invoke(cli, ["--help"]).output
print({"numpy", "numba", "zenoh", "viser"} & sys.modules.keys())
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script(runner: CliRunner, shell: str) -> None:
    result = runner.invoke(cli, ["completion", shell])
    assert result.exit_code == 0
    assert "_TROLLEY_COMPLETE" in result.output


def test_names_are_completed_in_the_shell(runner: CliRunner) -> None:
    words = {"COMP_WORDS": "trolley topic echo costm", "COMP_CWORD": "3"}
    result = runner.invoke(
        cli, env={**words, "_TROLLEY_COMPLETE": "bash_complete"}, prog_name="trolley"
    )
    assert result.output.split() == ["plain,costmap", "plain,costmap/global"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["1"] * 4, "X Y YAW"),
        (["1", "two"], "Y must be a number"),
        (["1", "nan"], "Y must be a number"),
        (["1", "--wiat", "2"], "No such option"),
        (["-1", "-x"], "No such option"),
        (["kitchen", "--timeout", "0"], "--timeout"),
        (["kitchen", "--timeout", "-3"], "--timeout"),
        ([], "Missing argument"),
    ],
)
def test_go_refuses_what_is_no_place(runner: CliRunner, arguments: list[str], problem: str) -> None:
    result = runner.invoke(go_command, arguments)
    assert result.exit_code == 2
    assert problem in result.output


def test_init_writes_a_file_that_loads_and_never_overwrites(
    runner: CliRunner, tmp_path: Path
) -> None:
    path = tmp_path / "robot.toml"
    arguments = ["init", str(path), "--name", "r2", "--length", "0.5", "--width", "0.4"]
    (tmp_path / "home.yaml").write_text(MAP)
    (tmp_path / "home.pgm").write_bytes(b"P5 1 1 255\n\0")
    assert runner.invoke(cli, [*arguments, "--map", "home.yaml"]).exit_code == 0
    config = load_config(path)
    assert (config.robot.name, config.robot.footprint.length_m) == ("r2", 0.5)
    assert config.path(config.map.file or "") == tmp_path / "home.yaml"
    lines = path.read_text().splitlines()
    assert not [line for line in lines if line.startswith("#") and line.endswith("-")]
    before = path.read_bytes()
    again = runner.invoke(cli, arguments)
    assert again.exit_code == 2
    assert "already exists" in again.output
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--map", "none.yaml"], "none.yaml is not there; leave it out"),
        (["--map", "song.yaml"], "not valid YAML (not text)"),
        (["--map", "torn.yaml"], "there is no such image"),
        (["--map", "my home.yaml"], "'my home' cannot name a map: a map's name has 1 to 64 of A-Z"),
        (["--length", "0.01"], "it must be at least 0.02"),
    ],
)
def test_init_writes_nothing_that_no_robot_could_use(
    runner: CliRunner, tmp_path: Path, words: list[str], why: str
) -> None:
    (tmp_path / "torn.yaml").write_text(MAP)
    (tmp_path / "my home.yaml").write_text(MAP)
    (tmp_path / "song.yaml").write_bytes(b"\x89\xff\0")
    result = runner.invoke(cli, ["init", str(tmp_path / "robot.toml"), *words])
    assert result.exit_code == 2
    assert why in " ".join(result.output.split())
    assert not (tmp_path / "robot.toml").exists()


@pytest.mark.parametrize("name", ["", "R2", "a b", "a/b", "x" * 33])
def test_init_refuses_a_name_that_no_key_may_hold(
    runner: CliRunner, tmp_path: Path, name: str
) -> None:
    result = runner.invoke(cli, ["init", str(tmp_path / "robot.toml"), "--name", name])
    assert result.exit_code == 2
    assert not (tmp_path / "robot.toml").exists()


def load_config_of(path: Path, text: str) -> RobotConfig:
    other = path.with_name("other.toml")
    other.write_text(text)
    return load_config(other)


def test_init_explains_every_setting_with_its_default(tmp_path: Path) -> None:
    text = render({"robot.name": '"a"', "robot.footprint": "{ radius_m = 0.2 }"})
    for section in sections():
        assert f"[{section.name}]" in text
        for key in section.keys:
            assert f"{key.name} =" in text
    # Taking all comment signs from the defaults changes nothing.
    path = tmp_path / "robot.toml"
    path.write_text(text)
    plain = load_config(path)
    few = load_config_of(path, '[robot]\nname = "a"\nfootprint = { radius_m = 0.2 }\n')
    assert msgspec.structs.replace(plain, file=few.file) == few
    defaults = {f"# {k.name} = {k.default}" for s in sections() for k in s.keys if k.default}
    # Some tables are left out: they have to be given in full.
    parts = text.split("\n\n")
    lines = [line for part in parts if "\n# [" not in part for line in part.split("\n")]
    path.write_text(
        "\n".join(line.removeprefix("# ") if line in defaults else line for line in lines)
    )
    assert load_config(path) == plain


def test_every_setting_has_a_name_and_bounds_in_words() -> None:
    found = {f"{s.name}.{k.name}": k for s in sections() for k in s.keys}
    assert found["viz.port"].allowed == "whole number from 1 to 65535"
    assert found["robot.name"].is_required
    assert found["zenoh.connect"].default == '["tcp/127.0.0.1:7447"]'
    assert found["planner.frame"].allowed == '`"map"` or `"odom"`'


def test_it_says_which_release_it_is(runner: CliRunner) -> None:
    said = runner.invoke(cli, ["--version"])
    assert (said.exit_code, said.output) == (0, f"trolley, version {version('trolley-robot')}\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--connect", "foo"], "is not an endpoint"),
        (["--connect", ""], "is not an endpoint"),
        (["--connect", "tcp/127.0.0.1:99999"], "is not an endpoint"),
        (["--robot", "Bad Name"], "a robot's name is"),
    ],
)
def test_where_nobody_can_be_is_refused_at_once(words: list[str], said: str) -> None:
    done = CliRunner().invoke(cli, ["status", *words])
    assert done.exit_code == 2
    assert said in done.stderr


def test_a_map_that_is_not_there_is_not_written_down(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    done = CliRunner().invoke(cli, ["init", str(path), "--map", "home.yaml"])
    assert done.exit_code == 2
    assert "home.yaml is not there" in done.stderr
    assert not path.exists()


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["stauts"], "status"),
        (["calibrat"], "calibrate"),
        (["tour", "impor"], "import"),
        (["tour", "strat"], "start"),
    ],
)
def test_a_mistyped_command_brings_the_nearest(words: list[str], meant: str) -> None:
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2
    assert f"Did you mean '{meant}'" in done.stderr


def test_what_was_made_is_told_to_programs_too(runner: CliRunner, tmp_path: Path) -> None:
    def told(*words: str) -> dict[str, object]:
        done = runner.invoke(cli, [*words, "--json"])
        assert done.exit_code == 0, done.output
        return msgspec.json.decode(done.stdout)

    path, folder = tmp_path / "robot.toml", tmp_path / "keys"
    assert told("init", str(path)) == {"file": str(path)}
    keys = ("keys", "--folder", str(folder))
    assert told(*keys, "init")["role"] == "ca"
    made = told(*keys, "router", "home.local")
    assert (made["role"], made["hosts"]) == ("router", ["home.local"])
    assert Path(str(made["folder"])).is_dir()
    assert told(*keys, "robot", "kiwi")["name"] == "kiwi"
    assert told(*keys, "remove", "robot", "kiwi")["routers"] == ["home"]
    params = tmp_path / "nav2.yaml"
    params.write_text("controller_server:\n ros__parameters:\n  FollowPath:\n   vx_max: 0.3\n")
    taken = told("import", "nav2", str(params), "-o", str(tmp_path / "other.toml"))
    assert taken["taken"] == [{"what": "speed 0.3 m/s", "from": "nav2.yaml:4"}]


@pytest.mark.parametrize("command", [["up"], ["run", "base"], ["router"]])
def test_what_starts_a_robot_says_where_its_name_and_router_stand(
    runner: CliRunner, command: list[str]
) -> None:
    for given, key in (("--robot", "[robot] name"), ("--connect", "[zenoh] connect")):
        value = "kiwi" if given == "--robot" else "tcp/127.0.0.1:7599"
        result = runner.invoke(cli, [given, value, *command])
        assert result.exit_code == 2
        assert given in result.output
        assert key in result.output


PATHS = [path for path, _ in walk(cli)]
GROUPS = [path for path in PATHS if any(other[:-1] == path for other in PATHS if other)]


@pytest.mark.parametrize("path", GROUPS, ids=" ".join)
def test_the_help_of_a_group_has_each_command_once_and_cuts_no_sentence(
    path: tuple[str, ...],
) -> None:
    text = CliRunner().invoke(cli, [*path, "--help"], terminal_width=80).output
    listed = re.findall(r"^  ([a-z][a-z0-9-]*)  ", text, re.MULTILINE)
    below = [other[-1] for other in PATHS if other and other[:-1] == path]
    assert sorted(listed) == sorted(below)
    assert "..." not in text.partition("Options:")[2]
    assert max(map(len, text.splitlines())) <= 88  # the table of exit codes


def test_a_file_in_a_folder_that_is_not_there_names_the_folder(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["init", str(tmp_path / "away" / "robot.toml")])
    assert result.exit_code == 2
    assert f"there is no folder {tmp_path / 'away'}" in result.output + str(result.exception)


def test_commands_of_other_packages_come_in_the_same_order_on_each_computer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entries = [EntryPoint(name, "a:b", PLUGINS) for name in ("setup", "ros2", "mcp")]
    orders: list[list[str]] = []
    for found in (entries, entries[::-1]):
        monkeypatch.setattr("trolley.cli.entry_points", lambda group, found=found: found)
        orders.append(list(plugins()))
    assert orders == [["mcp", "ros2", "setup"]] * 2
