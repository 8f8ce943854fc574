"""Nothing that was saved is lost or broken, wherever the power is cut; the judge would see it."""

import shutil

import pytest
from bench.faults import power_cut
from bench.faults.power_cut import Operation, cut_everywhere, judge

PLACES = "trolley/poses.toml"
OLD, NEW = (
    b"poses = []\n",
    b"poses = [{name = 'a', map = 'm', pose = {x = 1.0, y = 2.0, yaw = 0.0}}]",
)


def saved_by(*steps: Operation) -> list[Operation]:
    """An old file that is safe, then these steps."""
    first = [
        Operation("mkdir", "trolley"),
        Operation("sync_folder", "."),
        Operation("create", PLACES, 1),
        Operation("write", PLACES, 1, 0, OLD),
        Operation("sync", PLACES, 1),
        Operation("sync_folder", "trolley"),
        Operation("mark"),
    ]
    return [*first, *steps, Operation("mark")]


NAME = ".poses.toml.x"
CREATE = Operation("create", f"trolley/{NAME}", 2)
WRITE = Operation("write", f"trolley/{NAME}", 2, 0, NEW)
SYNC = Operation("sync", f"trolley/{NAME}", 2)
RENAME = Operation("rename", f"trolley/{NAME}", 2, target=PLACES)
SYNC_FOLDER = Operation("sync_folder", "trolley")


def test_whole_files_under_new_names_are_safe() -> None:
    verdict = judge(saved_by(CREATE, WRITE, SYNC, RENAME, SYNC_FOLDER))[PLACES]
    # Before the first mark there is nothing that was promised.
    assert not [fault for fault in verdict.faults if "mark" in fault or NAME in fault]
    assert verdict.states > 10


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param((CREATE, WRITE, RENAME, SYNC_FOLDER), id="content not synced"),
        pytest.param((CREATE, WRITE, SYNC, RENAME), id="name not synced"),
        pytest.param(
            (
                Operation("truncate", PLACES, 1, 0),
                Operation("write", PLACES, 1, 0, NEW),
                Operation("sync", PLACES, 1),
            ),
            id="written over",
        ),
    ],
)
def test_the_judge_sees_what_is_not_safe(steps: tuple[Operation, ...]) -> None:
    assert judge(saved_by(*steps))[PLACES].faults


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_everything_that_trolley_saves_survives() -> None:
    num_cuts, faults = cut_everywhere()
    assert num_cuts > 500
    assert faults == []


def test_a_cut_string_of_strace_is_an_error(tmp_path) -> None:
    parser = power_cut.Parser(tmp_path, tmp_path / "marks")
    path = "".join(f"\\x{byte:02x}" for byte in str(tmp_path / "one").encode())
    parser.take(f'openat(AT_FDCWD, "{path}", O_WRONLY|O_CREAT, 0644) = 5')
    with pytest.raises(ValueError, match="cut"):
        parser.take('write(5, "\\x61\\x62"..., 300) = 300')
