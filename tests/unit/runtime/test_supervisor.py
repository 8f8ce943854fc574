"""Children that end, hang, cannot run, or outlive their supervisor."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.files import no_files_left
from support.waiting import PATIENCE_S, wait_until

from trolley.interrupts import Interrupts
from trolley.runtime.supervisor import Supervisor
from trolley.supervision import Watchdog

pytestmark = pytest.mark.programs

OBEDIENT = "import time\nwhile True: time.sleep(1)\n"
STUBBORN = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + OBEDIENT
WRONG = "import sys\nsys.exit(2)\n"


@pytest.fixture
def module(tmp_path: Path) -> Callable[[str, str], dict[str, str]]:
    """Write modules and give the environment in which they can be imported."""

    def write(name: str, text: str) -> dict[str, str]:
        (tmp_path / f"{name}.py").write_text(text)
        paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
        return {"PYTHONPATH": os.pathsep.join(paths)}

    return write


def ignores_sigterm(pid: int) -> bool:
    found = re.search(r"SigIgn:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return bool(int(found[1], 16) >> (signal.SIGTERM - 1) & 1)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_a_supervisor_without_a_file_left_tries_again(module: Callable) -> None:
    said: list[str] = []
    environment = module("obedient", OBEDIENT)
    with Supervisor({"one": "obedient"}, environment, said.append, held=["one"]) as supervisor:
        child = supervisor.children["one"]
        with no_files_left():
            supervisor.release("one")
            wait_until(lambda: said, "it says so")
            assert child.pid is None
        wait_until(lambda: child.pid, "it runs")
    assert said[0] == "one cannot be started (Too many open files); trying again"


def test_a_child_runs_no_file_of_the_folder_where_it_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    here = tmp_path / "here"
    here.mkdir()
    (here / "queue.py").write_text("raise SystemExit(1)\n")
    monkeypatch.chdir(here)
    (tmp_path / "asking.py").write_text(f"import queue\nopen('runs', 'w')\n{OBEDIENT}")
    environment = {"PYTHONPATH": str(tmp_path)}
    with Supervisor({"one": "asking"}, environment, said.append):
        wait_until(lambda: said or (here / "runs").exists(), "it runs, or ends")
    assert said == []


def test_a_killed_child_comes_back(module: Callable) -> None:
    said: list[str] = []
    environment = module("obedient", OBEDIENT)
    with Supervisor({"one": "obedient"}, environment, said.append) as supervisor:
        child = supervisor.children["one"]
        wait_until(lambda: child.pid, "it runs")
        first = child.pid
        assert first is not None
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: child.pid not in (None, first), "it is back")
        second = child.pid
        assert second is not None
        assert child.restarts == 1
        assert said == ["one was killed by SIGKILL; starting it again"]
    assert not is_running(second)


def test_a_child_that_keeps_ending_is_started_ever_more_rarely(
    module: Callable, tmp_path: Path
) -> None:
    said: list[str] = []
    starts = tmp_path / "starts"
    note = f"import time\nprint(time.monotonic(), file=open({str(starts)!r}, 'a'))\n"
    environment = module("crash", note + "raise SystemExit(1)\n")
    with Supervisor({"one": "crash"}, environment, said.append):
        wait_until(lambda: starts.exists() and starts.read_text().count("\n") >= 5, "5 starts")
    *_, before_s, last_s = map(float, starts.read_text().split())
    assert last_s - before_s > 0.8
    assert said[0] == "one ended with exit code 1; starting it again"


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """SIGINT interrupts this process, also where a shell runs the tests in its background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_a_child_that_cannot_run_interrupts_the_main_thread(module: Callable) -> None:
    environment = module("wrong", WRONG)
    with (
        Supervisor({"one": "wrong"}, environment, lambda _: None) as supervisor,
        pytest.raises(KeyboardInterrupt),
    ):
        time.sleep(PATIENCE_S)
    assert supervisor.failure == "one cannot run with this configuration"
    assert supervisor.children["one"].restarts == 0


@pytest.fixture
def in_background() -> Iterator[None]:
    """As under `trolley up &` in a script: SIGINT is ignored, and stays so."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("in_background")
def test_a_child_that_cannot_run_ends_a_supervisor_in_the_background_of_a_script(
    module: Callable,
) -> None:
    environment, interrupts = module("wrong", WRONG), Interrupts()
    with (
        interrupts.handled(),
        Supervisor({"one": "wrong"}, environment, lambda _: None) as supervisor,
        pytest.raises(KeyboardInterrupt),
    ):
        wait_until(lambda: interrupts.number is not None, "it is told")
    assert supervisor.failure == "one cannot run with this configuration"


def test_a_child_that_ignores_sigterm_is_killed(
    module: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trolley.runtime.supervisor.GRACE_S", 0.5)
    said: list[str] = []
    environment = module("stubborn", STUBBORN)
    with Supervisor({"one": "stubborn"}, environment, said.append) as supervisor:
        wait_until(lambda: supervisor.children["one"].pid, "it runs")
        pid = supervisor.children["one"].pid
        assert pid is not None
        wait_until(lambda: ignores_sigterm(pid), "it ignores SIGTERM")
    assert not is_running(pid)
    assert said == ["one does not end; killing it"]


def test_children_end_with_a_supervisor_that_is_killed(module: Callable, tmp_path: Path) -> None:
    is_set = tmp_path / "set"
    polite = (
        "from pathlib import Path\nfrom trolley.supervision import end_with_parent\n"
        f"end_with_parent()\nPath({str(is_set)!r}).touch()\n"
    )
    environment = module("polite", polite + OBEDIENT)
    program = (
        "import sys, time\nfrom pathlib import Path\n"
        "from trolley.runtime.supervisor import Supervisor\n"
        "with Supervisor({'one': 'polite'}, {}, print) as s:\n"
        f"    while not Path({str(is_set)!r}).exists(): time.sleep(0.01)\n"
        "    print(s.children['one'].pid, flush=True)\n"
        "    time.sleep(600)\n"
    )
    supervisor = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert supervisor.stdout is not None
    child = int(supervisor.stdout.readline())
    assert is_running(child)
    supervisor.kill()
    supervisor.wait()
    supervisor.stdout.close()
    wait_until(lambda: not is_running(child), "it has ended")


HANGS = """
import time
from trolley.supervision import Supervision
supervision = Supervision()
supervision.ready()
for _ in range(5):
    supervision.alive()
    time.sleep(supervision.period_s)
