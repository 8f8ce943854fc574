"""Parameters in YAML files, with the lines where they stand."""

from pathlib import Path

import yaml

from trolley.files import read_text
from trolley.yaml_loader import FewReferencesLoader
from trolley_base.importers.findings import Value, shown

_REASONS: dict[type[Exception], str] = {
    RecursionError: "nested too deep",
    UnicodeDecodeError: "not UTF-8 text",
}


def read_parameters(path: Path, folder: Path, problems: list[str]) -> dict[str, Value]:
    """Return the parameters of a YAML file by their path, such as `FollowPath.max_vel_x`.

    Args:
        path: the file.
        folder: what names are shown relative to.
        problems: is added to where the file cannot be read.
    """
    found: dict[str, Value] = {}
    try:
        loader = FewReferencesLoader(read_text(path))
        root = loader.get_single_node()
        if root is not None:
            _flatten(loader, root, path, "", found)
    except OSError as error:
        problems.append(f"{shown(path, folder)} cannot be read: {error.strerror}.")
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        reason = getattr(error, "problem", None) or _REASONS.get(type(error), "not text")
        problems.append(
            f"{shown(path, folder)}{line} is not valid YAML ({reason}): "
            f"nothing is taken from this file."
        )
        found.clear()
    return found


def _flatten(
    loader: yaml.SafeLoader, node: yaml.Node, path: Path, above: str, found: dict[str, Value]
) -> None:
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        name = f"{above}{key.value}"
        if isinstance(value, yaml.MappingNode):
            _flatten(loader, value, path, f"{name}.", found)
        else:
            plain = loader.construct_object(value, deep=True)
            found[name] = Value(plain, path, key.start_mark.line + 1)
