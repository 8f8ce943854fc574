"""The one way to compile a function with numba: `@kernel`.

Import this module only where kernels are: numba costs a process about 110 MB.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba  # pyright: ignore[reportMissingTypeStubs]

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call, without the GIL, with IEEE division."""
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
