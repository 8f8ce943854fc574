"""The page in other languages: nothing is left out, and nobody's names are translated."""

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import product
from typing import TYPE_CHECKING, Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalStatus,
    MappingStatus,
    PoseEstimate,
    SavedPose,
    Stop,
    StopResult,
    Tour,
    TourStatus,
)
from trolley.names import name_problem
from trolley_viz.controls.markup import card, details, numbered, row, table
from trolley_viz.controls.messages import ControlChanges, Look
from trolley_viz.features.tours.trip import progress
from trolley_viz.languages.catalogue import Catalogue, catalogues, known_language
from trolley_viz.languages.translator import PLACEHOLDER, Pattern, Translator, translator_of
from trolley_viz.overlays.cards import Card
from trolley_viz.overlays.pages import OverlayUpdate
from trolley_viz.pages.known import state_lines
from trolley_viz.pages.language import in_language
from trolley_viz.robots.situation import RobotState, situation
from trolley_viz.server.messages import Press, Said, Told
from trolley_viz.server.visitors import Visitor
from trolley_viz.server.web_server import PAGE
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import StatusLine, goal_line, mapping_line, result_line

if TYPE_CHECKING:
    from ..conftest import Browser, Stage

ANN = Visitor("ann")
LANGUAGES = tuple(catalogues())
KITCHEN = SavedPose(name="kitchen", map="room", pose=Pose2D(2.0, 1.0, 0.0))
TOUR = Tour(
    name="round",
    stops=[Stop(name="hall"), Stop(name="kitchen"), Stop(pose=Pose2D(0.0, 0.0, 0.0))],
    repeat=3,
)
REASONS = ("", *codes.SENTENCES)


def translator(code: str) -> Translator:
    found = translator_of(code)
    assert found is not None
    return found


def values_of(message: type, field: str) -> tuple[Any, ...]:
    return get_args(message.__annotations__[field])


# Nothing is left out.
def every_state() -> Iterator[RobotState]:
    """Robots in every state that there is, for every reason."""
    at: dict[str, Any] = {
        "stamp_ns": 1,
        "map": "room",
        "pose": Pose2D(1.0, 2.0, 0.0),
        "match": 0.9,
        "spread": 0.1,
    }
    there = PoseEstimate(**at, covariance=None, state="localized")
    known: dict[str, Any] = {
        "estimate": there,
        "estimate_age_s": 0.1,
        "places": [KITCHEN],
        "tour": TOUR,
    }
    idle = GoalStatus(stamp_ns=1, id=None, state="idle")
    far: dict[str, Any] = {"distance_remaining": 3.2, "eta": 75.0}
    near: dict[str, Any] = {"distance_remaining": 0.05, "eta": 0.9}
    for state, turns in product(values_of(PoseEstimate, "state"), (False, True)):
        one = PoseEstimate(
            **at,
            covariance=[0.01] * 9,
            state=state,
            wants_turn=turns,
            candidates=[there] * 2,  # type: ignore[list-item]
        )
        yield RobotState(**known | {"estimate": one, "goal": idle})
    for mode, reason, source in product(values_of(BaseState, "mode"), REASONS, (None, "teleop")):
        base = BaseState(stamp_ns=1, mode=mode, reason=reason, source=source)
        yield RobotState(**known, base=base, goal=idle)
        yield RobotState(**known, base=base, goal=GoalStatus(stamp_ns=1, id="a", state="driving"))
    person: dict[str, Any] = {"person": (3.0, 1.0)}
    for state, reason, pose, more in product(
        values_of(GoalStatus, "state"),
        REASONS,
        (None, KITCHEN.pose, Pose2D(9.0, 9.0, 0.0)),
        ({}, far, near, person),
    ):
        goal = GoalStatus(stamp_ns=1, id="a", state=state, reason=reason, pose=pose, **more)
        yield RobotState(**known, goal=goal)
        if not reason:
            yield RobotState(**known, goal=idle, lost_goal=goal)
    for state, reason, stop, name in product(
        values_of(TourStatus, "state"), REASONS, (None, 1, 2, 5), ("round", None)
    ):
        results = [StopResult(stop=0, state="reached"), StopResult(stop=1, state="failed")]
        trip = TourStatus(
            stamp_ns=1, name=name, trip="t", state=state, reason=reason, stop=stop, results=results
        )
        goal = GoalStatus(stamp_ns=1, id="tour-t-0-1", state="driving", pose=KITCHEN.pose, **far)
        yield RobotState(**known, goal=goal, trip=trip)
    for state in values_of(MappingStatus, "state"):
        mapping = MappingStatus(stamp_ns=1, state=state, name="home")
        yield RobotState(goal=idle, has_map=False, mapping=mapping)
    for scans, loops in ((1, 0), (14, 1), (14, 2)):
        mapping = MappingStatus(stamp_ns=1, state="mapping", name="home", scans=scans, loops=loops)
        yield RobotState(goal=idle, mapping=mapping)
    yield RobotState(is_away=True)
    yield RobotState()
    yield RobotState(goal=idle)
    yield RobotState(**known, goal=idle, room="the hall")
    old: dict[str, Any] = {**known, "estimate_age_s": 20.0}
    yield RobotState(**old, goal=idle)


