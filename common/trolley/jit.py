"""The one way to compile a function with numba: `@kernel`.

Import this module only where kernels are: numba costs a process about 50 MB.

Compiled code is kept on disk, by numba's own rules for the place: `NUMBA_CACHE_DIR`, else
`__pycache__` beside the source, else the user's cache folder where the source is read-only
(and there, what an installer has compiled beside the source is still read). Only the files
themselves are ours, since numba 0.68's do not stand what services do to them: processes that
compile at the same moment can leave an index that names the wrong code, a file cut short by a
power cut raises at every later start, and a kernel is not compiled again when another kernel that
it calls, or a constant that it uses, changes in a different file.
"""

import hashlib
import importlib
import logging
import os
import pickle
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, cast

import numpy as np

from trolley.supervision import Supervision

P = ParamSpec("P")
R = TypeVar("R")

_log = logging.getLogger(__name__)
# numba ships no types; all these names are Any for the type checker.
_numba: Any = importlib.import_module("numba")
_caching: Any = importlib.import_module("numba.core.caching")
_compiler: Any = importlib.import_module("numba.core.compiler")
_events: Any = importlib.import_module("numba.core.event")
_llvm: Any = importlib.import_module("llvmlite.binding")
_memory: Any = importlib.import_module("numba.core.runtime").rtsys

_DIGEST_BYTES = 32
_EMPTY: bytes = _llvm.parse_assembly("").as_bitcode()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call with each kind of arguments, and keep the result.

    The function runs without the GIL; division by zero follows IEEE 754 (no exception).
    """
    return _compiled(function, set())


def lean_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile as `kernel` does, without counting references to arrays: for calls in inner loops.

    It must make no array, nor call a kernel that returns one. Other kernels count a reference to
    each array that they are given, and to all those of a NamedTuple, which can take several times
    as long as what they do.
    """
    return _compiled(function, set(), counts_references=False)


