"""What all tests share: hypothesis profiles, the folder of recorded drives, real processes."""

import gc
import os
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from support.cases import NEW, cases
from support.processes import Process, RouterProcess, find_free_port, own_router, write_config
from support.signals import start_children_with_defaults
from support.waiting import PATIENCE_S
from support.wire import wait_for_service

from trolley.runtime.zenoh_bus import ZenohBus, open_bus

start_children_with_defaults()

# Containers like to forbid compiled modules to be kept. Hundreds of processes that compile all they
# import, numpy first of all, are most of what these tests would do then.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No deadline: the first call of a numba kernel compiles it.
# Nor a check of how quickly examples come: that measures the machine.
NO_CLOCK: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
# The same cases each time, so that a test that is red tells of the last change; new ones on demand.
settings.register_profile("same", **NO_CLOCK, derandomize=True, max_examples=cases(50))
settings.register_profile("new", **NO_CLOCK, print_blob=True)
settings.load_profile("new" if NEW else "same")

StartService = Callable[..., Process]

MORE_RUNS = 2
"""How often a test that is marked `again` is run once more."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let a test that says why be run again where it fails."""
    for item in items:
        if (mark := item.get_closest_marker("again")) is not None:
            (why,) = mark.args
            item.add_marker(pytest.mark.flaky(reruns=MORE_RUNS))
            item.user_properties.append(("why_again", why))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Keep how such a test failed, for `parts.py` to tell of it where a later run passes."""
    report = yield
    if report.failed and item.get_closest_marker("again") is not None:
        item.user_properties.append(("failed", report.longreprtext))
    return report


def pytest_collection() -> None:
    """Let the collector rest while thousands of tests are found: nothing of them is garbage."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Let it look only at what the tests make."""
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of recorded drives, named by TROLLEY_DATA; without it the test is skipped."""
    folder = os.environ.get("TROLLEY_DATA", "")
    if not folder:
        pytest.skip("TROLLEY_DATA does not name a folder of recorded drives")
    if not Path(folder).is_dir():
        pytest.skip(f"TROLLEY_DATA names no folder: {folder}")
    return Path(folder)


@pytest.fixture
def free_port() -> int:
    """A port of the loopback interface that nobody listens on."""
    return find_free_port()


@pytest.fixture
def router(free_port: int, tmp_path: Path) -> Generator[RouterProcess]:
    """A router in a process of its own; `.endpoint`, `.stop()`, `.start()`."""
    process = RouterProcess(free_port, tmp_path / "router.log")
    process.start()
    yield process
    process.stop()


@pytest.fixture
def router_endpoint(request: pytest.FixtureRequest) -> Generator[str]:
    """Where a router listens: `router` for a test that asks for it too, else one in this process.

    A process of its own costs as much as a service; only a test that ends it needs one.
    """
    if "router" in request.fixturenames:
        yield request.getfixturevalue("router").endpoint
        return
    with own_router() as endpoint:
        yield endpoint


@pytest.fixture
def config_file(router_endpoint: str, tmp_path: Path) -> Path:
    """A `robot.toml` for the robot `tester` at the router."""
    return write_config(tmp_path / "robot.toml", router_endpoint)


@pytest.fixture
def bus(router_endpoint: str) -> Generator[ZenohBus]:
    """A session of the test with the router."""
    with open_bus([router_endpoint], timeout_s=PATIENCE_S) as opened:
        yield opened


@pytest.fixture
def service_process(config_file: Path, tmp_path: Path) -> Generator[StartService]:
    """Start services as processes: `service_process("trolley_base")` or `("module:Class")`.

    They read `config_file` (or `config=`), keep their state under `tmp_path` and are killed at the
    end of the test; `environment=` adds variables.
    """
    started: list[Process] = []

    def start(
        service: str,
        config: Path | None = None,
        environment: dict[str, str] | None = None,
    ) -> Process:
        program = ["support.run_service", service] if ":" in service else [service]
        process = Process(
            ["-m", *program, "--config", str(config or config_file)],
            tmp_path / f"{service.replace(':', '.')}-{len(started)}.log",
            {"TROLLEY_STATE": str(tmp_path / "state"), **(environment or {})},
        )
        started.append(process)
        return process

    yield start
    for process in reversed(started):
        process.kill()


@pytest.fixture
def keeper(service_process: StartService, bus: ZenohBus) -> Process:
    """A running `support.services:Keeper`: it keeps poses as `tour` does."""
    process = service_process("support.services:Keeper")
    wait_for_service(bus, "tour")
    return process
