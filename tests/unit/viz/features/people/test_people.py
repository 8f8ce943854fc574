"""What browsers are called, who is there, who sent the robot, and who stopped it."""

import tomllib
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given as drawn
from hypothesis import strategies as st
from support.pages import PageOf, page_of

from trolley import topics
from trolley.messages import BaseState, GoalStatus, TourStatus
from trolley_viz.features.people.names import MAX_NAME, MAX_NAMES, NO_COOKIE, Names, clean
from trolley_viz.features.people.senders import MAX_SENT, Senders
from trolley_viz.features.people.stoppers import Stoppers
from trolley_viz.joystick.joystick import Grip
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.server.devices import A_BROWSER, DEVICE_NAMES, HERE, MAX_AGENT, device_name
from trolley_viz.server.lines import MAX_LINES
from trolley_viz.server.messages import Resume, Said, Stop
from trolley_viz.server.visitors import NOBODY, Visitor
from trolley_viz.service import VizService

if TYPE_CHECKING:
    from ...conftest import Stage

ANN = Visitor("a" * 16, device="Chrome on Android")
BEN = Visitor("b" * 16, device="Firefox on Windows")
GUEST = Visitor("c" * 16, "viewer", device="Safari on iPhone")
PHONE = "Anna's phone"


# What a browser is.
@pytest.mark.parametrize(
    ("agent", "name"),
    [
        (
            "Mozilla/5.0 (Linux; Android 10; K) AppleWebKit/537.36 (KHTML, like Gecko) "
            "Chrome/131.0.0.0 Mobile Safari/537.36",
            "Chrome on Android",
        ),
        (
            "Mozilla/5.0 (Windows NT 10.0; Win64; x64; rv:133.0) Gecko/20100101 Firefox/133.0",
            "Firefox on Windows",
        ),
        (
            "Mozilla/5.0 (iPhone; CPU iPhone OS 17_6 like Mac OS X) AppleWebKit/605.1.15 "
            "(KHTML, like Gecko) Version/17.6 Mobile/15E148 Safari/604.1",
            "Safari on iPhone",
        ),
        (
            "Mozilla/5.0 (iPad; CPU OS 17_6 like Mac OS X) AppleWebKit/605.1.15 "
            "(KHTML, like Gecko) CriOS/131.0 Mobile/15E148 Safari/604.1",
            "Chrome on iPad",
        ),
        (
            "Mozilla/5.0 (Macintosh; Intel Mac OS X 10_15_7) AppleWebKit/605.1.15 "
            "(KHTML, like Gecko) Version/18.1 Safari/605.1.15",
            "Safari on Mac",
        ),
        (
            "Mozilla/5.0 (Windows NT 10.0; Win64; x64) AppleWebKit/537.36 (KHTML, like Gecko) "
            "Chrome/131.0.0.0 Safari/537.36 Edg/131.0.0.0",
            "Edge on Windows",
        ),
        (
            "Mozilla/5.0 (Linux; Android 13; SM-S901B) AppleWebKit/537.36 (KHTML, like Gecko) "
            "SamsungBrowser/27.0 Chrome/125.0.0.0 Mobile Safari/537.36",
            "Samsung Internet on Android",
        ),
        (
            "Mozilla/5.0 (X11; CrOS x86_64 14541.0.0) Chrome/131.0 Safari/537.36",
            "Chrome on ChromeOS",
        ),
        ("Mozilla/5.0 (X11; Linux x86_64; rv:133.0) Firefox/133.0", "Firefox on Linux"),
        ("curl/8.5.0", A_BROWSER),
        ("", A_BROWSER),
        ("Windows", "a browser on Windows"),
        ("Firefox/1", "Firefox"),
        ("x" * MAX_AGENT + "Chrome/1 Android", A_BROWSER),
    ],
)
def test_a_browser_without_a_name_is_called_by_what_it_is(agent: str, name: str) -> None:
    assert device_name(agent) == name


@drawn(st.text())
def test_no_header_makes_up_a_name_of_its_own(agent: str) -> None:
    assert device_name(agent) in DEVICE_NAMES