def loose_kernel(
    *freedoms: Literal["contract", "reassoc"],
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile as `kernel` does, with freedoms that make sums vector code.

    Args:
        freedoms: `contract`, a product may be added to without being rounded first; `reassoc`, a
            sum may be taken in any order. The same processor takes the same one each time.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        return _compiled(function, set(freedoms))

    return decorate


def _compiled(
    function: Callable[P, R], freedoms: set[str], counts_references: bool = True
) -> Callable[P, R]:
    options = {"nogil": True, "error_model": "numpy", "fastmath": freedoms}
    compiled: Any = _numba.njit(_nrt=counts_references, **options)(function)
    if not _numba.config.DISABLE_JIT:  # else numba has handed back the plain function
        _keep_on_disk(compiled)
    return cast("Callable[P, R]", compiled)


def is_kept(compiled: Callable[..., object]) -> bool | None:
    """Say whether compiled code of a kernel is on disk; None if this is not a kernel."""
    files = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    return files.has_any() if isinstance(files, KernelFiles) else None


class _Patience(_events.Listener):
    """Lets whoever started this process wait for the next kernel: all of them may take minutes."""

    def __init__(self) -> None:
        self._supervision = Supervision()

    def on_start(self, event: Any) -> None:
        del event
        self._supervision.waiting()

    on_end = on_start


def _leave_out_blas() -> None:
    """Keep numba from loading SciPy, 10 MB and 0.15 s: no kernel multiplies matrices by it."""

    def refuse() -> None:
        raise ImportError("kernels multiply no matrices by BLAS")

    linalg: Any = importlib.import_module("numba.np.linalg")
    ensure_blas, linalg.ensure_blas = linalg.ensure_blas, refuse
    importlib.import_module("numba.np.arraymath")  # it asks once, when it is imported
    linalg.ensure_blas = ensure_blas


class _OnlyRead(_caching.InTreeCacheLocator):
    """Beside the source, where nothing can be written: what an installer has compiled is there."""

    def ensure_cache_path(self) -> None:
        """Need no folder that can be written to."""


def _keep_on_disk(compiled: Any) -> None:
    """Give a dispatcher a cache on disk."""
    compiled.enable_caching()
    compiled._cache._cache_file = KernelFiles(compiled, Path(compiled._cache.cache_path))
    compiled._cache._impl.rebuild = _rebuild
    compiled._cache.load_overload = partial(_load, compiled._cache)
    compiled._cache.save_overload = partial(_save, compiled._cache)


def _load(cache: Any, signature: Any, target_context: Any) -> Any:
    """Read code from disk as numba does, but leave the library of what it can compile unread.

    Only a compiler needs that, and it asks for it by itself; where all kernels are on disk, it
    would cost each process 0.3 s and 25 MB.
    """
    _memory.initialize(target_context)  # what code that makes arrays calls
    return cache._load_overload(signature, target_context)


def _save(kept: Any, signature: Any, result: Any) -> None:
    """Write code to disk as numba does, but go on where that is not possible any more."""
    if kept._impl.check_cachable(result):
        key = kept._index_key(signature, result.codegen)
        kept._cache_file.save(key, kept._impl.reduce(result))


@cache
def _say_unkept(why: str) -> None:
    """Say once, not for each of hundreds of kernels, that they cannot be written."""
    _log.warning(
        "compiled kernels cannot be cached, so every start compiles them again (%s); set "
        "NUMBA_CACHE_DIR to a writable folder",
        why,
    )


def _rebuild(target_context: Any, payload: Any) -> Any:
    """Make read code ready to run, as numba does, but leave its intermediate form packed.

    Only a kernel that calls this one and has to be compiled itself needs that form, to inline it.
    Unpacked, the planner's kernels would hold 35 MB of it; to unpack it just for the names in it,
    as numba does, takes longer than everything else about reading a kernel.
    """
    (name, kind, (machine_code, packed)), description, *rest = payload
    names = {description.llvm_func_name, description.llvm_cpython_wrapper_name}
    target_context.codegen()._engine._defined_symbols |= names
    code = name, kind, (machine_code, _EMPTY)
    result = _compiler.CompileResult._rebuild(target_context, code, description, *rest)
    result.library._shared_module = None
    result.library._get_module_for_linking = lambda: _llvm.parse_bitcode(packed)
    return result


class KernelFiles:
    """Compiled code of one kernel on disk: a file for each kind of arguments and processor.

    The file's name holds a hash of all that the code depends on and its head a hash of its
    content, so that any number of processes may read and write without locks, and a damaged
    file counts as missing. It stands in for numba's `IndexDataCacheFile`.
    """

    def __init__(self, compiled: Any, folder: Path) -> None:
        self._compiled = compiled
        self._folder = folder
        function = compiled.py_func
        source = Path(function.__code__.co_filename)
        name = f"{source.stem}.{function.__qualname__}".replace("<locals>.", "")
        self._prefix = f"{name}.py{sys.version_info.major}{sys.version_info.minor}"
        self._read_folders = (folder, source.parent / "__pycache__")

    @cached_property
    def _version(self) -> str:
        # Computed at the first call, not at import: by then every global that the kernel
        # uses has been defined.
        return fingerprint(self._compiled)[:12]

    def _name(self, key: tuple[Any, ...]) -> str:
        return f"{self._prefix}.{self._version}.{_hash(_describe(key))[:16]}.nbc"

    def load(self, key: tuple[Any, ...]) -> Any:
        """Return what was saved under a key, or None."""
        for folder in self._read_folders:
            try:
                content = (folder / self._name(key)).read_bytes()
            except OSError:
                continue
            payload = content[_DIGEST_BYTES:]
            if hashlib.sha256(payload).digest() != content[:_DIGEST_BYTES]:
                continue
            try:
                return pickle.loads(payload)
            except (AttributeError, ImportError):
                continue  # it was made for a NamedTuple that has moved to another module since
        return None

    def save(self, key: tuple[Any, ...], data: object) -> None:
        """Keep data under a key and drop what older versions of the kernel have left."""
        payload = cast("bytes", _caching.dumps(data))
        temporary = ""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=self._folder, prefix=f"{self._prefix}.tmp.")
            with os.fdopen(handle, "wb") as file:
                os.fchmod(handle, 0o644)  # others may read what an installer has compiled
                file.write(hashlib.sha256(payload).digest() + payload)
            Path(temporary).replace(self._folder / self._name(key))
        except OSError as error:  # a full disk must not stop a robot that could compile
            if temporary:
                Path(temporary).unlink(missing_ok=True)
            _say_unkept(error.strerror or str(error))
            return
        if (
            self._compiled.py_func.__closure__
        ):  # made several times over, each with values of its own
            return
        for file in self._folder.glob(f"{self._prefix}.*.nbc"):
            if not file.name.startswith(f"{self._prefix}.{self._version}."):
                file.unlink(missing_ok=True)

    def has_any(self) -> bool:
        """Say whether anything is kept of the kernel as it is now."""
        pattern = f"{self._prefix}.{self._version}.*.nbc"
        return any(True for folder in self._read_folders for _ in folder.glob(pattern))

    def flush(self) -> None:
        """Drop all that is kept of this kernel (numba's `recompile` asks for it)."""
        for file in self._folder.glob(f"{self._prefix}.*.nbc"):
            file.unlink(missing_ok=True)


