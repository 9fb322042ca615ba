"""What the source looks like from afar, and whether it keeps its limits: circles, long functions, many arguments.

python tools/structure.py [--list]

Exits 1 where something is over a limit and not among EXCEPTIONS, or where an exception is no longer needed.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent / "src" / "armsight"
MOST_LINES = 40
MOST_ARGUMENTS = 8
MOST_FILE_LINES = 400

FLAGS = "a command: each of its flags is an argument, with a line or more of help"
COMPILED = (
    "compiled: an object would have to be taken apart and put together at every call, so that kernels take its arrays"
)
LOOPS = "compiled: one loop over pixels, rays or steps; parted, its state would go through long lists of arguments"

EXCEPTIONS: Mapping[str, Mapping[str, str]] = {
    "long": {
        "api/motion.py:teach": FLAGS,
        "cli/serve.py:serve": FLAGS,
        "cli/verify.py:verify": FLAGS,
    },
    "arguments": {
        "api/*": FLAGS,
        "cli/serve.py:console": FLAGS,
        "cli/kinematics.py:ik": FLAGS,
        "cli/kinematics.py:path": FLAGS,
        "cli/path.py:check": FLAGS,
        "cli/serve.py:serve": FLAGS,
        "cli/verify.py:verify": FLAGS,
    },
    "long kernels": {"*": LOOPS},
    "kernels' arguments": {"*": COMPILED},
    "files": {
        "measure/spots/kernels/detection/scan.py": "thresholds and connected components of one pass over an image",
        "measure/spots/kernels/fitting/measure_areas.py": "all that is done to one list of areas, in its order",
        "sim/rooms/kernels.py": "rays and light of one scene, which is one tuple of arrays for all of them",
    },
}
"""What may be over a limit, by the limit's key: place (a pattern) -> reason. Every one of them is printed."""


@dataclass(frozen=True, slots=True)
class Function:
    """A function: where it is, its lines without the docstring, its arguments, whether all of them are annotated."""

    place: str
    lines: int
    arguments: int
    typed: bool
    kernel: bool


@dataclass(frozen=True, slots=True)
class Figure:
    """One line of the result: what is counted, and each place with what is to be said of it.

    key: of EXCEPTIONS; none where the number is only told, not limited.
    """

    what: str
    items: Sequence[tuple[str, str]]
    key: str = ""
    exceptions: Mapping[str, str] = field(default_factory=dict)

    def unlisted(self) -> list[str]:
        """Return what is over the limit and no exception, and the exceptions that nothing needs."""
        if not self.key:
            return []
        places = [place for place, _ in self.items]
        over = [f"{place}: {more}" for place, more in self.items if not self.reasons(place)]
        idle = [pattern for pattern in self.exceptions if not any(fnmatch(place, pattern) for place in places)]
        return over + [f"{pattern}: no exception is needed any more" for pattern in idle]

    def reasons(self, place: str) -> list[str]:
        """Return why a place may be over the limit."""
        return [reason for pattern, reason in self.exceptions.items() if fnmatch(place, pattern)]


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Print the figures and the exceptions with their reasons; with --list also all that stands behind them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--list", action="store_true", help="name the functions and files")
    listed = parser.parse_args(arguments).list
    wrong: list[str] = []
    for figure in figures(root):
        print(f"{figure.what}: {len(figure.items)}")
        for place, more in sorted(figure.items) if listed else ():
            print(f"    {place}: {more}" if more else f"    {place}")
        reasons = dict.fromkeys(reason for place, _ in figure.items for reason in figure.reasons(place))
        for reason in reasons:
            print(f"    {sum(reason in figure.reasons(place) for place, _ in figure.items)} by exception: {reason}")
        wrong += [f"{figure.what}: {text}" for text in figure.unlisted()]
    for text in wrong:
        print(f"not in order: {text}", file=sys.stderr)
    return 1 if wrong else 0


