"""Links that let others in: in the page, in the terminal, and to nobody else."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import msgspec
import pytest
import segno
from click.testing import CliRunner, Result
from support.pages import PageOf, page_of

from trolley.config import VizConfig
from trolley_viz import commands
from trolley_viz.features.people.links import SHOWN_NS
from trolley_viz.features.touch.touched import Touched
from trolley_viz.server.access import AccessTokens
from trolley_viz.server.links import OUT_OF_REACH, links_of
from trolley_viz.server.messages import Press, Said
from trolley_viz.server.qr import QUIET, qr_image, qr_lines
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Stage

TOKENS = AccessTokens(operator="drives-0123456789", viewer="looks-0123456789")
LINK = "http://trolley-pi:8080/?token=q4iAV-h77tOD"
ROBOT = '[robot]\nname = "lime"\nfootprint = { length_m = 0.4, width_m = 0.4 }\n'
OWNER, GUEST = Visitor("a" * 16), Visitor("c" * 16, "viewer")


# The codes.
@pytest.mark.parametrize("text", ["http://a/", LINK, "https://robot.example/?token=" + "x" * 200])
def test_blocks_are_the_code_with_its_quiet_zone(text: str) -> None:
    modules = {" ": (0, 0), "▄": (0, 1), "▀": (1, 0), "█": (1, 1)}
    drawn: list[list[int]] = []
    for line in qr_lines(text):
        pairs = [modules[letter] for letter in line]
        drawn += [[upper for upper, _ in pairs], [lower for _, lower in pairs]]
    code = segno.make(text, error="l", micro=False)
    wanted = [[*map(int, row)] for row in code.matrix_iter(border=QUIET)]
    assert drawn[: len(wanted)] == wanted
    assert not any(map(any, drawn[len(wanted) :]))
    assert not any(map(any, drawn[:QUIET]))


def test_the_image_scales_and_is_dark_on_light() -> None:
    head, _, svg = qr_image(LINK).partition(",")
    assert head == "data:image/svg+xml;charset=utf-8"
    svg = unquote(svg)
    assert "viewBox" in svg
    assert "#fff" in svg
    assert "<script" not in svg


# Where they lead.
@pytest.mark.parametrize(
    ("viz", "page", "is_reachable"),
    [
        (VizConfig(host="192.168.1.7"), "http://192.168.1.7:8080", True),
        (VizConfig(host="fd00::7", port=81), "http://[fd00::7]:81", True),
        (VizConfig(host="0.0.0.0"), "http://pi:8080", True),
        (VizConfig(host="::"), "http://pi:8080", True),
        (VizConfig(origins=["https://a.example", "https://b"]), "https://a.example", True),
        (VizConfig(), "http://127.0.0.1:8080", False),
        (VizConfig(host="localhost"), "http://localhost:8080", False),
        (VizConfig(host="::1"), "http://[::1]:8080", False),
    ],
)
def test_links_lead_to_where_others_reach_the_viewer(
    viz: VizConfig, page: str, *, is_reachable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "pi")
    links = links_of(viz, TOKENS)
    assert links.operator == f"{page}/?token={TOKENS.operator}"
    assert links.viewer == f"{page}/?token={TOKENS.viewer}"
    assert links.is_reachable == is_reachable
    assert TOKENS.operator not in repr(links)
    assert TOKENS.viewer not in repr(links)


# In the page.
def letting_in(stage: "Stage", host: str = "192.168.1.7", client_id: int = 0) -> PageOf:
    """The folder, on a page of a viewer that listens somewhere else than it does in a test."""
    links = links_of(VizConfig(host=host), TOKENS)
    stage.viz.pages.hub = replace(stage.hub, links=links)
    stage.browse(client_id, OWNER)
    return page_of(stage, client_id).within("Let somebody in")


@pytest.mark.parametrize(
    ("what", "token", "other"),
    [
        ("To drive", TOKENS.operator, TOKENS.viewer),
        ("To look and stop", TOKENS.viewer, TOKENS.operator),
    ],
)
def test_an_operator_sees_the_link_that_was_asked_for(
    stage: "Stage", what: str, token: str, other: str
) -> None:
    folder, page = letting_in(stage), page_of(stage)
    assert not page.is_shown("Link to copy")
    folder.press(what)
    card = page.within(what)
    link = f"http://192.168.1.7:8080/?token={token}"
    assert card.value("Link to copy") == link
    assert "password" in card.text()
    assert card.html().count("<img") == 1
    assert other not in page.html() + card.value("Link to copy")


def close_card(stage: "Stage", title: str) -> None:
    """Press the cross of a card."""
    controls = stage.page().controls
    (card,) = [id_ for id_, one in controls.all.items() if one.look.label == title]
    controls.handle(card, None)


@pytest.mark.parametrize("how", ["closed", "forgotten", "touched the map"])
def test_a_link_does_not_stay_on_the_page(stage: "Stage", how: str) -> None:
    folder, page = letting_in(stage), page_of(stage)
    folder.press("To drive")
    if how == "closed":
        close_card(stage, "To drive")
    elif how == "forgotten":
        stage.runtime.run(SHOWN_NS * 1e-9 - 1.0)
        assert page.is_shown("Link to copy")
        stage.runtime.run(2.0)
    else:
        stage.session.touching.touch(Touched("floor", "", 0.0, 0.0))
        stage.runtime.run(0.5)
        assert page.is_shown("Save place")
    assert not page.is_shown("Link to copy")
    looks = [one.look for one in stage.page().controls.all.values()]
    assert TOKENS.operator.encode() not in msgspec.json.encode(looks)
    folder.press("To look and stop")
    stage.runtime.run(60.0)
    assert page.is_shown("Link to copy")
    assert not page.is_shown("Save place")


def test_where_nobody_else_gets_to_no_code_is_shown(stage: "Stage") -> None:
    stage.browse(0, OWNER)
    folder = page_of(stage).within("Let somebody in")
    assert OUT_OF_REACH in folder.text()
    assert folder.labels == []


def test_who_may_only_look_is_never_told_a_token(stage: "Stage") -> None:
    letting_in(stage)
    tokens = [TOKENS, stage.viz._tokens()]
    guest = stage.browse(1, GUEST)
    page_of(stage).within("Let somebody in").press("To drive")
    stage.runtime.run(1.0)
    for control in {*stage.page(0).controls.all, *stage.page(1).controls.all}:
        for value in (None, "To drive", "To look and stop", True):
            press = Press(id=1, at_ms=stage.now_ms, control=control, value=value)
            stage.say(guest, Said(press=press))
    stage.runtime.run(1.0)
    assert not page_of(stage, 1).is_shown("Let somebody in")
    told = msgspec.json.encode(guest.line.told).decode()
    assert "token" not in told
    assert not any(one in told for pair in tokens for one in (pair.operator, pair.viewer))


# In the terminal.
@pytest.fixture
def robot_toml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings of a viewer that others reach, and its tokens."""
    monkeypatch.setattr(commands, "state_root", lambda _: tmp_path)
    (tmp_path / "lime").mkdir()
    tokens = f'schema = 1\noperator = "{TOKENS.operator}"\nviewer = "{TOKENS.viewer}"\n'
    (tmp_path / "lime" / "viewer_access.toml").write_text(tokens)
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT + '[viz]\nhost = "192.168.1.7"\n')
    return path


