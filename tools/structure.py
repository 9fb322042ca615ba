"""What the source looks like from afar: circles, imports inside packages, long functions, long lists of arguments.

python tools/structure.py [--list]
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent / "src" / "armsight"
MOST_LINES = 40
MOST_ARGUMENTS = 8
MOST_FILE_LINES = 400


@dataclass(frozen=True, slots=True)
class Function:
    """A function: where it is, its lines without the docstring, its arguments, whether all of them are annotated."""

    place: str
    lines: int
    arguments: int
    typed: bool
    kernel: bool


def main() -> int:
    """Print the figures; with --list also what stands behind them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--list", action="store_true", help="name the functions and files")
    listed = parser.parse_args().list
    imports = {module: set(imported(path, module)) for module, path in modules().items()}
    found = [function for path in ROOT.rglob("*.py") for function in functions(path)]
    long_files = [(str(p.relative_to(ROOT)), n) for p in ROOT.rglob("*.py") if (n := count_lines(p)) > MOST_FILE_LINES]
    shown: list[tuple[str, list[str]]] = [
        ("modules in circles", [" <-> ".join(circle) for circle in circles(imports)]),
        ("imports between the children of calibrate", arrows(imports, "armsight.calibrate")),
        ("imports between the children of app", arrows(imports, "armsight.app")),
        ("imports between the children of measure", arrows(imports, "armsight.measure")),
        (
            f"functions over {MOST_LINES} lines, kernels not counted",
            [f"{f.place}: {f.lines}" for f in found if f.lines > MOST_LINES and not f.kernel],
        ),
        (
            f"kernels over {MOST_LINES} lines",
            [f"{f.place}: {f.lines}" for f in found if f.lines > MOST_LINES and f.kernel],
        ),
        (
            f"functions with more than {MOST_ARGUMENTS} arguments, kernels not counted",
            [f"{f.place}: {f.arguments}" for f in found if f.arguments > MOST_ARGUMENTS and not f.kernel],
        ),
        ("functions without types, kernels not counted", [f.place for f in found if not f.typed and not f.kernel]),
        (f"files over {MOST_FILE_LINES} lines", [f"{name}: {n}" for name, n in long_files]),
    ]
    for what, items in shown:
        print(f"{what}: {len(items)}")
        for item in sorted(items) if listed else ():
            print(f"    {item}")
    return 0


def modules() -> dict[str, Path]:
    """Return all modules by dotted name."""
    out = {}
    for path in ROOT.rglob("*.py"):
        parts = ["armsight", *path.relative_to(ROOT).with_suffix("").parts]
        out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


def imported(path: Path, module: str) -> Iterator[str]:
    """Yield the modules of this package that a file imports while it is loaded, those for type checkers left out."""
    known = modules()
    for node in _running(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("armsight"):
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                target = name if name in known else str(node.module)
                if target != module:
                    yield target


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _running(node)


def arrows(imports: dict[str, set[str]], package: str) -> list[str]:
    """Return which children of a package import which others."""

    def child(module: str) -> str | None:
        rest = module.removeprefix(package + ".")
        return None if rest == module else rest.split(".")[0]

    found = {(child(a), child(b)) for a, targets in imports.items() for b in targets}
    return [f"{a} -> {b}" for a, b in found if a and b and a != b]


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected groups of more than one module (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    out: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for target in imports.get(module, ()):
            if target not in index:
                visit(target)
            if target in stack:
                low[module] = min(low[module], low[target])
        if low[module] == index[module]:
            at = stack.index(module)
            group = stack[at:]
            del stack[at:]
            if len(group) > 1:
                out.append(sorted(group))

    for module in imports:
        if module not in index:
            visit(module)
    return out


def functions(path: Path) -> Iterator[Function]:
    """Yield every function of a file."""
    kernel_file = "kernels" in path.parts or path.stem == "kernels"
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        a = node.args
        every = [*a.posonlyargs, *a.args, *a.kwonlyargs]
        own = [arg for arg in every if arg.arg not in ("self", "cls")]
        told = ast.get_docstring(node, clean=False)
        yield Function(
            place=f"{path.relative_to(ROOT)}:{node.name}",
            lines=(node.end_lineno or node.lineno) - node.lineno + 1 - (told.count("\n") + 1 if told else 0),
            arguments=len(own),
            typed=all(arg.annotation for arg in own) and (node.returns is not None),
            kernel=kernel_file,
        )


def count_lines(path: Path) -> int:
    """Return the number of lines of a file."""
    return path.read_text(encoding="utf-8").count("\n")


if __name__ == "__main__":
    sys.exit(main())
