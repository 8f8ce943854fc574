"""Rules for the files that the repository keeps."""

import re
import tomllib
from pathlib import Path

# Where packages come from is the business of each machine. In parts, so as not to name them here.
REGISTRY_HOSTS = [
    ".".join(parts)
    for parts in [
        ("pypi", "org"),
        ("pythonhosted", "org"),
        ("piwheels", "org"),
        ("conda", "anaconda", "org"),
        ("registry", "npmjs", "org"),
        ("registry", "yarnpkg", "com"),
        ("deb", "debian", "org"),
        ("security", "debian", "org"),
        ("archive", "ubuntu", "com"),
        ("ports", "ubuntu", "com"),
        ("archive", "raspberrypi", "com"),
    ]
]
MAX_BYTES = 2 * 1024 * 1024


def requirement_names(requirements: list[str]) -> set[str]:
    """The distribution names of requirement strings, lower case."""
    found = (re.match(r"[A-Za-z0-9_.-]+", requirement) for requirement in requirements)
    return {match.group().lower() for match in found if match}


def test_no_file_names_a_package_registry(repository_files: list[Path], root: Path) -> None:
    named = [
        f"{path.relative_to(root)}: {host}"
        for path in repository_files
        for content in [path.read_bytes().lower()]
        for host in REGISTRY_HOSTS
        if host.encode() in content
    ]
    assert named == []


def test_no_file_is_large(repository_files: list[Path], root: Path) -> None:
    sizes = {str(path.relative_to(root)): path.stat().st_size for path in repository_files}
    assert {path: size for path, size in sizes.items() if size > MAX_BYTES} == {}


def test_lock_pins_and_hashes_everything(root: Path) -> None:
    text = (root / "requirements.lock").read_text(encoding="utf-8")
    for entry in re.split(r"\n(?! )", text.strip()):
        assert re.match(r"[a-z0-9._-]+==\S+", entry), entry.splitlines()[0]
        assert "--hash=sha256:" in entry, entry.splitlines()[0]


def test_lock_knows_every_dependency(root: Path) -> None:
    locked = requirement_names((root / "requirements.lock").read_text("utf-8").splitlines())
    wanted: set[str] = set()
    for path in [
        root / "pyproject.toml",
        *root.glob("*/pyproject.toml"),
        *root.glob("services/*/pyproject.toml"),
    ]:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        wanted |= requirement_names(table["project"]["dependencies"])
        for extra in table["project"].get("optional-dependencies", {}).values():
            wanted |= requirement_names(extra)
        for group in table.get("dependency-groups", {}).values():
            wanted |= requirement_names(group)
        wanted |= requirement_names(table.get("build-system", {}).get("requires", []))
    own = {name for name in wanted if name == "trolley" or name.startswith("trolley-")}
    assert wanted - own <= locked
