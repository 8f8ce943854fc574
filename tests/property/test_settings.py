"""A robot.toml has problems if and only if it is refused."""

from pathlib import Path
from typing import Any

import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from trolley.config import ConfigError, load_host_config
from trolley.config.problems import find_problems

VALUES = st.one_of(
    st.integers(-3, 3),
    st.floats(-10.0, 10.0),
    st.sampled_from(
        ["", "one", "odom", "ld19", "arduino_bridge", "tcp/127.0.0.1:7447", "Bad Name"]
    ),
    st.booleans(),
    st.lists(st.integers(-3, 3), max_size=3),
    st.fixed_dictionaries({"radius_m": st.floats(-1.0, 1.0)}),
    st.fixed_dictionaries({"x": st.integers(0, 1), "y": st.integers(0, 1)}),
)
KEYS = {
    "robot": ["name", "title", "footprint", "drive", "zap"],
    "planner": ["frame", "max_speed_mps", "rollouts", "turn_to_find", "zap"],
    "zenoh": ["connect", "uplink", "zap"],
    "base": ["driver", "lidar", "chassis", "sources", "limits", "zap"],
    "start": ["pose", "always"],
    "viz": ["port", "origins"],
    "zap": ["zap"],
}
GOOD = {"name": "one", "footprint": {"radius_m": 0.2}}
TABLES = st.fixed_dictionaries(
    {},
    optional={
        name: st.dictionaries(
            st.sampled_from(keys),
            VALUES | st.dictionaries(st.sampled_from(["port", "baud"]), VALUES),
        )
        | VALUES
        for name, keys in KEYS.items()
    },
)


@settings(deadline=None)
@given(tables=TABLES, has_robot=st.booleans())
def test_a_file_has_problems_if_it_is_refused(
    tmp_path_factory: Any, tables: dict[str, Any], has_robot: bool
) -> None:
    path: Path = tmp_path_factory.getbasetemp() / "robot.toml"
    if has_robot:
        robot = tables.get("robot", {})
        tables["robot"] = {**GOOD, **robot} if isinstance(robot, dict) else robot
    path.write_bytes(tomli_w.dumps(tables).encode())
    try:
        load_host_config(path)
    except ConfigError:
        is_refused = True
    else:
        is_refused = False
    found = find_problems(path)
    assert bool(found) == is_refused, found
    assert len(found) == len(set(found))