def said_of(known: RobotState) -> Iterator[str]:
    """All that is said of a robot."""
    lines = [situation(known), *state_lines(known)]
    results = [] if known.trip is None else known.trip.results
    lines += [result_line(one) for one in results]
    lines += [line for line in [mapping_line(known.mapping)] if line is not None]
    for line in lines:
        yield from (line.headline, line.detail)


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_state_of_a_robot_can_be_said(code: str) -> None:
    said = {text for known in every_state() for text in said_of(known)}
    assert len(said) > 500
    words = translator(code)
    assert [text for text in sorted(said) if not words.knows(text)] == []


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_sentence_of_the_wire_can_be_said(code: str) -> None:
    words = translator(code)
    assert [one for one in codes.SENTENCES if not words.knows(said("", one))] == []


@pytest.mark.parametrize(
    "text",
    [
        "The file of its body is broken, so its outline is shown.",
        "Its body is 33 m long in the file; glb files are in metres.",
        "There are too many markers; the last ones are not drawn.",
        "3 markers are not drawn: there are too many of their kind, or they are too long.",
        "One marker is not drawn. Frames 'a' and 'map' are not connected: nothing is known of 'a' "
        "yet (missing: tf/a; known frames: map, odom).",
        "The RPLIDAR A1 sends, but its head does not turn. Is its head free to turn, and its 5 V "
        "supply strong enough?",
        "The lidar sees nothing behind, so it does not move there. It will continue by itself.",
        "Stop 2 (kitchen): not reached within 2 min; trying again in 10 s.",
        "Planner did not answer in time.",
        "The robot was stopped; once it may drive again, press “Continue”.",
        "The tour “dawn”, due on 2026-11-02 at 08:30, was skipped: another tour was paused.",
        "The tour “dawn”, due on 2026-11-02 at 08:30, was skipped: the robot was "
        "not on its map hall.",
        "The tour 'dawn' is on the map hall, the robot is on cellar.",
        "Merged cellar (3.1 m of its walls match, 88%): home is stored as version 3.",
        "The map home is saved and in use. Places were not moved along with the map: the tour "
        "service does not answer.",
        "The map home is saved and in use. Tours were not moved along with the map: the tour "
        "service does not answer.",
        "Explored: 84 m², all that [mapper] explore_area_m2 allows. It is back where it began.",
        "Explored: 84 m², all that [mapper] explore_area_m2 allows, 2 places could not be reached.",
        "Explored: 84 m², 1 place could not be reached, 1 small corner left out.",
        "Explored: 84 m², all that [mapper] explore_area_m2 allows, 2 small corners left out.",
        "Coordinates may be 1000000 m at most.",
        "The map 'home' of the last run is gone from /var/lib/trolley/maps: put it back or choose "
        "another, and load it (`trolley map load NAME`).",
        "It did not get on, although the map shows nothing in its way.",
        "The map hall is 400 x 300 m, too large to be drawn in cells of 0.05 m: crop it first, or "
        "set a larger [mapper] resolution_m.",
        "The map hall lies more than 10 km from where its coordinates are 0, too far to be "
        "extended exactly: give its file an `origin` near 0.",
        "The mapper is starting; try again in a moment.",
        "Nothing was heard of the robot's base for 12 s.",
        "The lidar repeats one and the same scan although the robot moves: it hangs; plug it in "
        "again.",
        "The lidar reports open floor all around, with hardly an echo: that is not believed. Does "
        "it look into the air, or is its window off? In a hall wider than its reach, creep by hand "
        "towards a wall.",
        "NOT STOPPED: the motor board does not obey: told to stand, it goes on at 0.20 m/s. Switch "
        "off the motors.",
        "The gyro turns the opposite way to the wheels: reverse two of [base.chassis] imu_axes "
        "([base.imu] axes), such as x and z, unless left and right are swapped. Its turn rate is "
        "not used.",
        "/dev/ttyUSB0: the connection was lost 5 times within 60 s: the device restarts, or its "
        "cable is loose. Check its supply and its cable; it is used again once it stays connected.",
        "/dev/ttyUSB0: The motor board does not publish raw_vel and does not subscribe to cmd_vel: "
        "it does not run linorobot's firmware. Flash linorobot's, or set [base.chassis] board to "
        "what it runs.",
        "/dev/ttyUSB1: The Delta-2A turns at 180 rpm, too slowly to measure. Its motor needs a "
        "controller outside the sensor: is it set to 360 rpm?",
    ],
)
def test_what_is_rarely_said_is_known_too(text: str) -> None:
    assert translator("de").knows(said(text))


