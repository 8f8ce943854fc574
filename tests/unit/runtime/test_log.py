"""What is logged, and what a stranger cannot do with it."""

import io
import logging
from collections.abc import Generator

import pytest

from trolley.runtime.log import Log, set_up_logging


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> Generator[io.StringIO]:
    """What goes to stderr."""
    stream = io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    before = logging.getLogger().handlers[:], logging.getLogger().level
    set_up_logging()
    yield stream
    logging.getLogger().handlers[:], level = before
    logging.getLogger().setLevel(level)


def test_a_line_has_time_service_message_and_fields(written: io.StringIO):
    Log("localizer").info("Map loaded", map="home", cells=12)
    line = written.getvalue()
    assert line[8:] == " localizer  Map loaded  map=home  cells=12\n"


def test_what_a_stranger_sent_stays_on_its_line(written: io.StringIO):
    Log("tour").warning("Dropped", key="trolley/x/poses/a\nb\x1b[31m", why="Küche")
    assert written.getvalue().count("\n") == 1
    assert "\x1b" not in written.getvalue()
    assert "Küche" in written.getvalue()


def test_what_a_stranger_sent_is_cut(written: io.StringIO):
    Log("tour").warning("Dropped", why=f"There is no zone {'x' * 1_000_000!r} on this map.")
    assert len(written.getvalue()) < 1200
    assert "There is no zone 'xxx" in written.getvalue()
    assert "xxx' on this map." in written.getvalue()


def test_what_repeats_is_told_once(written: io.StringIO):
    log = Log("tour")
    for _ in range(1000):
        log.limited("poses/invalid", "Dropped", why="bad")
    log.limited("poses/key", "Dropped", why="other")
    assert written.getvalue().count("\n") == 2


def test_the_level_is_set_by_the_environment(written: io.StringIO, monkeypatch: pytest.MonkeyPatch):
    Log("tour").debug("detail")
    assert written.getvalue() == ""
    monkeypatch.setenv("TROLLEY_LOG", "debug")
    monkeypatch.setattr("sys.stderr", written)  # pytest put its own in place since then
    set_up_logging()
    Log("tour").debug("detail")
    assert "detail" in written.getvalue()


def test_a_crash_comes_with_its_trace(written: io.StringIO):
    try:
        _ = 1 / int("0")
    except ZeroDivisionError:
        Log("tour").crash("It ends")
    assert "Traceback" in written.getvalue()
    assert "ZeroDivisionError" in written.getvalue()


def test_the_journal_shows_the_fields_in_its_lines(
    written: io.StringIO, monkeypatch: pytest.MonkeyPatch
):
    """`journalctl` shows messages only: without their fields nobody saw which file was meant."""
    assert written.getvalue() == ""
    monkeypatch.setenv("JOURNAL_STREAM", "8:1")
    set_up_logging()
    (handler,) = logging.getLogger().handlers
    assert type(handler).__name__ == "JournaldLogHandler"
    shown: list[str] = []
    fields: list[str] = []

    class Journal(logging.Filter):
        def filter(self, record: logging.LogRecord) -> bool:
            shown.append(handler.format(record))
            fields.append(record.__dict__["trolley_file"])
            return False

    handler.addFilter(Journal())
    Log("tour").error("Kept aside", file="poses\n.toml")
    assert shown == ["Kept aside  file=poses\\n.toml"]
    assert fields == ["poses\\n.toml"]
