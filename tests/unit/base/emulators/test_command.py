"""What `trolley emulate` says of arguments that cannot be."""

import pytest
from click.testing import CliRunner

from trolley_base.commands.emulate import emulate_command

MISTAKES: dict[tuple[str, ...], str] = {
    ("ld20",): "there is no device 'ld20'; there are linorobot",
    ("ld19", "--fault", "ld19:x"): "there is no fault x, only silence",
    ("ld19", "--world", "nowhere"): "there is no file nowhere.toml",
    ("ld19", "--start", "0,0"): "X,Y,YAW",
    ("ld19", "--start", "90,0,0"): "lies outside of the map",
    ("ld19", "--connect", "tcp/127.0.0.1:1"): "--connect needs --robot NAME",
    (): "Missing argument",
}


@pytest.mark.parametrize("arguments", MISTAKES, ids=" ".join)
def test_mistakes_are_named(arguments: tuple[str, ...]) -> None:
    done = CliRunner().invoke(emulate_command, arguments)
    assert done.exit_code == 2, done.output
    assert MISTAKES[arguments] in done.output
