"""What `trolley up` and `trolley demo` make of the end of their children."""

import signal
from pathlib import Path
from typing import Any

import pytest
from support.waiting import wait_until

from trolley.cli.running import supervised
from trolley.config import ConfigError
from trolley.interrupts import Interrupts
from trolley.runtime import supervisor


def test_a_child_that_cannot_run_is_told_however_soon_it_ends(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Before the parent had begun to wait, it was taken for a Ctrl-C."""
    (tmp_path / "refuses.py").write_text(f"raise SystemExit({supervisor.EXIT_CONFIG})\n")
    environment = {"PYTHONPATH": str(tmp_path)}
    begin = supervisor.Supervisor.__enter__

    def late(children: supervisor.Supervisor) -> Any:
        begin(children)
        wait_until(lambda: interrupts.number == signal.SIGINT, "it has failed")
        return children

    monkeypatch.setattr(supervisor.Supervisor, "__enter__", late)
    with (
        Interrupts().handled() as interrupts,
        pytest.raises(ConfigError, match="base cannot run with this configuration"),
        supervised(interrupts, {"base": "refuses"}, environment, None),
    ):
        interrupts.wait()
