"""The power fails at every write point of the state files: what is on the disk afterwards?

    python -m bench.faults.power_cut

All services run in lock-step and save what they save: places, tours, zones, the stop latch, robot
time, the last pose, the chosen map, a trip, the history, the viewer's settings, a map. `strace`
records every system call with which they touch the state folder. Then the power is cut after
each of these calls, in each of the ways in which a disk may keep or lose what was not yet synced,
and Trolley's own readers read what is left. Each file must hold what was last saved, or what was
just being saved, and nothing else.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from bench.faults.power_cut_readers import HISTORY, Reading, check_all_is_read, read_all
from bench.harness.figures import table
from bench.harness.paths import ROOT

CALLS = (
    "open,openat,creat,write,pwrite64,writev,pwritev,lseek,fsync,fdatasync,close,rename,renameat,"
    "renameat2,unlink,unlinkat,truncate,ftruncate,mkdir,mkdirat,rmdir,dup,dup2,dup3"
)
LONGEST_STRING = 64 << 20
_CALL = re.compile(r"(?P<name>\w+)\((?P<args>.*)\)\s+= (?P<result>-?\d+)")
_STRING = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')


@dataclass(frozen=True)
class Operation:
    """One change of the disk, or one sync.

    Attributes:
        kind: create, write, truncate, sync, rename, unlink, mkdir, rmdir, sync_folder, mark.
        path: what it is about, relative to the state folder.
        inode: of the file.
        offset: where it writes, or the new size.
        data: what it writes.
        target: the new name.
    """

    kind: str
    path: str = ""
    inode: int = -1
    offset: int = 0
    data: bytes = b""
    target: str = ""


@dataclass
class _Handle:
    path: str
    inode: int
    offset: int = 0
    appends: bool = False
    is_folder: bool = False


class Parser:
    """Turns strace's lines into operations on the state folder."""

    def __init__(self, root: Path, marks: Path) -> None:
        self._root, self._marks = str(root), str(marks)
        self._handles: dict[int, _Handle] = {}
        self._names: dict[str, int] = {}
        self._sizes: dict[int, int] = {}
        self._num_inodes = 0
        self.operations: list[Operation] = []

    def take(self, line: str) -> None:
        """Take a line."""
        found = _CALL.match(line)
        if found is None or int(found["result"]) < 0:
            return
        name, args, result = found["name"], found["args"], int(found["result"])
        strings = [bytes.fromhex(text.replace("\\x", "")) for text in _STRING.findall(args)]
        if name in ("open", "openat", "creat"):
            self._open(strings[0].decode(), args, name, result)
        elif name in ("rename", "renameat", "renameat2"):
            self._rename(strings[0].decode(), strings[1].decode())
        elif name in ("unlink", "unlinkat", "rmdir"):
            self._remove(strings[0].decode(), "rmdir" if "AT_REMOVEDIR" in args else name)
        elif name in ("mkdir", "mkdirat"):
            self._make_folder(strings[0].decode())
        elif name == "truncate":
            raise NotImplementedError(line[:200])
        elif args.partition(",")[0].isdigit():
            self._use(int(args.partition(",")[0]), name, args, strings, result)

    def _inside(self, path: str) -> str | None:
        if not path.startswith("/"):
            path = str(Path.cwd() / path)
        is_ours = path == self._root or path.startswith(self._root + "/")
        return str(PurePosixPath(path).relative_to(self._root)) if is_ours else None

    def _do(self, operation: Operation) -> None:
        self.operations.append(operation)

    def _open(self, path: str, args: str, name: str, handle: int) -> None:
        self._handles.pop(handle, None)
        inside = self._inside(path)
        if inside is None:
            return
        if "O_DIRECTORY" in args or (Path(path).is_dir() and inside not in self._names):
            self._handles[handle] = _Handle(inside, -1, is_folder=True)
            return
        if inside not in self._names:
            self._num_inodes += 1
            self._names[inside], self._sizes[self._num_inodes] = self._num_inodes, 0
            self._do(Operation("create", inside, self._num_inodes))
        inode = self._names[inside]
        if "O_TRUNC" in args or name == "creat":
            self._sizes[inode] = 0
            self._do(Operation("truncate", inside, inode, 0))
        self._handles[handle] = _Handle(inside, inode, appends="O_APPEND" in args)

    def _use(self, number: int, name: str, args: str, strings: list[bytes], result: int) -> None:
        handle = self._handles.get(number)
        if handle is None:
            return
        if name == "close":
            del self._handles[number]
        elif name in ("fsync", "fdatasync"):
            if handle.is_folder:
                self._do(Operation("sync_folder", handle.path))
            else:
                self._do(Operation("sync", handle.path, handle.inode))
        elif name == "lseek":
            handle.offset = result
        elif name == "ftruncate":
            size = int(args.rpartition(",")[2])
            self._sizes[handle.inode] = size
            self._do(Operation("truncate", handle.path, handle.inode, size))
        elif name in ("write", "pwrite64"):
            at = int(args.rpartition(",")[2]) if name == "pwrite64" else handle.offset
            at = self._sizes[handle.inode] if handle.appends else at
            data = strings[0][:result]
            if len(data) != result:
                raise ValueError("strace has cut a string")
            if name == "write":
                handle.offset = at + result
            self._sizes[handle.inode] = max(self._sizes[handle.inode], at + result)
            self._do(Operation("write", handle.path, handle.inode, at, data))
        else:
            raise NotImplementedError(f"{name} on {handle.path}")

    def _rename(self, old: str, new: str) -> None:
        inside, target = self._inside(old), self._inside(new)
        if inside is None or target is None:
            return
        self._names[target] = self._names.pop(inside)
        self._do(Operation("rename", inside, self._names[target], target=target))

    def _remove(self, path: str, name: str) -> None:
        inside = self._inside(path)
        if inside is None:
            return
        if name == "rmdir":
            self._do(Operation("rmdir", inside))
        else:
            self._do(Operation("unlink", inside, self._names.pop(inside)))

    def _make_folder(self, path: str) -> None:
        if path.startswith(self._marks + "/"):
            self._do(Operation("mark", path.rpartition("/")[2]))
        elif (inside := self._inside(path)) is not None:
            self._do(Operation("mkdir", inside))


