"""Write a software bill of materials (CycloneDX, JSON) of an environment: `make sbom`.

python deploy/bill_of_materials.py PYTHON FILE   (where `cyclonedx-bom` is installed)

PYTHON is the interpreter of the environment: `.venv/bin/python` here, or
`/opt/trolley/current/.venv/bin/python` on a robot. Each package is listed with version, licence and
what it needs; one that only developers need has the scope `excluded`. What is written is valid by
CycloneDX's own schema, or it is not written.
"""

import importlib
import json
import subprocess
import sys
import tomllib
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
SCHEMA = "1.6"


def needed(site: Path, wanted: list[str]) -> set[str]:
    """The names of the packages in a folder that these requirements need, directly or not.

    CycloneDX's own list of what a package needs names all of its extras, too.
    """
    found = {canonicalize_name(one.name): one for one in distributions(path=[str(site)])}
    waiting = [Requirement(one) for one in wanted]
    done: set[tuple[str, str]] = set()
    while waiting:
        asked = waiting.pop()
        name = canonicalize_name(asked.name)
        new = {(name, extra) for extra in ("", *asked.extras)} - done
        done |= new
        for text in (found[name].requires or []) if name in found else []:
            requirement = Requirement(text)
            marker = requirement.marker
            if any(marker is None or marker.evaluate({"extra": extra}) for _, extra in new):
                waiting.append(requirement)
    return {name for name, _ in done}


def with_scopes(bom: dict[str, Any], required: set[str]) -> dict[str, Any]:
    """The bill with a scope for each package: `required`, or `excluded` for developers' tools."""
    components = [
        {
            **one,
            "scope": "required" if canonicalize_name(one["name"]) in required else "excluded",
        }
        for one in bom["components"]
    ]
    return {**bom, "components": components}


def _check(text: str) -> None:
    """Check a bill against the schema.

    Raises:
        ValueError: It does not conform.
    """
    # Not among Trolley's own requirements: it is installed apart, by `make sbom`.
    validation: Any = importlib.import_module("cyclonedx.validation.json")
    schema: Any = importlib.import_module("cyclonedx.schema")
    validator = validation.JsonStrictValidator(schema.SchemaVersion.from_version(SCHEMA))
    problem = validator.validate_str(text)
    if problem is not None:
        raise ValueError(f"the bill does not conform to CycloneDX {SCHEMA}: {problem}")


def main() -> None:
    """Write the bill."""
    python, file = sys.argv[1:]
    words = ["environment", python, "--pyproject", str(ROOT / "pyproject.toml")]
    words += ["--spec-version", SCHEMA, "--output-reproducible", "--output-file", "-"]
    said = subprocess.run(
        [sys.executable, "-m", "cyclonedx_py", *words], check=True, stdout=subprocess.PIPE
    )
    where = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    site = Path(subprocess.check_output(where, text=True).strip())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    bom = with_scopes(json.loads(said.stdout), needed(site, project["project"]["dependencies"]))
    text = json.dumps(bom, indent=1)
    _check(text)
    path = Path(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")
    scopes = [one["scope"] for one in bom["components"]]
    required = scopes.count("required")
    tools = len(scopes) - required
    sys.stdout.write(f"{path}: {required} packages, and {tools} for developers only\n")


if __name__ == "__main__":
    main()