# Names.
def names_of(
    *,
    robots: tuple[str, ...] = (),
    saved: list[Any] | None = None,
    given: dict[str, str] | None = None,
) -> Names:
    saves = [] if saved is None else saved
    return Names(given or {}, saves.append, lambda: robots)


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        (PHONE, PHONE),
        ("  Anna's \t phone\n", PHONE),
        ("Кухня 🤖 台所", "Кухня 🤖 台所"),
        ("هاتف آنا", "هاتف آنا"),
        ("<b>Ann</b>&amp;", "<b>Ann</b>&amp;"),
        ("Ann\u202ednab", "Ann dnab"),
        ("\x1b[2JAnn\x07", "[2JAnn"),
        ("A\u0308", "\u00c4"),
        ("", ""),
        (" \t\u3000 ", ""),
        ("\u3164\u2800", ""),
        ("\u0301\ufe0f", ""),
        ("\u200b\u2060\u202e\x00\ud800", ""),
    ],
)
def test_a_name_is_one_line_that_can_be_seen(typed: str, name: str) -> None:
    assert clean(typed) == name


@drawn(st.text(max_size=300))
def test_whatever_is_typed_a_name_is_printable_and_stays_as_it_is(typed: str) -> None:
    name = clean(typed)
    assert name.isprintable()
    assert clean(name) == name


@pytest.mark.parametrize(
    "typed",
    [
        "x" * (MAX_NAME + 1),
        "x" * 10**6,
        "🤖" * 10**6,
        " a" * 10**6,
        HERE,
        "Chrome on Android",
        "chrome  ON android",
        "Trolley",
        "\uff34\uff32\uff2f\uff2c\uff2c\uff25\uff39",
        "Ben",
        " bEN\u202e ",
    ],
)
def test_a_name_that_is_too_long_or_somebody_elses_is_refused(typed: str) -> None:
    saved: list[Any] = []
    names = names_of(robots=("trolley",), saved=saved, given={BEN.browser: "Ben"})
    assert names.give(ANN, typed).endswith(".")
    assert (names.of(ANN), names.of(BEN), saved) == ("Chrome on Android", "Ben", [])


def test_a_name_can_be_changed_and_taken_away_and_is_free_then() -> None:
    saved: list[Any] = []
    names = names_of(saved=saved)
    for name in ("x" * MAX_NAME, PHONE, PHONE):
        assert names.give(ANN, name) == ""
        assert names.of(ANN) == name
    assert names.give(BEN, PHONE.upper()) != ""
    assert names.give(ANN, " ") == ""
    assert names.of(ANN) == "Chrome on Android"
    assert names.give(BEN, PHONE) == ""
    assert saved[-1] == {BEN.browser: PHONE}


def test_a_browser_without_cookies_has_no_name() -> None:
    saved: list[Any] = []
    names = names_of(saved=saved)
    assert names.give(Visitor("", device="Firefox on Linux"), PHONE) == NO_COOKIE
    assert (names.of(NOBODY), saved) == (A_BROWSER, [])


def test_only_so_many_names_are_kept() -> None:
    saved: list[Any] = []
    names = names_of(saved=saved)
    for i in range(MAX_NAMES + 5):
        assert names.give(Visitor(f"{i:016}"), f"name {i}") == ""
    assert len(saved[-1]) == MAX_NAMES
    assert names.given(Visitor(f"{4:016}")) == ""
    assert names.given(Visitor(f"{MAX_NAMES + 4:016}")) != ""


def test_names_that_somebody_wrote_into_the_file_are_cleaned() -> None:
    names = names_of(given={ANN.browser: "A\u202enn" + "x" * 10**5, BEN.browser: "\x00"})
    assert names.of(ANN) == ("A nn" + "x" * 50)[:MAX_NAME]
    assert names.of(BEN) == "Firefox on Windows"


# Senders and stoppers.
def test_only_the_newest_senders_are_kept() -> None:
    senders = Senders()
    for i in range(MAX_SENT + 1):
        senders.note("trolley", f"g{i}", "Ann")
    assert senders.of("trolley", "g0") == ""
    assert senders.of("trolley", f"g{MAX_SENT}") == "Ann"
    assert senders.of("kart", f"g{MAX_SENT}") == ""
    assert senders.of("trolley", None) == ""