class Texts(HTMLParser):
    """The texts of a piece of HTML, and those of its attributes that people see or hear."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        shown = {"aria-label", "title", "placeholder"}
        if tag == "meta" and ("name", "description") in attrs:
            shown = {"content"}
        self.found |= {value for name, value in attrs if name in shown and value}

    def handle_data(self, data: str) -> None:
        self.found |= {data.strip()} - {""}


def words_of_the_page() -> set[str]:
    """What the page says by itself."""
    scripts = [path.read_text(encoding="utf-8") for path in sorted(PAGE.glob("*.js"))]
    said = {text for script in scripts for text in re.findall(r'\bt\(\s*"([^"]+)"', script)}
    (joystick,) = re.findall(r"MARKUP = `(.*?)`", "".join(scripts), re.DOTALL)
    index = (PAGE / "index.html").read_text(encoding="utf-8")
    fixed = Texts(joystick).found | Texts(index).found
    return said | {text for text in fixed if re.search("[^\\W\\d]{2}", text)}


@pytest.mark.parametrize("code", LANGUAGES)
def test_the_page_has_all_words_of_its_own(code: str) -> None:
    keys = {"space", "escape", "enter", "backspace"}
    assert set(catalogues()[code].page) == (words_of_the_page() | keys) - {"Trolley", "STOP"}


# The catalogues.
def entries() -> Iterator[tuple[str, str, str]]:
    for code, catalogue in catalogues().items():
        for english, text in catalogue.all_texts().items():
            yield code, english, text


def test_what_stands_in_braces_stands_on_both_sides() -> None:
    def braces(text: str) -> list[str]:
        return sorted(re.findall(r"\{[^}]*\}", text))

    wrong = [english for _, english, text in entries() if braces(english) != braces(text)]
    assert wrong == []
    odd = [one for _, one, _ in entries() if re.search(r"[{}]", PLACEHOLDER.sub("", one))]
    assert odd == []


def test_no_pattern_fits_everything() -> None:
    """Each part of a text is shorter than the text, so that looking for parts comes to an end."""
    for _, english, text in entries():
        num = len(PLACEHOLDER.findall(english))
        if num:
            assert num <= 6, english
            assert Pattern(english, text).own_characters + num > 2, english


def test_a_text_is_in_one_table_only() -> None:
    for catalogue in catalogues().values():
        tables = [catalogue.page, *catalogue.texts.values()]
        assert sum(map(len, tables)) == len(catalogue.all_texts())


def test_another_language_is_one_more_file() -> None:
    made = Catalogue(
        name="Latina", page={"Resume": "Perge"}, texts={"go": {"Go to {place}": "Ad {place}"}}
    )
    words = Translator(made.all_texts().items())
    assert (words.text("Go to Rome"), words.text("Resume")) == ("Ad Rome", "Perge")
    assert words.text("Cancel") == "Cancel"


@pytest.mark.parametrize(
    ("tag", "code"),
    [
        ("de", "de"),
        ("de-AT", "de"),
        ("DE", "de"),
        ("en-GB", "en"),
        ("xx", ""),
        ("", ""),
        ("../de", ""),
    ],
)
def test_languages_are_known_by_their_tags(tag: str, code: str) -> None:
    assert known_language(tag) == code


# Translating.
@pytest.mark.parametrize(
    ("english", "german"),
    [
        ("Arrived at kitchen", "Bei „kitchen“ angekommen"),
        ("Arrived at the goal", "Am Ziel angekommen"),
        (
            "It is on its way to kitchen, slowly, 3.2 m to go, about 12 s (stop 2 of 3).",
            "Er ist unterwegs zu „kitchen“, langsam, noch 3.2 m, etwa 12 s (Halt 2 von 3).",
        ),
        (
            "The robot cannot drive: the connection to the motor board is down.",
            "Der Roboter kann nicht fahren: Die Verbindung zur Motorplatine ist unterbrochen.",
        ),
        (
            "It took 5 s. A turn on the spot would help.",
            "Das dauerte 5 s. Eine Drehung auf der Stelle würde helfen.",
        ),
        ("Undo: Save the tour St. Anna", "Rückgängig: Tour „St. Anna“ speichern"),
        ("It has arrived at 1. Stop.", "Er ist bei „1. Stop“ angekommen."),
        (
            "Home, because the battery was low. 2 of 3 stops reached.",
            "Zu Hause, weil der Akku fast leer war. 2 von 3 Halten erreicht.",
        ),
        (
            "The map home is saved and in use. At (3.1, -4.0) and in 2 other places scans taken at "
            "different times contradict each other: look at the map there, it may be wrong.",
            "Die Karte „home“ ist gespeichert und in Gebrauch. Bei (3.1, -4.0) und an 2 weiteren "
            "Stellen widersprechen sich Messungen verschiedener Zeiten: dort die Karte ansehen, "
            "sie kann falsch sein.",
        ),
        (
            "Explored: 84 m², 2 places could not be reached. It is back where it began.",
            "Erkundet: 84 m², 2 Stellen nicht erreicht. Er ist zurück, wo er begann.",
        ),
        (
            "The map home is saved and in use. The zone stairs was not kept: No map is loaded yet. "
            "Places were not moved along with the map: the tour service does not answer. Tours "
            "were not moved along with the map: the tour service does not answer.",
            "Die Karte „home“ ist gespeichert und in Gebrauch. Die Zone „stairs“ ging verloren: "
            "Noch ist keine Karte geladen. Orte sind nicht mit der Karte mitgegangen: der "
            "Tourdienst antwortet nicht. Touren sind nicht mit der Karte mitgegangen: der "
            "Tourdienst antwortet nicht.",
        ),
        ("There is no saved pose 'hall'.", "Es gibt keinen Ort 'hall'."),  # release 0.2.0
        ("Remove 08:30 Mon–Wed, Fri", "08:30 Mo–Mi, Fr entfernen"),
        ("Stale · 4 s ago", "Veraltet · vor 4 s"),
        ("Stale · 2 min ago", "Veraltet · vor 2 min"),
        ("The robot cannot drive: zorp.", "Der Roboter kann nicht fahren: zorp."),
        ("Nobody has ever said so.", "Nobody has ever said so."),
        ("", ""),
    ],
)
def test_texts_are_put_together_of_known_parts(english: str, german: str) -> None:
    assert translator("de").text(english) == german


@given(
    st.lists(
        st.sampled_from(["a, b", ": ", "Stop 1", " and ", "{", "}", "“x”", ". Y", "\n", " · "])
    )
)
def test_any_text_is_dealt_with(parts: list[str]) -> None:
    text = "".join(parts)
    words = translator("de")
    assert isinstance(words.text(text), str)
    assert words._num_searches <= 151


# Names.
def is_ambiguous(name: str) -> bool:
    """Whether a name is what the page says where there is none, or a sentence behind another."""
    return (
        re.fullmatch(
            r"stop \S+|(the goal|the person|a point|its stop|the stop)"
            r"|(the place|a place|a point) on the map",
            name,
        )
        or re.search(r"\. [A-Z\d]\S* ", name)
    ) is not None


WORDS = [english for _, english, _ in entries() if name_problem(english) is None]
NAMES = (
    st.one_of(
        st.sampled_from(WORDS),
        st.lists(st.sampled_from([*WORDS, "Dr.", "1.", "to", "St."]), min_size=1, max_size=3).map(
            " ".join
        ),
        st.text("abÄß0_-. ", min_size=1, max_size=12),
    )
    .filter(lambda name: name_problem(name) is None)
    .filter(lambda name: not is_ambiguous(name))
)


@given(NAMES)
def test_names_stay_in_sentences(name: str) -> None:
    pose = KITCHEN.pose
    places = [SavedPose(name=name, map="room", pose=pose)]
    words = translator("de")
    for state in ("planning", "driving", "recovering", "paused", "arrived", "failed"):
        goal = GoalStatus(stamp_ns=1, id="a", state=state, reason="blocked", pose=pose)  # type: ignore[arg-type]
        known = RobotState(goal=goal, places=places, has_map=False)
        for line in (situation(known), goal_line(goal, places)):
            if name in line.headline:
                assert name in words.text(line.headline), line.headline


@given(NAMES | st.sampled_from(["<b>Stop</b>", "{place}", "“Stopped”", "Stop · Cancel", "&amp;"]))
def test_names_stay_where_they_stand_alone(name: str) -> None:
    words = translator("de")
    looks = {
        1: Look(kind="button", label=name, is_name=True),
        2: Look(kind="list", value=name, options=("choose …", name), words=("choose …",)),
        3: Look(kind="html", content=card(name, f"{name} → a point · there and back", {name})),
        4: Look(kind="html", content=numbered([name])),
        5: Look(kind="html", content=table([(name, name, "now")], num_names=2)),
        6: Look(
            kind="html", content=details(StatusLine(f"{name} · 1 Mar 10:30", "good"), "", [name])
        ),
        7: Look(kind="text", label="Name", value=name),
    }
    told = in_language(Told(controls=ControlChanges(looks=looks)), words)
    assert told.controls is not None
    new = told.controls.looks
    assert new[1].label == name
    assert new[2].options == ("choose …", name)
    assert (new[2].shown[1], new[2].value, new[7].value) == (name, name, name)
    for i in (3, 4, 5, 6):
        assert Texts(new[i].content).found >= Texts(looks[i].content).found & {name}


@pytest.mark.parametrize("text", ["Cancel", "No data yet.", '<span style="color:red">now</span>'])
def test_what_programs_say_stays(text: str) -> None:
    note = '<div class="ov-note" translate="yes">No data yet.</div>'
    shown = Card(
        "text", "top", "", f'<div class="ov-title">{text}</div>', f"<div>{text}</div>{note}"
    )
    told = in_language(Told(overlays=OverlayUpdate(cards={"Stop": shown})), translator("de"))
    assert told.overlays is not None
    new = told.overlays.cards["Stop"]
    assert new.head == shown.head
    assert new.body == f"<div>{text}</div>{note}".removesuffix(note) + note.replace(
        "No data yet.", "Noch keine Daten."
    )


# A page.
def look_of(stage: "Stage", browser: "Browser", label: str) -> Look:
    """The newest look of a control that a page was told."""
    id_ = next(i for i, one in stage.page().controls.all.items() if one.label == label)
    told = [one.controls.looks for one in browser.line.told if one.controls is not None]
    return next(looks[id_] for looks in reversed(told) if id_ in looks)


def choose(stage: "Stage", browser: Any, language: str) -> None:
    (id_,) = [i for i, one in stage.page().controls.all.items() if one.label == "Language"]
    stage.say(browser, Said(press=Press(id=1, at_ms=stage.now_ms, control=id_, value=language)))
    assert browser.answers[1].is_done
    stage.runtime.run(0.5)


def test_a_page_is_told_all_anew_in_the_language_that_is_chosen(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    assert browser.state.language == "en"
    choose(stage, browser, "Deutsch")
    assert browser.state.language == "de"
    assert look_of(stage, browser, "Find position").label == "Standort suchen"
    assert look_of(stage, browser, "kitchen").label == "kitchen"
    choice = look_of(stage, browser, "Language")
    assert choice.options[0] == "as this device"
    assert choice.shown == ("wie dieses Gerät", *choice.options[1:])
    choose(stage, browser, "as this device")
    assert look_of(stage, browser, "Find position").label == "Find position"


def test_the_language_is_the_devices_unless_another_is_chosen(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    for tag, code in [("de-CH", "de"), ("en", "en"), ("de", "de"), ("tlh", "en"), ("a/../b", "en")]:
        stage.say(browser, Said(language=tag))
        stage.runtime.run(0.5)
        assert browser.state.language == code
    choose(stage, browser, "English")
    stage.say(browser, Said(language="de"))
    stage.runtime.run(0.5)
    assert browser.state.language == "en"


def test_the_language_is_remembered(stage: "Stage") -> None:
    choose(stage, stage.browse(0, ANN), "Deutsch")
    stage.leave(stage.browsers[0])
    assert stage.browse(1, ANN).state.language == "de"


def test_notices_and_answers_are_in_the_language_of_the_page(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    choose(stage, browser, "Deutsch")
    stage.session.actions.steer("Pause")
    assert browser.notices[-1] == ("Pause: nicht ausgeführt", "Der Roboter fährt nirgendwohin.")
    stage.say(browser, Said(press=Press(id=9, at_ms=stage.now_ms, control=10**6)))
    assert browser.answers[9].text == "Das lässt sich nicht mehr drücken."


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_course_of_a_trip_can_be_shown(code: str) -> None:
    words = translator(code)
    unknown: set[str] = set()
    for state, stop, tour in product(values_of(TourStatus, "state"), (0, 2, 7), (TOUR, None)):
        trip = TourStatus(stamp_ns=1, name="round", trip="t", state=state, stop=stop, seconds=80.0)
        shown = progress(trip, tour)
        unknown |= {text for text in Texts(shown).found if not words.knows(text)}
        assert words.markup(shown).count("<") == shown.count("<")
    assert unknown == set()
    assert words.markup(row(StatusLine("Stopped", "bad", "“<b>”"))) != ""