@dataclass
class Disk:
    """Names and contents."""

    names: dict[str, int] = field(default_factory=dict)
    folders: set[str] = field(default_factory=set)
    data: dict[int, bytes] = field(default_factory=dict)

    def change_names(self, operation: Operation) -> None:
        """Do to the names what an operation does; one whose ground is missing does nothing."""
        match operation.kind:
            case "create":
                self.names[operation.path] = operation.inode
            case "rename" if operation.path in self.names:
                self.names[operation.target] = self.names.pop(operation.path)
            case "unlink":
                self.names.pop(operation.path, None)
            case "mkdir":
                self.folders.add(operation.path)
            case "rmdir":
                self.folders.discard(operation.path)
            case _:
                pass

    def change_data(self, operation: Operation, share: float = 1.0) -> None:
        """Do to the contents what an operation does, or only the first part of a write."""
        old = self.data.get(operation.inode, b"")
        if operation.kind == "write":
            data = operation.data[: int(len(operation.data) * share)]
            head = old[: operation.offset].ljust(operation.offset, b"\0")
            self.data[operation.inode] = head + data + old[operation.offset + len(data) :]
        elif operation.kind == "truncate":
            self.data[operation.inode] = old[: operation.offset].ljust(operation.offset, b"\0")

    def put_into(self, folder: Path) -> None:
        """Write it into an empty folder."""
        for name in sorted(self.folders):
            (folder / name).mkdir(parents=True, exist_ok=True)
        for name, inode in self.names.items():
            path = folder / name
            if path.parent.is_dir():  # a folder that was lost takes along what lay in it
                path.write_bytes(self.data.get(inode, b""))


_OF_NAMES = ("create", "rename", "unlink", "mkdir", "rmdir")


def _folders_touched(operation: Operation) -> set[str]:
    paths = [path for path in (operation.path, operation.target) if path]
    return {str(PurePosixPath(path).parent) for path in paths}


def crash_states(done: list[Operation]) -> Iterator[tuple[str, Disk]]:
    """All disks that may be found after these operations and a cut of the power."""
    pending, unsynced = _not_synced(done)

    def disk(lost_names: set[int], lost_data: set[int], torn: int | None = None) -> Disk:
        found = Disk()
        for index, operation in enumerate(done):
            if index not in lost_names:
                found.change_names(operation)
            if index not in lost_data:
                found.change_data(operation, 0.5 if index == torn else 1.0)
        return found

    yield "killed: nothing is lost", disk(set(), set())
    if unsynced:
        yield "the last write is torn", disk(set(), set(), unsynced[-1])
        yield "data lost, names kept", disk(set(), set(unsynced))
        yield "data torn, names kept", disk(set(), set(unsynced[:-1]), unsynced[-1])
    if unsynced or pending:
        yield "all that was not synced is lost", disk(set(pending), set(unsynced))
    for count, index in enumerate(pending):
        yield "names lost from one on", disk(set(pending[count:]), set())
        yield "one name lost", disk({index}, set())


def _not_synced(done: list[Operation]) -> tuple[list[int], list[int]]:
    """The changes of names, and of contents, that a cut of the power may undo."""
    synced: dict[int, int] = {}
    pending: list[int] = []
    for index, operation in enumerate(done):
        if operation.kind == "sync":
            synced[operation.inode] = index
        elif operation.kind == "sync_folder":
            pending = [one for one in pending if operation.path not in _folders_touched(done[one])]
        elif operation.kind in _OF_NAMES:
            pending.append(index)
    unsynced = [
        index
        for index, operation in enumerate(done)
        if operation.kind in ("write", "truncate") and index > synced.get(operation.inode, -1)
    ]
    return pending, unsynced