def base(mode: Any, stamp_ns: int) -> BaseState:
    return BaseState(stamp_ns=stamp_ns, mode=mode)


def test_who_pressed_first_has_stopped_it_until_it_may_drive_again() -> None:
    stoppers = Stoppers()
    stoppers.press("r", "Ann", base("ok", 1))
    stoppers.press("r", "Ben", base("ok", 1))
    assert stoppers.of("r", base("ok", 2)) == ""
    stoppers.answered("r", 10)
    assert stoppers.of("r", base("ok", 9)) == ""  # on its way when it answered
    assert stoppers.of("r", base("stopped", 10)) == "Ann"
    stoppers.press("r", "Ben", base("stopped", 11))
    stoppers.answered("r", 12)
    assert stoppers.of("r", base("stopped", 13)) == "Ann"
    assert stoppers.of("r", base("ok", 5)) == ""  # after a restart the time begins anew
    assert stoppers.of("r", base("stopped", 6)) == ""


def test_who_stopped_a_robot_is_forgotten_when_it_drove_since() -> None:
    stoppers = Stoppers()
    stoppers.press("r", "Ann", base("ok", 1))
    stoppers.answered("r", 10)
    assert stoppers.of("r", base("ok", 11)) == ""
    assert stoppers.of("r", base("stopped", 12)) == ""


@pytest.mark.parametrize("before", [None, base("stopped", 1)])
def test_nobody_has_stopped_what_stood_already(before: BaseState | None) -> None:
    stoppers = Stoppers()
    stoppers.press("r", "Ann", before)
    stoppers.answered("r", 10)
    assert stoppers.of("r", base("stopped", 11)) == ""


# The whole viewer.
def call(stage: "Stage", client_id: int, name: str) -> PageOf:
    """Give a browser a name at its page, and return the folder."""
    page = page_of(stage, client_id).within("People")
    page.type("Name of this browser", name)
    page.press("Use this name")
    return page


def test_a_name_is_given_at_the_page_seen_by_all_and_kept(stage: "Stage") -> None:
    ann, _ = stage.browse(0, ANN), stage.browse(1, BEN)
    page = call(stage, 0, f" {PHONE} ")
    assert page.value("Name of this browser") == PHONE
    assert ann.notices[-1][0] == "Saved"
    stage.runtime.run(1.5)
    assert f"{PHONE} Drives." in page_of(stage, 1).within("People").text()
    stored = tomllib.loads((stage.viz.state.path / "viewer.toml").read_text())
    assert stored["names"] == {ANN.browser: PHONE}
    stage.runtime.kill("viz")
    stage.viz.stop()
    stage.viz = stage.runtime.add(VizService(stage.config))
    stage.browse(2, ANN)
    stage.runtime.run(1.5)
    assert page_of(stage, 2).within("People").value("Name of this browser") == PHONE
    assert PHONE in page_of(stage, 2).within("People").text()


def test_two_pages_of_a_browser_do_not_take_its_name_away(stage: "Stage") -> None:
    stage.browse(0, ANN)
    stage.browse(1, ANN)
    call(stage, 0, PHONE)
    stage.page(1).session.preferences.switch_layer("costmap", is_on=True)
    assert stage.hub.people.names.of(ANN) == PHONE
    stored = tomllib.loads((stage.viz.state.path / "viewer.toml").read_text())
    assert stored["names"] == {ANN.browser: PHONE}
    assert stored["browsers"][ANN.browser]["layers"] == {"costmap": True}


def test_the_second_to_take_a_name_is_told(stage: "Stage") -> None:
    stage.browse(0, ANN)
    ben = stage.browse(1, BEN)
    call(stage, 0, PHONE)
    call(stage, 1, PHONE)
    assert ben.notices == [("Not saved", "Another browser has this name. Choose another name.")]
    call(stage, 1, "Trolley")
    assert ben.notices[-1][1] == "This is the name of a robot. Choose another name."
    assert stage.hub.people.names.of(BEN) == "Firefox on Windows"


