"""Gives back memory that a service needs only while it starts."""

import ctypes
from pathlib import Path

COMPILER = "libllvmlite"
"""LLVM, which numba reads compiled kernels with: 84 MB of code, of which a start touches 50."""
_MADV_DONTNEED = 4


def give_back() -> None:
    """Let go of the compiler's code.

    The code comes back from its file, page by page, if a kernel is compiled or read later. Only
    executable pages are let go: they are never written, so what is read again is what was there.
    """
    libc = ctypes.CDLL(None)
    for first, last in _code_of(COMPILER, Path("/proc/self/maps").read_text()):
        # Where the kernel refuses, as for locked memory, the pages stay, which does no harm.
        libc.madvise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), _MADV_DONTNEED)


def _code_of(library: str, maps: str) -> list[tuple[int, int]]:
    """The addresses at which a library's code begins and ends, from a list of mappings."""
    found: list[tuple[int, int]] = []
    for line in maps.splitlines():
        words = line.split(maxsplit=5)  # addresses, rights, offset, device, inode, file
        if len(words) == 6 and words[1] == "r-xp" and Path(words[5]).name.startswith(library):
            first, _, last = words[0].partition("-")
            found.append((int(first, 16), int(last, 16)))
    return found
