"""What a release changes and refuses, and that its signature can be checked."""

import datetime
import importlib.util
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
DAY = datetime.date(2026, 12, 24)
CHANGES = "# Changelog\n\n## Unreleased\n\n- It flies.\n\n## 0.1.0 (2026-01-01)\n\n- It drives.\n"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("release", ROOT / "deploy" / "release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def git(folder: Path, *words: str) -> str:
    author = ("-c", "user.name=A", "-c", "user.email=a@example.org")
    done = subprocess.run(
        ["git", *author, *words], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone with nothing but what a release writes into."""
    folder = tmp_path / "clone"
    (folder / "common").mkdir(parents=True)
    (folder / "services" / "base").mkdir(parents=True)
    for place in (".", "common", "services/base"):
        text = (ROOT / place / "pyproject.toml").read_text("utf-8")
        (folder / place / "pyproject.toml").write_text(text)
    (folder / "CHANGELOG.md").write_text(CHANGES)
    git(folder, "init", "--quiet", "--initial-branch", "main")
    git(folder, "config", "user.name", "A")
    git(folder, "config", "user.email", "a@example.org")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "begin")
    return folder


def test_the_version_is_written_everywhere_and_nothing_else(tool: ModuleType, clone: Path) -> None:
    release = tool.Release(clone, "9.8.7")
    release.check()
    assert release.write(DAY) == "- It flies.\n"
    for place in ("common", "services/base"):
        text = (clone / place / "pyproject.toml").read_text("utf-8")
        project = tomllib.loads(text)["project"]
        assert project["version"] == "9.8.7"
        assert f"=={release.old}" not in text
        before = (ROOT / place / "pyproject.toml").read_text("utf-8")
        assert text.replace("9.8.7", release.old) == before
    changes = (clone / "CHANGELOG.md").read_text("utf-8")
    assert "## Unreleased\n\n## 9.8.7 (2026-12-24)\n\n- It flies.\n" in changes
    release.commit()
    assert git(clone, "tag", "--list") == "v9.8.7"
    assert git(clone, "status", "--porcelain") == ""
    with pytest.raises(tool.ReleaseError, match="not newer"):
        tool.Release(clone, "9.8.7").check()
    with pytest.raises(tool.ReleaseError, match="nothing under"):
        tool.Release(clone, "9.9.0").write(DAY)


def test_a_release_that_fails_changes_nothing(tool: ModuleType, clone: Path) -> None:
    release = tool.Release(clone, "9.8.7")
    release.write(DAY)
    release.take_back()
    assert git(clone, "status", "--porcelain") == ""


def test_what_is_not_committed_or_no_version_is_refused(tool: ModuleType, clone: Path) -> None:
    with pytest.raises(tool.ReleaseError, match="three numbers"):
        tool.Release(clone, "next").check()
    (clone / "CHANGELOG.md").write_text("changed\n")
    with pytest.raises(tool.ReleaseError, match="not committed"):
        tool.Release(clone, "9.8.7").check()


def test_without_a_key_nothing_is_begun(
    tool: ModuleType, clone: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(tool, "ROOT", clone)
    git(clone, "config", "user.signingkey", "")
    assert tool.main(["9.8.7"]) == 1
    assert "no key to sign with" in capsys.readouterr().err
    assert git(clone, "status", "--porcelain") == ""


def test_what_make_release_was_told_is_not_told_to_the_tests(
    tool: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / "Makefile").write_text("release:\n\t@$(RUN)\ntest:\n\t@test -z '$(ARGS)'\n")
    (tmp_path / "release.py").write_text(
        f"import importlib.util, pathlib\n"
        f"spec = importlib.util.spec_from_file_location('release', {tool.__file__!r})\n"
        f"tool = importlib.util.module_from_spec(spec)\n"
        f"spec.loader.exec_module(tool)\n"
        f"tool.run(pathlib.Path.cwd(), 'make', 'test')\n"
    )
    words = ["make", "release", f"RUN={sys.executable} release.py", "ARGS=--key FILE"]
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)


def test_anybody_can_check_the_checksums_and_their_signature(
    tool: ModuleType, tmp_path: Path
) -> None:
    for name in ("wheels", "keys"):
        (tmp_path / "out" / name).mkdir(parents=True)
    (tmp_path / "out" / "wheels" / "a-1-py3-none-any.whl").write_bytes(b"wheel")
    (tmp_path / "out" / "sbom.cdx.json").write_text("{}")
    key = tmp_path / "out" / "keys" / "key"
    words = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)]
    subprocess.run(words, check=True)
    folder = tmp_path / "release"
    listed = tool.collect(tmp_path, folder, "- It flies.\n")
    tool.sign(listed, key)
    subprocess.run(["sha256sum", "--check", "--quiet", listed.name], cwd=folder, check=True)
    allowed = tmp_path / "allowed"
    allowed.write_text(f"us {key.with_suffix('.pub').read_text('utf-8')}")
    verify = ["ssh-keygen", "-Y", "verify", "-f", str(allowed), "-I", "us", "-n", tool.NAMESPACE]
    verify += ["-s", f"{listed}.sig"]
    subprocess.run(verify, input=listed.read_bytes(), capture_output=True, check=True)
    forged = subprocess.run(verify, input=b"forged", capture_output=True, check=False)
    assert forged.returncode != 0
    with pytest.raises(tool.ReleaseError, match="cannot sign"):
        tool.sign(listed, tmp_path / "nowhere")
