"""Structured logging: one line for a person in a terminal, fields in the journal under systemd."""

import importlib.util
import logging
import math
import os
import sys
import time
from typing import Any

from trolley.sanitize import escape, shorten

_COLOURS = {logging.WARNING: "\033[33m", logging.ERROR: "\033[31m", logging.CRITICAL: "\033[31m"}
_FIELDS = "trolley_fields"
LIMIT_S = 5.0


class Log:
    """A logger whose calls take fields: `log.warning("Scan dropped", beams=3)`."""

    def __init__(self, service: str) -> None:
        self._logger = logging.getLogger(f"trolley.{service}")
        self._last_limited_s: dict[str, float] = {}

    def debug(self, message: str, **fields: Any) -> None:
        """Log what only a developer wants."""
        self._write(logging.DEBUG, message, fields)

    def info(self, message: str, **fields: Any) -> None:
        """Log what happened."""
        self._write(logging.INFO, message, fields)

    def warning(self, message: str, **fields: Any) -> None:
        """Log what a person should look at."""
        self._write(logging.WARNING, message, fields)

    def error(self, message: str, **fields: Any) -> None:
        """Log what keeps the service from its work."""
        self._write(logging.ERROR, message, fields)

    def limited(self, kind: str, message: str, **fields: Any) -> None:
        """Warn at most every 5 s per `kind`: what a stranger sends must not fill the disk."""
        now_s = time.monotonic()
        if now_s - self._last_limited_s.get(kind, -math.inf) >= LIMIT_S:
            self._last_limited_s[kind] = now_s
            self._write(logging.WARNING, message, fields)

    def crash(self, message: str) -> None:
        """Log the exception in hand with its trace."""
        self._logger.exception(message, extra={_FIELDS: {}})

    def _write(self, level: int, message: str, fields: dict[str, Any]) -> None:
        if self._logger.isEnabledFor(level):
            self._logger.log(level, "%s", message, extra={_FIELDS: fields})


def _sentence(record: logging.LogRecord) -> str:
    """A message and its fields, on one line."""
    fields: dict[str, Any] = getattr(record, _FIELDS, {})
    tail = "".join(f"  {name}={_shown(value)}" for name, value in fields.items())
    return f"{escape(record.getMessage())}{tail}"


def _shown(value: object) -> str:
    return escape(shorten(str(value)))


class _TerminalFormatter(logging.Formatter):
    """`12:03:04 localizer  Map loaded  map=home`, warnings in colour where there is a terminal."""

    def __init__(self, *, colour: bool) -> None:
        super().__init__()
        self._colour = colour

    def format(self, record: logging.LogRecord) -> str:
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        service = record.name.removeprefix("trolley.")
        at = self.formatTime(record, "%H:%M:%S")
        line = f"{at} {service:<10} {level}{_sentence(record)}"
        if record.exc_info:
            trace = self.formatException(record.exc_info).splitlines()
            line += "".join(f"\n{escape(part)}" for part in trace)
        colour = _COLOURS.get(record.levelno) if self._colour else None
        return f"{colour}{line}\033[0m" if colour else line


class _JournalFields(logging.Filter):
    """Makes the fields fields of the journal too, `TROLLEY_MAP=home`; `journalctl` shows none."""

    def filter(self, record: logging.LogRecord) -> bool:
        record.msg, record.args = _sentence(record), None
        for name, value in getattr(record, _FIELDS, {}).items():
            setattr(record, f"trolley_{name}", _shown(value))
        return True


def set_up_logging() -> None:
    """Log to the journal where systemd connected one and cysystemd is installed, else to stderr.

    `TROLLEY_LOG` (debug, info, warning, error) says from which level on.
    """
    wanted = os.environ.get("TROLLEY_LOG", "").upper()
    level = logging.getLevelNamesMapping().get(wanted, logging.INFO)
    handler: logging.Handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_TerminalFormatter(colour=sys.stderr.isatty()))
    if "JOURNAL_STREAM" in os.environ and importlib.util.find_spec("cysystemd"):
        from cysystemd.journal import JournaldLogHandler

        handler = JournaldLogHandler()
        handler.addFilter(_JournalFields())
        handler.setFormatter(logging.Formatter("%(message)s"))
    logging.basicConfig(level=level, handlers=[handler], force=True)
