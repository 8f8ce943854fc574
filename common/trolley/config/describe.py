"""The settings in words: every key with meaning, what is allowed, and its default.

`trolley init` writes a commented file from it, `docs/configuration.md` is generated from it; the
words are the docstrings of the settings' structs.
"""

import ast
import inspect
import itertools
import json
import re
import textwrap
from typing import Any, NamedTuple, cast

import msgspec
from msgspec import inspect as shapes

from trolley.config.base import ExtraSensorConfig
from trolley.config.load import RobotConfig
from trolley.config.robot import FOOTPRINTS, FootprintConfig, PoseConfig
from trolley.drivers import BOARDS, BUILT_IN, LIDARS, BoardSensor, Driver, Drivers
from trolley.geometry.pose import LARGEST

INLINE: dict[type[msgspec.Struct], str] = {
    FootprintConfig: FOOTPRINTS,
    ExtraSensorConfig: "{pose, z_m, uses, kept_s}",
    PoseConfig: "{x, y, yaw} or {x, y, orientation = [x, y, z, w]}",
}
"""Structs that stand on one line of the file, and how."""
DRIVER_TABLES = {BOARDS: "base.chassis.settings", LIDARS: "base.lidar.settings"}
COMMENT_WIDTH = 94
"""Of the text of a comment."""


class Key(NamedTuple):
    """One setting."""

    name: str
    meaning: str
    allowed: str
    default: str | None
    """Default as TOML writes it; None where the setting may be left out and then has no value."""
    is_required: bool
    plain_default: Any = None
    """In plain values; None: there is none."""
    least: float | None = None
    """Lower limit of a number, None for none."""
    greatest: float | None = None
    """Upper limit of a number, None for none."""
    choices: tuple[str, ...] = ()
    """All values of a word."""
    drivers: str = ""
    """The group of the drivers of which it names one."""

    @property
    def placeholder(self) -> str:
        """What stands in a file for a value that a person has to fill in: mostly not allowed."""
        return "0.0" if "number" in self.allowed else '""'


class Section(NamedTuple):
    """One table of the file."""

    name: str
    """With its dots, such as `base.limits`."""
    meaning: str
    keys: list[Key]


def sections() -> list[Section]:
    """All tables in the order of the file."""
    return _sections(RobotConfig, "")


def driver_sections() -> list[tuple[str, Section]]:
    """The tables of the drivers' own settings, each behind the name of its driver.

    It imports all drivers that can be used.
    """
    found: list[tuple[str, Section]] = []
    for group, table in DRIVER_TABLES.items():
        for name, driver in Drivers(Driver, group).items():
            keys = keys_of(driver.settings)
            if keys:
                meaning = inspect.cleandoc(driver.settings.__doc__ or "").split("\n\n", 1)[0]
                found.append((name, Section(table, meaning.replace("\n", " "), keys)))
    return found


def sensor_tables() -> list[str]:
    """The tables of the boards' own sensors, all commented out; imports all drivers of boards."""
    drivers = Drivers(Driver, BOARDS).items()
    return [
        as_comment(sensor_table(name, one)) for name, driver in drivers for one in driver.sensors
    ]


def sensor_table(board: str, sensor: BoardSensor) -> str:
    """The lines that list a sensor of a board, with its meaning as comments above them."""
    text = f"With {board}: {sensor.meaning}"
    lines = textwrap.wrap(text, COMMENT_WIDTH, break_on_hyphens=False)
    table = [f"{key} = {to_toml(value)}" for key, value in sensor.settings.items()]
    return "\n".join([*(f"# {line}" for line in lines), f"[base.scans.{sensor.name}]", *table, ""])


def as_comment(text: str) -> str:
    """Comment out what is no comment yet."""
    lines = text.splitlines(keepends=True)
    return "".join(line if line[0] in "#\n" else f"# {line}" for line in lines)


def keys_of(struct: type[msgspec.Struct]) -> list[Key]:
    """The settings of a table, those in tables below it left out."""
    words = attribute_docs(struct)
    return [
        Key(
            field.name,
            words.get(field.name, ""),
            allowed(field.type),
            None if (default := _default(field)) is None else to_toml(default),
            field.required,
            msgspec.to_builtins(default),
            *_range(field.type),
            _choices(field.type),
            _drivers(field.type),
        )
        for field in cast("shapes.StructType", shapes.type_info(struct)).fields
        if _table(field.type) is None
    ]


def table_of(struct: type[msgspec.Struct], name: str) -> type[msgspec.Struct]:
    """The struct of a table below another.

    Raises:
        KeyError: there is no such table.
    """
    for field in cast("shapes.StructType", shapes.type_info(struct)).fields:
        table = _table(field.type)
        if field.name == name and table is not None:
            return table
    raise KeyError(name)


def _sections(struct: type[msgspec.Struct], name: str) -> list[Section]:
    keys = keys_of(struct) if name else []
    below: list[Section] = []
    for field in cast("shapes.StructType", shapes.type_info(struct)).fields:
        table = _table(field.type)
        if table is not None:
            below += _sections(table, f"{name}.{field.name}".lstrip("."))
    meaning = inspect.cleandoc(struct.__doc__ or "").split("\n\n", 1)[0].replace("\n", " ")
    meaning = meaning.removeprefix(f"`[{name}]`: ")
    meaning = meaning[:1].upper() + meaning[1:]
    own = [Section(name, meaning, keys)] if name else []
    return own + below