def fingerprint(compiled: Any) -> str:
    """Return a hash of all that a kernel's machine code depends on, its arguments apart.

    That is its bytecode and how it is compiled, the constants and kernels that it names, these in
    turn, numba's version and the settings of numba that change code (bounds checks, optimisation).
    """
    settings = (_numba.__version__, _numba.config.BOUNDSCHECK, _numba.config.OPT)
    parts = [repr(settings).encode()]
    parts.extend(_value_parts(compiled, set()))
    return _hash(b"\0".join(parts))


def _describe(key: tuple[Any, ...]) -> bytes:
    """Write out numba's key: argument types, processor and its features, hash of the bytecode."""
    # numba's name of a NamedTuple leaves out its module and the names of its fields.
    tuples = [
        (getattr(kind, "instance_class", None), getattr(kind, "fields", None))
        for kind in key[0]
        if hasattr(kind, "instance_class")
    ]
    return repr((key, tuples)).encode()


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _parts(function: Callable[..., object], seen: set[int]) -> Iterator[bytes]:
    """Yield the pieces that a function's machine code depends on; each function once."""
    if id(function) in seen:
        return
    seen.add(id(function))
    codes = list(_code_objects(function.__code__))
    for code in codes:
        constants = [c for c in code.co_consts if not isinstance(c, types.CodeType)]
        yield code.co_code + repr((constants, code.co_names, code.co_varnames)).encode()
    names = {name for code in codes for name in code.co_names}
    scope = {name: function.__globals__[name] for name in names if name in function.__globals__}
    for cell, name in zip(function.__closure__ or (), function.__code__.co_freevars, strict=True):
        scope[name] = cell.cell_contents
    for module in [value for value in scope.values() if isinstance(value, types.ModuleType)]:
        for name in names & vars(module).keys():
            scope[f"{module.__name__}.{name}"] = vars(module)[name]
    for name in sorted(scope):
        yield name.encode()
        yield from _value_parts(scope[name], seen)


def _code_objects(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield a code object and those nested in it (comprehensions, inner functions)."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code_objects(constant)


def _value_parts(value: object, seen: set[int]) -> Iterator[bytes]:
    """Yield what a named value adds: its content if numba freezes it into the code."""
    inner = getattr(value, "py_func", None)
    if inner is not None:
        options = cast("Any", value).targetoptions
        yield repr((sorted(options["fastmath"]), options["_nrt"])).encode()
        yield from _parts(inner, seen)
    elif isinstance(value, np.ndarray):
        array = cast("np.ndarray[Any, np.dtype[Any]]", value)
        yield repr((array.dtype, array.shape)).encode() + array.tobytes()
    elif isinstance(value, type) and hasattr(value, "_fields"):  # a NamedTuple that it makes
        yield repr((value, getattr(value, "_fields", ()))).encode()
    elif isinstance(value, (bool, int, float, complex, str, bytes, tuple, np.generic)):
        yield repr(cast("object", value)).encode()


_leave_out_blas()
_caching.CacheImpl._locator_classes.append(_OnlyRead)  # the last choice
_events.register("numba:compile", _Patience())