def test_a_name_with_markup_is_shown_as_it_was_typed(stage: "Stage") -> None:
    stage.browse(0, ANN)
    call(stage, 0, "<img src=x onerror=alert(1)>")
    stage.runtime.run(1.5)
    people = page_of(stage).within("People")
    assert "<img" not in people.html()
    assert "<img src=x onerror=alert(1)>" in people.text()


def test_the_page_shows_who_is_there_and_how(stage: "Stage") -> None:
    stage.browse(0, ANN)
    stage.runtime.run(60.0)
    guest = stage.browse(1, GUEST)
    stage.browse(2)
    stage.page(1).session.follow("kart")
    stage.runtime.run(1.5)
    said = page_of(stage).within("People").text()
    assert "Chrome on Android This page. Drives. Open for 1 min. Follows Trolley." in said
    assert "Safari on iPhone Looks only. Just opened. Follows kart." in said
    assert "a browser Drives." in said
    theirs = page_of(stage, 1).within("People").text()
    assert theirs.startswith("Safari on iPhone This page.")
    stage.runtime.run(60.0)
    assert "Looks only. Open for 1 min." in page_of(stage).within("People").text()
    nobody = page_of(stage, 2).within("People")
    assert NO_COOKIE in nobody.text()
    assert not nobody.is_shown("Name of this browser")
    stage.leave(guest)
    stage.runtime.run(1.5)
    assert "iPhone" not in page_of(stage).within("People").text()


def test_nobody_hears_by_what_the_viewer_knows_another_browser(stage: "Stage") -> None:
    stage.browse(0, ANN)
    guest = stage.browse(1, GUEST)
    call(stage, 0, PHONE)
    stage.runtime.run(2.0)
    assert ANN.browser.encode() not in msgspec.json.encode(guest.line.told)


def test_of_a_hundred_pages_some_are_listed_and_the_own_one_is_first(stage: "Stage") -> None:
    for i in range(MAX_LINES):
        stage.connect(i, Visitor(f"{i:016}", device="Chrome on Android"))
    stage.runtime.run(0.5)
    last = page_of(stage, MAX_LINES - 1).within("People").text()
    assert last.startswith("Chrome on Android This page.")
    assert last.endswith("and 70 more")


def send(stage: "Stage", client_id: int = 0) -> None:
    stage.page(client_id).session.aiming._go_to(Pointed(2.0, 1.0))
    stage.runtime.run(0.5)


def heads(browser: Any) -> list[str]:
    return [line.headline for line in browser.state.lines]


def test_all_see_who_sent_the_robot_while_it_is_on_its_way(stage: "Stage") -> None:
    browsers = [stage.browse(0, ANN), stage.browse(1, GUEST)]
    call(stage, 0, PHONE)
    send(stage)
    for browser in browsers:
        assert f"Sent by {PHONE}" in heads(browser)
    call(stage, 0, "Another")
    stage.runtime.run(0.5)
    assert f"Sent by {PHONE}" in heads(browsers[0])  # it was called so then
    done = GoalStatus(stamp_ns=10**9, id=stage.robot.goals[0].id, state="arrived")
    stage.robot.publish(topics.GOAL, done)
    stage.runtime.run(0.5)
    assert not any("Sent by" in head for head in heads(browsers[1]))