time.sleep(100.0)
"""
FROZEN = """
import os, signal, time
from trolley.supervision import Supervision
supervision = Supervision()
supervision.ready()
while True:
    supervision.alive()
    time.sleep(supervision.period_s)
"""


IMPATIENT_S = 0.9


def test_a_child_that_hangs_is_killed_and_comes_back(module: Callable) -> None:
    said: list[str] = []
    environment = module("hangs", HANGS)
    began_s = time.monotonic()
    with Supervisor(
        {"one": "hangs"}, environment, said.append, watchdog_s=IMPATIENT_S
    ) as supervisor:
        wait_until(lambda: supervisor.children["one"].restarts == 1, "it is started again")
        assert time.monotonic() - began_s > 1.5  # not before it fell silent
    assert said[:2] == ["one hangs; killing it", "one was killed by SIGKILL; starting it again"]


def test_a_frozen_child_is_killed_but_a_silent_program_is_left_alone(module: Callable) -> None:
    said: list[str] = []
    module("obedient", OBEDIENT)
    environment = module("frozen", FROZEN)
    both = {"one": "frozen", "two": "obedient"}
    with Supervisor(both, environment, said.append, watchdog_s=IMPATIENT_S) as supervisor:
        one, two = supervisor.children.values()
        wait_until(lambda: one.watchdog._heard_s is not None, "it is heard")
        assert one.pid is not None
        os.kill(one.pid, signal.SIGSTOP)
        wait_until(lambda: one.restarts == 1, "it is started again")
        assert two.restarts == 0


def test_as_many_children_start_at_a_time_as_there_are_cores(
    module: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All at once, the first scan waited for what nobody needs yet."""
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    module("obedient", OBEDIENT)
    environment = module("frozen", FROZEN)
    both = {"one": "frozen", "two": "obedient"}
    with Supervisor(both, environment, lambda _: None) as supervisor:
        one, two = supervisor.children.values()
        wait_until(lambda: two.pid, "the second is started")
        assert one.watchdog.is_ready


def test_a_child_that_was_killed_does_not_wait_for_others_to_be_ready(
    module: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without base the robot stands, and nobody can drive it."""
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    monkeypatch.setattr("trolley.runtime.supervisor.TURN_S", 60.0)
    module("obedient", OBEDIENT)
    environment = module("frozen", FROZEN)
    both = {"one": "frozen", "two": "obedient"}
    with Supervisor(both, environment, lambda _: None) as supervisor:
        one, two = supervisor.children.values()
        wait_until(lambda: two.pid, "the second is started")
        one.signal(signal.SIGKILL)
        wait_until(lambda: one.restarts == 1 and one.pid, "the first is back")
        assert two.is_starting(time.monotonic())


def test_a_child_that_never_says_it_is_ready_does_not_keep_others_waiting(
    module: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    monkeypatch.setattr("trolley.runtime.supervisor.TURN_S", 0.1)
    environment = module("obedient", OBEDIENT)
    both = {"one": "obedient", "two": "obedient"}
    with Supervisor(both, environment, lambda _: None) as supervisor:
        wait_until(lambda: supervisor.children["two"].pid, "the second is started")


def is_stopped(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"


def test_a_child_does_not_wait_for_a_watchdog_that_is_frozen_itself(module: Callable) -> None:
    watchdog = Watchdog(0.9)
    environment = {**os.environ, **module("frozen", FROZEN), **watchdog.environment}
    child = subprocess.Popen([sys.executable, "-m", "frozen"], env=environment)
    try:
        wait_until(lambda: not watchdog.is_silent(0.0) and watchdog.is_ready, "it is ready")
        os.kill(child.pid, signal.SIGSTOP)
        wait_until(lambda: is_stopped(child.pid), "it says nothing more")
        watchdog.is_silent(0.0)
        watchdog.pardon(100.0)
        assert not watchdog.is_silent(100.5)
        assert watchdog.is_silent(101.0)
        os.kill(child.pid, signal.SIGCONT)
        time.sleep(6.0)  # nobody reads, and the queue is full
        assert Path(f"/proc/{child.pid}/wchan").read_text() != "unix_wait_for_peer"
        assert not watchdog.is_silent(200.0)
    finally:
        child.kill()
        child.wait()
        watchdog.close()


def test_a_child_that_a_real_time_signal_kills_is_restarted(module: Callable) -> None:
    said: list[str] = []
    environment = module("sleeper", STUBBORN)
    with Supervisor({"one": "sleeper"}, environment, said.append) as supervisor:
        child = supervisor.children["one"]
        wait_until(lambda: child.pid, "it runs")
        os.kill(child.pid or 0, signal.SIGRTMIN + 5)
        wait_until(lambda: child.restarts == 1 and child.pid, "it runs again")
    assert any("was killed by signal 39" in one for one in said)