@dataclass
class Verdict:
    """The fate of one file."""

    writes: int = 0
    states: int = 0
    faults: list[str] = field(default_factory=list)


def judge(operations: list[Operation]) -> dict[str, Verdict]:
    """Cut the power everywhere, and read."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        readings = _KernelViews(operations, Path(name))
        verdicts: dict[str, Verdict] = {what: Verdict() for what in [*readings.whats, HISTORY]}
        for count in range(1, len(operations) + 1):
            allowed, least, most = readings.allowed(count)
            for how, disk in crash_states(operations[:count]):
                found = _read(disk, Path(name))
                last = operations[count - 1]
                where = f"after {last.kind} {last.path}, {how}"
                for what, verdict in verdicts.items():
                    verdict.states += 1
                    if what == HISTORY:
                        continue
                    value = found.values.get(what)
                    if what in found.broken or value not in allowed[what]:
                        verdict.faults.append(f"{where}: {found.broken.get(what, value)!s:.150}")
                history = verdicts[HISTORY]
                if found.history_problem or not least <= found.trips <= most:
                    history.faults.append(f"{where}: {found.history_problem or found.trips}")
        for operation in operations:
            for what, verdict in verdicts.items():
                if operation.kind in ("rename", "write") and what in (
                    operation.target,
                    operation.path,
                ):
                    verdict.writes += 1
    return verdicts


def _read(disk: Disk, folder: Path) -> Reading:
    where = folder / "disk"
    where.mkdir()
    try:
        disk.put_into(where)
        return read_all(where)
    finally:
        shutil.rmtree(where)


class _KernelViews:
    """What each file held after each operation, had the power stayed."""

    def __init__(self, operations: list[Operation], folder: Path) -> None:
        disk = Disk()
        self._readings: list[Reading] = [_read(disk, folder)]
        self._marks = [0]
        for count, operation in enumerate(operations, 1):
            disk.change_names(operation)
            disk.change_data(operation)
            if operation.kind == "mark":
                self._marks.append(count)
            self._readings.append(_read(disk, folder))
        self._marks.append(len(operations))
        self.whats = sorted({what for reading in self._readings for what in reading.values})

    def allowed(self, count: int) -> tuple[dict[str, list[object]], frozenset[str], frozenset[str]]:
        """What may be found after `count` operations, and the least and most of the history."""
        since = max(mark for mark in self._marks if mark <= count)
        until = min(mark for mark in self._marks if mark >= count)
        views = [reading for reading in self._readings[since : count + 1] if reading is not None]
        values: dict[str, list[object]] = {
            what: [view.values.get(what) for view in views if what not in view.broken]
            for what in self.whats
        }
        return values, self._readings[since].trips, self._readings[until].trips


def record(folder: Path) -> list[Operation]:
    """Run the services under strace; the operations on their state folder."""
    state, marks, log = folder / "state", folder / "marks", folder / "strace.log"
    state.mkdir()
    marks.mkdir()
    command = ["strace", "-e", f"trace={CALLS}", "-xx", "-s", str(LONGEST_STRING), "-o", str(log)]
    program = [sys.executable, "-m", "bench.faults.power_cut_run", str(state), str(marks)]
    subprocess.run([*command, *program], cwd=ROOT, check=True)
    parser = Parser(state, marks)
    with log.open(encoding="ascii") as lines:
        for line in lines:
            parser.take(line)
    check_all_is_read(state)
    return parser.operations


def cut_everywhere() -> tuple[int, list[str]]:
    """How many disks were looked at, and what was lost or broken on them."""
    if shutil.which("strace") is None:
        return 0, []
    with tempfile.TemporaryDirectory() as folder:
        verdicts = judge(record(Path(folder)))
    faults = [f"{what}: {fault}" for what, one in verdicts.items() for fault in one.faults]
    return max(one.states for one in verdicts.values()), faults


def main() -> int:
    """Record, cut, print; 1 where something was lost."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--show", type=int, default=3, metavar="N", help="faults shown per file")
    options = parser.parse_args()
    if shutil.which("strace") is None:
        print("skipped: strace is not installed (apt-get install strace)")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        operations = record(Path(folder))
    verdicts = judge(operations)
    print(f"{len(operations)} operations")
    rows = [
        [what, str(one.writes), str(one.states), str(len(one.faults))]
        for what, one in verdicts.items()
    ]
    table(["file", "saved", "cuts", "lost or broken"], rows)
    for what, one in verdicts.items():
        for fault in one.faults[: options.show]:
            print(f"{what}: {fault}")
    return 1 if any(one.faults for one in verdicts.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