def figures(root: Path, exceptions: Mapping[str, Mapping[str, str]] | None = None) -> list[Figure]:
    """Return all that is counted in the package at root."""
    exceptions = EXCEPTIONS if exceptions is None else exceptions
    imports = {module: set(imported(root, path, module)) for module, path in modules(root).items()}
    found = [function for path in root.rglob("*.py") for function in functions(root, path)]
    plain, kernels = [f for f in found if not f.kernel], [f for f in found if f.kernel]
    files = [(str(path.relative_to(root)), count_lines(path)) for path in root.rglob("*.py")]

    def long(some: Sequence[Function]) -> list[tuple[str, str]]:
        return [(f.place, f"{f.lines} lines") for f in some if f.lines > MOST_LINES]

    def wide(some: Sequence[Function]) -> list[tuple[str, str]]:
        return [(f.place, f"{f.arguments} arguments") for f in some if f.arguments > MOST_ARGUMENTS]

    def figure(what: str, key: str, items: Sequence[tuple[str, str]]) -> Figure:
        return Figure(what, items, key, exceptions.get(key, {}))

    unformatted = [(str(path.relative_to(root)), f"{n}") for path in root.rglob("*.py") if (n := count_skips(path))]
    return [
        figure("modules in circles", "circles", [(" <-> ".join(circle), "") for circle in circles(imports)]),
        *(
            Figure(f"imports between the children of {child}", [(text, "") for text in arrows(imports, child)])
            for child in ("calibrate", "app", "measure")
        ),
        figure(f"functions over {MOST_LINES} lines, kernels not counted", "long", long(plain)),
        figure(f"kernels over {MOST_LINES} lines", "long kernels", long(kernels)),
        figure(f"functions with more than {MOST_ARGUMENTS} arguments, kernels not counted", "arguments", wide(plain)),
        figure(f"kernels with more than {MOST_ARGUMENTS} arguments", "kernels' arguments", wide(kernels)),
        figure("functions without types, kernels not counted", "types", [(f.place, "") for f in plain if not f.typed]),
        figure("files with lines kept from the formatter", "formatter", unformatted),
        figure(
            f"files over {MOST_FILE_LINES} lines", "files", [(name, f"{n}") for name, n in files if n > MOST_FILE_LINES]
        ),
    ]


def modules(root: Path) -> dict[str, Path]:
    """Return all modules by dotted name."""
    out = {}
    for path in root.rglob("*.py"):
        parts = ["armsight", *path.relative_to(root).with_suffix("").parts]
        out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


def imported(root: Path, path: Path, module: str) -> Iterator[str]:
    """Yield the modules of this package that a file imports while it is loaded, those for type checkers left out."""
    known = modules(root)
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
    """Return which children of a package of armsight import which others."""
    package = f"armsight.{package}"

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


def functions(root: Path, path: Path) -> Iterator[Function]:
    """Yield every function of a file."""
    kernel_file = "kernels" in path.relative_to(root).parts or path.stem == "kernels"
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        a = node.args
        every = [*a.posonlyargs, *a.args, *a.kwonlyargs]
        own = [arg for arg in every if arg.arg not in ("self", "cls")]
        told = ast.get_docstring(node, clean=False)
        yield Function(
            place=f"{path.relative_to(root)}:{node.name}",
            lines=(node.end_lineno or node.lineno) - node.lineno + 1 - (told.count("\n") + 1 if told else 0),
            arguments=len(own),
            typed=all(arg.annotation for arg in own) and (node.returns is not None),
            kernel=kernel_file,
        )


def count_skips(path: Path) -> int:
    """Return how often a file keeps lines from the formatter."""
    return len(re.findall(r"#\s*fmt:", path.read_text(encoding="utf-8")))


def count_lines(path: Path) -> int:
    """Return the number of lines of a file."""
    return path.read_text(encoding="utf-8").count("\n")


if __name__ == "__main__":
    sys.exit(main())
