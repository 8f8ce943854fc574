"""Make a release of all packages, signed, in out/release: `make release VERSION=0.2.0`.

python deploy/release.py VERSION [--key FILE]

It writes the version into every pyproject.toml and the changes since the last release under it in
CHANGELOG.md, runs the whole check, builds the wheels and the bill of materials, lists their
checksums and signs that list with an SSH key (the one that git signs with, unless named). Only then
it commits and tags; where anything fails, the files are as they were. It publishes nothing.
"""

import argparse
import datetime
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHANGES = "CHANGELOG.md"
UNRELEASED = "## Unreleased\n"
CHECKSUMS = "SHA256SUMS"
TOLD_BY_MAKE = ("ARGS", "VERSION", "MAKEFLAGS", "MAKEOVERRIDES", "MFLAGS")
NAMESPACE = "trolley-release"
"""What the signature is for: one of another namespace does not count."""


class ReleaseError(Exception):
    """Nothing was released; the text says why and what to do."""


def parse_version(text: str) -> tuple[int, int, int]:
    """The numbers of a version such as 0.2.0.

    Raises:
        ReleaseError: It is written in another way.
    """
    match = re.fullmatch(r"(\d+)\.(\d+)\.(\d+)", text)
    if match is None:
        raise ReleaseError(f"{text} is no version: write three numbers, such as 0.2.0")
    return int(match[1]), int(match[2]), int(match[3])


def with_version(pyproject: str, old: str, new: str) -> str:
    """A pyproject.toml with its own version and those of Trolley's other packages replaced."""
    own = re.compile(rf'^version = "{re.escape(old)}"$', re.MULTILINE)
    pin = re.compile(rf'("trolley-robot[^"=]*==){re.escape(old)}"')
    return pin.sub(rf'\g<1>{new}"', own.sub(f'version = "{new}"', pyproject))


def with_release(changes: str, version: str, day: datetime.date) -> tuple[str, str]:
    """The changelog with what is unreleased under a version; and that part, as release notes.

    Raises:
        ReleaseError: Nothing is unreleased.
    """
    before, found, after = changes.partition(UNRELEASED)
    notes = re.split(r"^## ", after, maxsplit=1, flags=re.MULTILINE)[0].strip()
    if not found or not notes:
        raise ReleaseError(f"{CHANGES} has nothing under “Unreleased”: there is nothing to release")
    title = f"## {version} ({day.isoformat()})\n"
    return f"{before}{UNRELEASED}\n{title}{after}", f"{notes}\n"


def checksums(folder: Path) -> str:
    """The files of a folder as `sha256sum --check` reads them."""
    files = sorted(one for one in folder.iterdir() if one.is_file())
    return "".join(f"{hashlib.sha256(one.read_bytes()).hexdigest()}  {one.name}\n" for one in files)


class Release:
    """The steps of a release in a clone.

    Args:
        root: the clone's folder.
        version: the new one.
    """

    def __init__(self, root: Path, version: str) -> None:
        self._root = root
        self.version = version
        self._files = [
            root / "pyproject.toml",
            root / "common" / "pyproject.toml",
            *sorted(root.glob("services/*/pyproject.toml")),
            root / CHANGES,
        ]
        found = re.search(r'^version = "(.*)"$', self._files[0].read_text("utf-8"), re.MULTILINE)
        assert found is not None
        self.old = found[1]

    def check(self) -> None:
        """Whether a release can be made here.

        Raises:
            ReleaseError: It cannot.
        """
        if parse_version(self.version) <= parse_version(self.old):
            raise ReleaseError(f"{self.version} is not newer than {self.old}, which stands here")
        if self._git("status", "--porcelain"):
            raise ReleaseError("there are changes that are not committed: commit them first")
        if self._git("tag", "--list", self.tag):
            raise ReleaseError(f"there is a tag {self.tag} already")

    @property
    def tag(self) -> str:
        """The tag's name."""
        return f"v{self.version}"

    def write(self, day: datetime.date) -> str:
        """Write the version everywhere; return the release notes."""
        changes, notes = with_release((self._root / CHANGES).read_text("utf-8"), self.version, day)
        for path in self._files:
            text = path.read_text("utf-8")
            new = changes if path.name == CHANGES else with_version(text, self.old, self.version)
            path.write_text(new, "utf-8")
        return notes

    def take_back(self) -> None:
        """Make the files what they were."""
        self._git("checkout", "--", *map(str, self._files))

    def commit(self) -> None:
        """Commit and tag: signed where git has a key to sign with."""
        self._git("commit", "--all", "--message", f"Release {self.version}")
        has_key = bool(self._git("config", "--default", "", "user.signingkey"))
        how = "--sign" if has_key else "--annotate"
        self._git("tag", how, self.tag, "--message", f"Trolley {self.version}")

    def signing_key(self) -> Path:
        """The SSH key that git signs with here.

        Raises:
            ReleaseError: It has none.
        """
        named = self._git("config", "--default", "", "user.signingkey")
        if not named or self._git("config", "--default", "", "gpg.format") != "ssh":
            raise ReleaseError(
                "there is no key to sign with: name one with --key, or let git sign with one "
                "(git config gpg.format ssh, git config user.signingkey FILE)"
            )
        return Path(named).expanduser()

    def _git(self, *words: str) -> str:
        done = subprocess.run(
            ["git", *words], cwd=self._root, capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise ReleaseError(f"git {words[0]} failed: {done.stderr.strip()}")
        return done.stdout.strip()


def sign(file: Path, key: Path) -> None:
    """Write a signature of a file beside it.

    Raises:
        ReleaseError: The key cannot sign.
    """
    words = ["ssh-keygen", "-Y", "sign", "-n", NAMESPACE, "-f", str(key), str(file)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"{key} cannot sign: {done.stderr.strip()}")


def run(root: Path, *words: str) -> None:
    """Run a program that says by itself how it goes.

    What `make release` was told is none of its business: `make test` would take ARGS for its own.

    Raises:
        ReleaseError: It failed.
    """
    own = {name: value for name, value in os.environ.items() if name not in TOLD_BY_MAKE}
    if subprocess.run(words, cwd=root, env=own, check=False).returncode != 0:
        raise ReleaseError(f"`{' '.join(words)}` failed")


def collect(root: Path, folder: Path, notes: str) -> Path:
    """Gather what is published in a folder; return the list of its checksums."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for wheel in sorted((root / "out" / "wheels").glob("*.whl")):
        shutil.copy(wheel, folder)
    shutil.copy(root / "out" / "sbom.cdx.json", folder)
    (folder / "NOTES.md").write_text(notes, "utf-8")
    listed = folder / CHECKSUMS
    listed.write_text(checksums(folder), "utf-8")
    return listed


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the release; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("version")
    parser.add_argument("--key", type=Path, help="the SSH key to sign with; else that of git")
    options = parser.parse_args(arguments)
    try:
        release = Release(ROOT, options.version)
        release.check()
        key = options.key or release.signing_key()
        notes = release.write(datetime.datetime.now(datetime.UTC).date())
        try:
            run(ROOT, "make", "setup")
            run(ROOT, "bash", ".ci/run")
            run(ROOT, "make", "wheels", "sbom")
            listed = collect(ROOT, ROOT / "out" / "release", notes)
            sign(listed, key)
        except BaseException:
            release.take_back()
            raise
        release.commit()
    except ReleaseError as problem:
        sys.stderr.write(f"Nothing was released: {problem}.\n")
        return 1
    sys.stdout.write(
        f"{release.tag} is tagged; what is to be published is in out/release.\n"
        f"Look at it, then: git push origin main {release.tag}\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