def test_of_what_another_program_sent_nothing_is_said(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    for goal_id in ("theirs", None):
        status = GoalStatus(stamp_ns=10**9, id=goal_id, state="driving")
        stage.robot.publish(topics.GOAL, status)
        stage.runtime.run(0.5)
        assert not any("Sent by" in head for head in heads(browser))


def test_who_takes_a_goal_back_has_sent_the_next(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    stage.browse(1, BEN)
    send(stage)
    send(stage, 1)
    assert "Sent by Firefox on Windows" in heads(browser)
    stage.page(1).session.actions.history.undo()
    stage.runtime.run(0.5)
    assert len(stage.robot.goals) == 3
    assert "Sent by Firefox on Windows" in heads(browser)


def test_of_two_who_press_go_at_once_both_see_where_it_goes_and_who_sent_it(
    stage: "Stage",
) -> None:
    browsers = [stage.browse(0, ANN), stage.browse(1, BEN)]
    stage.page(0).session.aiming._go_to(Pointed(2.0, 1.0))
    stage.page(1).session.aiming._go_to(Pointed(1.0, -1.0))
    stage.runtime.run(0.5)
    assert len(stage.robot.goals) == 2
    for browser in browsers:
        assert "Driving to the place on the map" in heads(browser)
        assert "Sent by Firefox on Windows" in heads(browser)
    # Only whose goal it is can take it back.
    offers = [page_of(stage, i).is_shown("Undo: Go to a place on the map") for i in (0, 1)]
    assert offers == [False, True]


def test_all_see_who_began_the_trip(stage: "Stage") -> None:
    browsers = [stage.browse(0, ANN), stage.browse(1, BEN)]
    stage.page(1).session.actions.start_tour("round")
    stage.runtime.run(0.5)
    trip = TourStatus(stamp_ns=1, name="round", trip="t1", state="driving")
    stage.robot.publish(topics.TOUR, trip)
    goal = GoalStatus(stamp_ns=10**9, id="tour-t1-0-1", state="driving")
    stage.robot.publish(topics.GOAL, goal)
    stage.runtime.run(0.5)
    for browser in browsers:
        assert "Sent by Firefox on Windows" in heads(browser)
    stage.robot.publish(topics.TOUR, msgspec.structs.replace(trip, trip="t2"))
    stage.runtime.run(0.5)
    assert not any("Sent by" in head for head in heads(browsers[0]))


def test_all_see_who_stopped_the_robot_until_it_is_resumed(stage: "Stage") -> None:
    guest, ann = stage.browse(0, GUEST), stage.browse(1, ANN)
    call(stage, 0, "Ben's tablet")
    stage.say(guest, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.say(ann, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert [one.state.stopped_by for one in (guest, ann)] == ["Stopped by Ben's tablet"] * 2
    stage.say(ann, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    stage.runtime.run(0.5)
    assert ann.state.stopped_by == ""
    stage.robot.mode = "stopped"  # by a button or a command
    stage.runtime.run(0.5)
    assert ann.state.is_stopped
    assert ann.state.stopped_by == ""


def test_the_computer_of_the_viewer_is_named_in_plain_words(stage: "Stage") -> None:
    here, ann = stage.browse(0, Visitor("d" * 16, device=HERE)), stage.browse(1, ANN)
    send(stage)
    assert "Sent from this computer" in heads(here)
    assert "Sent from the computer that runs this page" in heads(ann)
    stage.say(here, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert here.state.stopped_by == "Stopped from this computer"
    assert ann.state.stopped_by == "Stopped from the computer that runs this page"


def test_who_stopped_it_is_not_said_of_a_stop_that_nobody_here_saw(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    stage.session.press_stop()
    stage.runtime.run(0.5)
    assert browser.state.stopped_by == "Stopped by Chrome on Android"
    stage.leave(browser)
    stage.runtime.run(31.0)
    again = stage.browse(1, BEN)
    assert again.state.is_stopped
    assert again.state.stopped_by == ""


def test_stop_for_all_robots_names_who_pressed_it(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    stage.session.press_stop_all()
    stage.runtime.run(0.5)
    assert browser.state.stopped_by == "Stopped by Chrome on Android"


def test_a_stop_without_an_answer_has_stopped_nothing(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    stage.robot.deaf = True
    stage.session.press_stop()
    stage.runtime.run(2.0)
    assert browser.state.stopped_by == ""
    assert browser.state.stop is not None


def test_who_does_not_hold_the_joystick_is_told_who_does(stage: "Stage") -> None:
    ann, ben = stage.browse(0, ANN), stage.browse(1, BEN)
    call(stage, 0, PHONE)
    grip = Grip(x=0.0, y=1.0, held=True, speed=0.2, sent_ms=stage.now_ms)
    stage.say(ann, Said(grip=grip))
    stage.runtime.run(0.25)
    assert not ben.pad.can
    assert ben.pad.text == f"Driven by {PHONE}. Let go, and press again when they are done."
    assert PHONE not in ann.pad.text
