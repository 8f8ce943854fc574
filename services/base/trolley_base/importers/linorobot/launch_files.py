"""Reads ROS 1 launch files as roslaunch does, without ROS.

Everything keeps the file and line that it comes from. What cannot be read or resolved becomes a
sentence, and the rest is read on.

Source:
    roslaunch XML, http://wiki.ros.org/roslaunch/XML.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from trolley.files import read_file
from trolley_base.importers.findings import Value, shown

SUBSTITUTION = re.compile(r"\$\(\s*(\w+)([^)]*)\)")
TRUE, FALSE = ("true", "1"), ("false", "0")
DEEPEST = 12
"""Deeper than this, files include each other in a circle."""
DEEPEST_XML = 100
"""No launch file nests elements deeper than this; each level costs a call to walk through."""


@dataclass(slots=True)
class Node:
    """A program that a launch file starts.

    Attributes:
        package: where it comes from.
        kind: the program.
        name: what it is called.
        arguments: its command line, the text resolved.
        params: what it is told.
        files: parameter files that it loads.
    """

    package: str
    kind: str
    name: str
    arguments: Value
    params: dict[str, Value] = field(default_factory=dict[str, Value])
    files: list[Path] = field(default_factory=list[Path])


@dataclass(slots=True)
class Launch:
    """What launch files start together.

    Attributes:
        nodes: programs.
        params: parameters that stand outside programs.
        problems: what could not be read, one sentence each.
    """

    nodes: list[Node] = field(default_factory=list[Node])
    params: dict[str, Value] = field(default_factory=dict[str, Value])
    problems: list[str] = field(default_factory=list[str])

    def of_kind(self, *kinds: str) -> list[Node]:
        """Return the nodes that run one of these programs."""
        return [node for node in self.nodes if node.kind in kinds]

    def of_package(self, packages: Collection[str]) -> list[Node]:
        """Return the nodes of these packages."""
        return [node for node in self.nodes if node.package in packages]


@dataclass(slots=True)
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    children: "list[_Element]" = field(default_factory=list["_Element"])


class NotRead(Exception):
    """A file is XML that no launch file holds: why."""


class Unresolved(Exception):
    """A substitution that cannot be made: why."""


class LaunchReader:
    """Reads launch files of one package.

    Args:
        folder: the package's.
        environment: what `$(env ...)` stands for.
    """

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._packages = _own_names(folder)
        self._read: set[Path] = set()

    def read(self, path: Path, launch: Launch) -> None:
        """Add what a file and those that it includes say; a file is read once."""
        self._read_file(path, {}, launch, 0)

    def _read_file(self, path: Path, given: dict[str, str], launch: Launch, depth: int) -> None:
        if path.resolve() in self._read or depth > DEEPEST:
            return
        self._read.add(path.resolve())
        try:
            root = _parse(path)
        except OSError as error:
            launch.problems.append(f"{self.shown(path)} cannot be read: {error.strerror}.")
        except expat.ExpatError as error:
            launch.problems.append(
                f"{self.shown(path)}:{error.lineno} is not valid XML "
                f"({expat.ErrorString(error.code)}): nothing is taken from this file."
            )
        except NotRead as error:
            launch.problems.append(f"{self.shown(path)}:{error}: nothing is taken from this file.")
        else:
            _FileReader(self, path, given, launch, depth).visit(root)

    def include(self, path: Path, given: dict[str, str], launch: Launch, depth: int) -> None:
        """Read a file that another one includes."""
        self._read_file(path, given, launch, depth + 1)

    def shown(self, path: Path) -> str:
        """A file's name for people: from the package's folder."""
        return shown(path, self._folder)

    def resolve(self, text: str, arguments: Mapping[str, str]) -> str:
        """Make the substitutions in a text.

        Raises:
            Unresolved: one of them cannot be made.
        """

        def replace(match: re.Match[str]) -> str:
            return self._substitute(match[1], match[2].split(), arguments)

        return SUBSTITUTION.sub(replace, text)

    def _substitute(self, kind: str, words: list[str], arguments: Mapping[str, str]) -> str:
        name = words[0] if words else ""
        if kind == "find" and name in self._packages:
            return str(self._folder)
        if kind == "arg" and name in arguments:
            return arguments[name]
        if kind in ("env", "optenv") and name in self._environment:
            return self._environment[name]
        if kind == "optenv":
            return " ".join(words[1:])
        reason = "is not set" if kind in ("env", "arg") else "is not known here"
        raise Unresolved(f"$({' '.join([kind, *words])}) {reason}")


class _FileReader:
    """One launch file with its arguments."""

    def __init__(
        self, reader: LaunchReader, path: Path, given: dict[str, str], launch: Launch, depth: int
    ) -> None:
        self._reader = reader
        self._path = path
        self._given = given
        self._launch = launch
        self._depth = depth
        self._arguments: dict[str, str] = {}

    def visit(self, parent: _Element) -> None:
        """Take what stands in an element, in the order of the file."""
        for element in parent.children:
            try:
                if self._is_wanted(element):
                    self._take(element)
            except Unresolved as error:
                where = f"{self._reader.shown(self._path)}:{element.line}"
                what = element.attributes.get("file") or element.attributes.get("name") or ""
                self._launch.problems.append(
                    f"{where}: {error}, so <{element.tag}> {what} is left out.".replace("  ", " ")
                )

    def _is_wanted(self, element: _Element) -> bool:
        if "if" in element.attributes:
            return self._text(element, "if").strip().lower() in TRUE
        if "unless" in element.attributes:
            return self._text(element, "unless").strip().lower() in FALSE
        return True

    def _take(self, element: _Element) -> None:
        match element.tag:
            case "arg":
                self._take_argument(element)
            case "include":
                given = {
                    self._text(child, "name"): self._text(child, "value")
                    for child in element.children
                    if child.tag == "arg" and "value" in child.attributes
                }
                path = Path(self._text(element, "file"))
                self._reader.include(path, given, self._launch, self._depth)
            case "group":
                self.visit(element)
            case "param" if "value" in element.attributes:
                self._launch.params[self._text(element, "name").lstrip("/")] = self._value(element)
            case "node":
                self._launch.nodes.append(self._node(element))
            case _:
                pass

    def _take_argument(self, element: _Element) -> None:
        name = self._text(element, "name")
        if "value" in element.attributes:
            self._arguments[name] = self._text(element, "value")
        elif name in self._given:
            self._arguments[name] = self._given[name]
        elif "default" in element.attributes:
            self._arguments[name] = self._text(element, "default")

    def _node(self, element: _Element) -> Node:
        arguments = Value(self._text(element, "args"), self._path, element.line)
        node = Node(
            self._text(element, "pkg"),
            self._text(element, "type"),
            self._text(element, "name"),
            arguments,
        )
        for child in element.children:
            if child.tag == "param" and "value" in child.attributes:
                node.params[self._text(child, "name").lstrip("~")] = self._value(child)
            elif child.tag == "rosparam" and child.attributes.get("file"):
                node.files.append(Path(self._text(child, "file")))
        return node

    def _value(self, element: _Element) -> Value:
        return Value(self._text(element, "value"), self._path, element.line)

    def _text(self, element: _Element, attribute: str) -> str:
        return self._reader.resolve(element.attributes.get(attribute, ""), self._arguments)


def _parse(path: Path) -> _Element:
    """Read XML; the standard library's tree does not keep lines.

    Raises:
        OSError: it cannot be read.
        expat.ExpatError: it is no XML.
        NotRead: it is nested too deeply, or defines entities.
    """
    root = _Element("", {}, 0)
    open_elements = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(open_elements) > DEEPEST_XML:
            raise NotRead(f"{parser.CurrentLineNumber} is nested more than {DEEPEST_XML} deep")
        element = _Element(tag, attributes, parser.CurrentLineNumber)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def end(_tag: str) -> None:
        open_elements.pop()

    def define(*_: object) -> None:
        raise NotRead(f"{parser.CurrentLineNumber} defines an entity, which may unfold without end")

    parser.StartElementHandler = start
    parser.EntityDeclHandler = define
    parser.EndElementHandler = end
    parser.Parse(read_file(path), True)
    return root.children[0]


def _own_names(folder: Path) -> set[str]:
    """The names under which a package's launch files may speak of itself."""
    names = {"linorobot", folder.resolve().name}
    try:
        text = read_file(folder / "package.xml").decode("utf-8", "replace")
    except OSError:
        return names  # no package.xml: then it is one of the usual names
    found = re.search(r"<name>\s*([\w-]+)\s*</name>", text)
    return names | {found[1]} if found else names
