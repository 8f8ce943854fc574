"""What is kept in settings.toml, against a robot.toml that was written with it by hand."""

from pathlib import Path
from typing import Any

import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from trolley.config import ConfigError, load_config
from trolley.config.changeable_settings import Name, acts, value_of
from trolley.config.kept_settings import (
    KEPT_FILE,
    KeptSettings,
    file_of,
    load_with_kept,
    settings_in,
    without_kept,
)
from trolley.config.load import KeptSetting
from trolley.state_file import parse, render

ROBOT = {"name": "one", "footprint": {"radius_m": 0.2}}
NAMES = [
    Name("planner", "max_speed_mps"),
    Name("planner", "controller"),
    Name("base.limits", "max_speed_mps"),
    Name("start", "pose"),
    Name("start", "always"),
    Name("tour", "low_battery"),
    Name("localizer", "min_particles"),
    Name("viz", "port"),
    Name("planner", "zap"),
]
VALUES = st.one_of(
    st.sampled_from([0.1, 0.3, 0.5, 99.0, -1.0, 100, True, "kitchen", "pursuit"]),
    st.fixed_dictionaries({"x": st.just(1.0), "y": st.just(2.0), "yaw": st.just(0.0)}),
)
GOOD = {
    Name("planner", "max_speed_mps"): [0.1, 0.3],
    Name("base.limits", "max_speed_mps"): [0.1, 0.5],
    Name("start", "pose"): ["kitchen", {"x": 1.0, "y": 2.0, "yaw": 0.0}],
    Name("tour", "low_battery"): [0.1, 0.3],
}
Said = dict[Name, Any]
TABLE = st.dictionaries(st.sampled_from(NAMES), VALUES | st.none())
ROBOT_TOML = st.fixed_dictionaries(
    {}, optional={name: st.sampled_from(values) for name, values in GOOD.items()}
)


def tables(said: Said) -> dict[str, Any]:
    """What stands in a robot.toml."""
    plain: dict[str, Any] = {"robot": ROBOT}
    for name, value in said.items():
        table = plain
        for part in name.section.split("."):
            table = table.setdefault(part, {})
        table[name.key] = value
    return plain


def kept_of(values: Said, instead_of: Said) -> list[KeptSetting]:
    names = [name for name in NAMES if (values.get(name), instead_of.get(name)) != (None, None)]
    return [
        KeptSetting(
            section=name.section,
            key=name.key,
            value=values.get(name),
            instead_of=instead_of.get(name),
        )
        for name in names
    ]


@settings(deadline=None)
@given(values=TABLE, instead_of=TABLE)
def test_the_file_says_what_was_kept(values: Said, instead_of: Said) -> None:
    file = file_of(kept_of(values, instead_of))
    assert parse(render(file), KeptSettings) == file
    assert file_of(settings_in(file)) == file, "what cannot be used stays as it is, too"


@settings(deadline=None)
@given(values=TABLE, says=ROBOT_TOML, said=ROBOT_TOML)
def test_what_counts_is_what_a_hand_would_have_written(
    tmp_path_factory: Any, values: Said, says: Said, said: Said
) -> None:
    folder: Path = tmp_path_factory.getbasetemp()
    path, state = folder / "robot.toml", folder / "state"
    (state / "one").mkdir(parents=True, exist_ok=True)
    path.write_text(tomli_w.dumps(tables(says)))
    (state / "one" / KEPT_FILE).write_bytes(render(file_of(kept_of(values, said))))
    alone = load_config(path)
    loaded = load_with_kept(path, state)
    for name in NAMES[:-1]:
        written = dict(says)
        kept = values.get(name)
        if (kept, said.get(name)) != (None, None) and says.get(name) == said.get(name):
            written.pop(name, None)
            if kept is not None:
                written[name] = kept
        path.write_text(tomli_w.dumps(tables(written)))
        expected = value_of(alone, name)
        if acts(name) != "file":
            try:
                expected = value_of(load_config(path), name)
            except ConfigError:
                assert any(name.key in trouble for trouble in loaded.troubles)
        if name.section == "base.limits":
            expected = min(expected, value_of(alone, name))
        assert value_of(loaded.config, name) == expected, name
    assert without_kept(loaded.config) == alone
