"""Rules for the code of the packages that the linter has no word for."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .conftest import Source

RUNTIME = Path("common/trolley/runtime")
BROAD = {"Exception", "BaseException"}
VAGUE_NAMES = {"utils", "util", "helpers", "helper", "misc"}

# The tables that keys are built from, and the runtime that builds them.
KEY_PLACES = {Path("common/trolley/topics.py"), Path("common/trolley/requests.py")}


def caught(handler: ast.ExceptHandler) -> Iterator[str]:
    """The names in an `except` clause; a bare one counts as BaseException."""
    if handler.type is None:
        yield "BaseException"
        return
    for node in handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]:
        if isinstance(node, ast.Name):
            yield node.id


# Runs drivers of other packages, which may raise anything.
FOREIGN_CODE = Path("common/trolley/drivers.py")


def test_only_the_runtime_and_what_runs_foreign_drivers_catch_everything(
    sources: list["Source"],
) -> None:
    places = [
        f"{source.path}:{node.lineno}"
        for source in sources
        if RUNTIME not in source.path.parents and source.path != FOREIGN_CODE
        for node in source.nodes(ast.ExceptHandler)
        if BROAD.intersection(caught(node))
    ]
    assert places == []


def test_no_key_is_built_by_hand(sources: list["Source"]) -> None:
    places = [
        f"{source.path}:{node.lineno}"
        for source in sources
        if source.path not in KEY_PLACES and RUNTIME not in source.path.parents
        # The literal parts of an f-string are constants too.
        for node in source.nodes(ast.Constant)
        if isinstance(node.value, str) and node.value.startswith("trolley/")
    ]
    assert places == []


def test_modules_say_what_they_hold(sources: list["Source"]) -> None:
    vague = [
        str(source.path)
        for source in sources
        if VAGUE_NAMES.intersection(source.path.with_suffix("").parts)
    ]
    assert vague == []


# Where text goes to a terminal: both make it fit first. `trial` and `warmup` talk to a program.
PRINTING_PLACES = {
    Path("common/trolley/cli/printing.py"),
    Path("common/trolley/runtime/process.py"),
    Path("common/trolley/start.py"),
    Path("common/trolley/doctor/trial.py"),
    Path("common/trolley/warmup.py"),
}
PRINTING = {
    "click": {"echo", "secho", "echo_via_pager"},
    "stdout": {"write", "writelines"},
    "stderr": {"write", "writelines"},
}


def prints(node: ast.Call | ast.Attribute) -> bool:
    """Whether a node prints, or is the name of what prints."""
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "print"
    owner = node.value
    name = owner.id if isinstance(owner, ast.Name) else getattr(owner, "attr", "")
    return node.attr in PRINTING.get(name, ())


def test_all_text_is_printed_in_one_place(sources: list["Source"]) -> None:
    """Names and sentences come from strangers: what prints them must make them harmless."""
    places = [
        f"{source.path}:{node.lineno}"
        for source in sources
        if source.path not in PRINTING_PLACES
        for node in (*source.nodes(ast.Call), *source.nodes(ast.Attribute))
        if prints(node)
    ]
    assert places == []


def names_in(*nodes: ast.AST | None) -> set[str]:
    """The names that stand in some pieces of code, decorators and annotations among them."""
    return {
        name.id
        for node in nodes
        if node is not None
        for name in ast.walk(node)
        if isinstance(name, ast.Name)
    }


def with_arrays(sources: list["Source"]) -> set[str]:
    """The names of types that are arrays or have fields with arrays."""
    fields = {
        node.name: names_in(*(f.annotation for f in node.body if isinstance(f, ast.AnnAssign)))
        for source in sources
        for node in source.nodes(ast.ClassDef)
    }
    found = {"NDArray"}
    while more := {name for name, types in fields.items() if types & found} - found:
        found |= more
    return found


def test_lean_kernels_compile_whatever_was_compiled_before(sources: list["Source"]) -> None:
    # numba finds an array's extremes by an iterator that counts references: a lean kernel can be
    # compiled with it only where another kernel was before it, in the same process.
    wrong = [
        f"{kernel.name}: {ast.unparse(call.func)}"
        for source in sources
        for kernel in source.nodes(ast.FunctionDef)
        if "lean_kernel" in names_in(*kernel.decorator_list)
        for call in ast.walk(kernel)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)
        if call.func.attr in {"min", "max", "argmin", "argmax"}
    ]
    assert wrong == []


def test_lean_kernels_are_given_no_array_by_what_they_call(sources: list["Source"]) -> None:
    # They count no references, so nobody would ever free it; numba refuses only arrays that a
    # lean kernel makes itself.
    functions = [node for source in sources for node in source.nodes(ast.FunctionDef)]
    kernels = [f for f in functions if names_in(*f.decorator_list) & {"kernel", "lean_kernel"}]
    arrays = with_arrays(sources)
    givers = {kernel.name for kernel in kernels if names_in(kernel.returns) & arrays}
    wrong = [
        f"{kernel.name} calls {call.func.id}"
        for kernel in kernels
        if "lean_kernel" in names_in(*kernel.decorator_list)
        for call in ast.walk(kernel)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
        if call.func.id in givers
    ]
    assert givers
    assert wrong == []