def attribute_docs(struct: type[msgspec.Struct]) -> dict[str, str]:
    """The string below each field of a class, on one line; its base classes' too."""
    found: dict[str, str] = {}
    for cls in reversed(struct.__mro__):
        if cls is msgspec.Struct or not issubclass(cls, msgspec.Struct):
            continue
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
        body = cast("ast.ClassDef", tree.body[0]).body
        for field, text in itertools.pairwise(body):
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str() as words)),
                ):
                    found[name] = " ".join(words.split())
                case _:
                    pass
    return found


def _table(shape: shapes.Type) -> type[msgspec.Struct] | None:
    """The struct behind a field that is a table of its own."""
    options = shape.types if isinstance(shape, shapes.UnionType) else (shape,)
    for option in options:
        if isinstance(option, shapes.StructType) and option.cls not in INLINE:
            return option.cls
    return None


def _default(field: shapes.Field) -> Any:
    """What a setting is that is not given, None if there is nothing then."""
    if field.default_factory is not msgspec.NODEFAULT:
        return field.default_factory()
    return None if field.default is msgspec.NODEFAULT else field.default


def _range(shape: shapes.Type) -> tuple[float | None, float | None]:
    """The bounds of a number, None where there is none."""
    if not isinstance(shape, shapes.FloatType | shapes.IntType):
        return None, None
    least = shape.gt if shape.ge is None else shape.ge
    greatest = shape.lt if shape.le is None else shape.le
    return (
        None if least is None else float(least),
        None if greatest is None or greatest >= LARGEST else float(greatest),
    )


def _choices(shape: shapes.Type) -> tuple[str, ...]:
    if not isinstance(shape, shapes.LiteralType):
        return ()
    return tuple(str(value) for value in shape.values)


def _drivers(shape: shapes.Type) -> str:
    """The group of drivers of which a value names one, "" for other values."""
    options = shape.types if isinstance(shape, shapes.UnionType) else (shape,)
    for option in options:
        match option:
            case shapes.Metadata(extra={"drivers": str(group)}):
                return group
            case _:
                pass
    return ""


def to_toml(value: Any) -> str:
    """A value as it stands behind `key = ` in the file."""
    plain = msgspec.to_builtins(value)
    if isinstance(plain, dict):
        items = cast("dict[str, Any]", plain).items()
        known = [f"{key} = {to_toml(one)}" for key, one in items if one is not None]
        return "{ " + ", ".join(known) + " }"
    if isinstance(plain, list):
        return "[" + ", ".join(map(to_toml, cast("list[Any]", plain))) + "]"
    return json.dumps(plain, ensure_ascii=False)


def allowed(shape: shapes.Type) -> str:
    """What a value of this type may be, in words."""
    match shape:
        case shapes.FloatType() | shapes.IntType():
            kind = "whole number" if isinstance(shape, shapes.IntType) else "number"
            return f"{kind} {_bounds(shape)}".rstrip()
        case shapes.StrType():
            most = shape.max_length
            return "text" if most is None else f"text of {most} characters at most"
        case shapes.LiteralType():
            return " or ".join(f"`{to_toml(value)}`" for value in shape.values)
        case shapes.Metadata():
            names = [name for models in BUILT_IN[_drivers(shape)].values() for name in models]
            words = " or ".join(f"`{to_toml(name)}`" for name in names)
            return f"{words} or a driver of another package"
        case shapes.UnionType():
            some = [one for one in shape.types if not isinstance(one, shapes.NoneType)]
            return " or ".join(map(allowed, some))
        case _:
            return _allowed_inside(shape)


def _allowed_inside(shape: shapes.Type) -> str:
    match shape:
        case shapes.BoolType():
            return "`true` or `false`"
        case shapes.ListType():
            return f"list of {_several(shape.item_type)}"
        case shapes.TupleType():
            return f"{len(shape.item_types)} numbers"
        case shapes.DictType(value_type=shapes.AnyType()):
            return "table"
        case shapes.DictType():
            return f"table of {_several(shape.value_type)}"
        case shapes.StructType():
            return INLINE[shape.cls]
        case _:
            raise TypeError(f"a setting of the type {shape} has no words yet")


def _several(shape: shapes.Type) -> str:
    """What several values of this type may be, in words."""
    return re.sub(r"\bnumber\b", "numbers", allowed(shape))


def _bounds(shape: shapes.FloatType | shapes.IntType) -> str:
    upper = "to" if shape.ge is not None else "and at most"
    bounds = {"above": shape.gt, "from": shape.ge, "and below": shape.lt, upper: shape.le}
    return " ".join(
        f"{word} {bound:g}" if abs(bound) < 1e6 else f"{word} {bound}"
        for word, bound in bounds.items()
        if bound is not None and abs(bound) < LARGEST
    )