def run(robot_toml: Path, *arguments: str, charset: str = "utf-8") -> Result:
    runner = CliRunner(charset=charset)
    return runner.invoke(commands.viewer_link, ["--config", str(robot_toml), *arguments])


def test_links_are_printed(robot_toml: Path) -> None:
    result = run(robot_toml)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        f"To drive:         http://192.168.1.7:8080/?token={TOKENS.operator}",
        f"To look and stop: http://192.168.1.7:8080/?token={TOKENS.viewer}",
    ]
    found = json.loads(run(robot_toml, "--json").stdout)
    assert found["viewer"] == f"http://192.168.1.7:8080/?token={TOKENS.viewer}"


def test_codes_are_printed_below_their_links(robot_toml: Path) -> None:
    result = run(robot_toml, "--qr")
    assert result.exit_code == 0, result.output
    link = f"http://192.168.1.7:8080/?token={TOKENS.operator}"
    lines = result.stdout.splitlines()
    assert lines[0].endswith(link)
    assert lines[1 : 1 + len(qr_lines(link))] == qr_lines(link)
    assert len(lines) == 2 + 2 * len(qr_lines(link))


def test_on_a_terminal_codes_have_colours_of_their_own(robot_toml: Path) -> None:
    result = CliRunner().invoke(
        commands.viewer_link, ["--config", str(robot_toml), "--qr"], color=True
    )
    codes = [line for line in result.stdout.splitlines() if "token" not in line]
    assert codes
    assert all(line.startswith("\x1b[30m\x1b[107m") for line in codes)
    assert all(line.endswith("\x1b[0m") for line in codes)


@pytest.mark.parametrize("charset", ["ascii", "latin-1"])
def test_without_the_letters_for_it_there_is_no_code(robot_toml: Path, charset: str) -> None:
    result = run(robot_toml, "--qr", charset=charset)
    assert result.exit_code == 0
    assert "No QR code can be shown here: the output is not UTF-8." in result.stderr
    assert result.stdout == run(robot_toml).stdout


def test_a_narrow_terminal_shows_no_code(robot_toml: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setattr(commands, "is_terminal", lambda: True)
    result = run(robot_toml, "--qr")
    assert "needs a terminal of" in result.stderr
    assert result.stdout == run(robot_toml).stdout


@pytest.mark.parametrize("options", [(), ("--qr",)])
def test_where_nobody_else_gets_to_that_is_said_without_a_code(
    robot_toml: Path, options: tuple[str, ...]
) -> None:
    robot_toml.write_text(ROBOT)
    result = run(robot_toml, *options)
    assert result.stderr.strip() == OUT_OF_REACH
    assert "▀" not in result.stdout


def test_programs_get_no_codes(robot_toml: Path) -> None:
    result = run(robot_toml, "--qr", "--json")
    assert result.exit_code == 2
    assert "exclude each other" in result.stderr
