"""What the source looks like from afar, and whether it keeps its limits: circles, long functions, few comments.

python tools/structure.py [--list]

Exits 1 where something is over a limit and not among EXCEPTIONS, or where an exception is no longer needed.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent / "src" / "armsight"
MOST_LINES = 40
MOST_ARGUMENTS = 8
MOST_FILE_LINES = 400
MOST_KERNEL_LINES = 60
MOST_KERNEL_ARGUMENTS = 10
LEAST_COMMENTS = 3.0
"""Lines with comments per 100 lines of code in a package of arithmetic: which formula it is, and why, no code says."""
ARITHMETIC = ("calibrate", "fitting")
"""Packages whose code is arithmetic, beside all kernels."""
COMMENTED = ("control", "geometry", "kinematics", "measure", "optics")
"""Packages of which LEAST_COMMENTS is demanded; of the others it is told."""

FLAGS = "a command: each of its flags is an argument, with a line or more of help"
COMPILED = "compiled: what it takes belongs to no object yet, and each argument is named where it is called"
LOOPS = "compiled: one loop over pixels, rays or steps; parted, its state would go through long lists of arguments"

EXCEPTIONS: Mapping[str, Mapping[str, str]] = {
    "long": {
        "api/motion.py:teach": FLAGS,
        "cli/calibrate.py:camera": FLAGS,
        "cli/commands.py:measure": FLAGS,
        "cli/handeye.py:handeye": FLAGS,
        "cli/identify.py:identify": FLAGS,
        "cli/join.py:join": FLAGS,
        "cli/mirrors.py:mirrors": FLAGS,
        "cli/path.py:export": FLAGS,
        "cli/path.py:from_picks": FLAGS,
        "cli/record.py:record": FLAGS,
        "cli/robot.py:jog": FLAGS,
        "cli/serve.py:serve": FLAGS,
        "cli/servo.py:servo": FLAGS,
        "cli/play.py:play": FLAGS,
        "cli/teach.py:teach": FLAGS,
        "cli/verify.py:verify": FLAGS,
    },
    "arguments": {
        "api/*": FLAGS,
        "cli/arm.py:arm": FLAGS,
        "cli/calibrate.py:camera": FLAGS,
        "cli/calibrate.py:stereo": FLAGS,
        "cli/commands.py:measure": FLAGS,
        "cli/handeye.py:handeye": FLAGS,
        "cli/handeye.py:pivot": FLAGS,
        "cli/console.py:console": FLAGS,
        "cli/identify.py:identify": FLAGS,
        "cli/join.py:join": FLAGS,
        "cli/kinematics.py:ik": FLAGS,
        "cli/kinematics.py:path": FLAGS,
        "cli/mirrors.py:mirrors": FLAGS,
        "cli/record.py:record": FLAGS,
        "cli/path.py:check": FLAGS,
        "cli/path.py:export": FLAGS,
        "cli/path.py:from_picks": FLAGS,
        "cli/robot.py:jog": FLAGS,
        "cli/servo.py:servo": FLAGS,
        "cli/play.py:play": FLAGS,
        "cli/teach.py:teach": FLAGS,
        "cli/target.py:target": FLAGS,
        "cli/timing.py:timing": FLAGS,
        "cli/serve.py:serve": FLAGS,
        "cli/verify.py:verify": FLAGS,
    },
    "long kernels": {
        "calibrate/cameras/kernels/normal_equations.py:view_normal_equations": LOOPS,
        "calibrate/handeye/kernels/fit.py:fit_pairs": LOOPS,
        "sim/rooms/kernels.py:cast_scene": LOOPS,
    },
    "kernels' arguments": {
        "calibrate/cameras/kernels/normal_equations.py:view_normal_equations": COMPILED,
        "calibrate/handeye/kernels/fit.py:fit_pairs": COMPILED,
        "calibrate/handeye/kernels/fit.py:residual": COMPILED,
        "sim/kernels.py:develop_raw": COMPILED,
        "sim/rooms/kernels.py:_direct": COMPILED,
        "sim/rooms/kernels.py:_indirect": COMPILED,
        "sim/rooms/kernels.py:_nearest": COMPILED,
        "sim/rooms/kernels.py:_radiance": COMPILED,
        "sim/rooms/kernels.py:_sort_out": COMPILED,
    },
    "files": {
        "measure/spots/kernels/scan.py": "thresholds and connected components of one pass over an image",
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

    def long(some: Sequence[Function], most: int) -> list[tuple[str, str]]:
        return [(f.place, f"{f.lines} lines") for f in some if f.lines > most]

    def wide(some: Sequence[Function], most: int) -> list[tuple[str, str]]:
        return [(f.place, f"{f.arguments} arguments") for f in some if f.arguments > most]

    def figure(what: str, key: str, items: Sequence[tuple[str, str]]) -> Figure:
        return Figure(what, items, key, exceptions.get(key, {}))

    comments = list(comment_shares(root).items())
    few = [(name, share) for name, share in comments if name.split("/")[0] in COMMENTED and share < LEAST_COMMENTS]
    unformatted = [(str(path.relative_to(root)), f"{n}") for path in root.rglob("*.py") if (n := count_skips(path))]
    return [
        figure("modules in circles", "circles", [(" <-> ".join(circle), "") for circle in circles(imports)]),
        *(
            Figure(f"imports between the children of {child}", [(text, "") for text in arrows(imports, child)])
            for child in ("calibrate", "app", "measure")
        ),
        figure(f"functions over {MOST_LINES} lines, kernels not counted", "long", long(plain, MOST_LINES)),
        figure(f"kernels over {MOST_KERNEL_LINES} lines", "long kernels", long(kernels, MOST_KERNEL_LINES)),
        figure(
            f"functions with more than {MOST_ARGUMENTS} arguments, kernels not counted",
            "arguments",
            wide(plain, MOST_ARGUMENTS),
        ),
        figure(
            f"kernels with more than {MOST_KERNEL_ARGUMENTS} arguments",
            "kernels' arguments",
            wide(kernels, MOST_KERNEL_ARGUMENTS),
        ),
        Figure(
            "packages of arithmetic, with their comments per 100 lines of code",
            [(name, f"{share:.1f}") for name, share in comments],
        ),
        figure(
            f"packages of arithmetic with fewer comments than {LEAST_COMMENTS:g} per 100 lines of code",
            "comments",
            [(name, f"{share:.1f}") for name, share in few],
        ),
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


def comment_shares(root: Path) -> dict[str, float]:
    """Return the lines with a comment per 100 lines of code of each package of arithmetic.

    That is the folder of a module of kernels, or a module that is called so by itself, or a folder of ARITHMETIC.
    """
    out: dict[str, tuple[int, int]] = {}
    for path in root.rglob("*.py"):
        place = path.relative_to(root)
        if place.stem == "kernels" or "kernels" in place.parts or place.parts[0] in ARITHMETIC:
            name = str(place if place.stem == "kernels" else place.parent)
            before, (lines, code) = out.get(name, (0, 0)), comment_lines(path.read_text(encoding="utf-8"))
            out[name] = before[0] + lines, before[1] + code
    return {name: 100.0 * lines / max(code, 1) for name, (lines, code) in out.items()}


def comment_lines(text: str) -> tuple[int, int]:
    """Return how many lines of a source have a comment, and how many hold code; strings that only tell are neither."""
    told: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            told.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    comments: set[int] = set()
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.string.strip():
            code.update(range(token.start[0], token.end[0] + 1))
    return len(comments), len(code - told)


def count_skips(path: Path) -> int:
    """Return how often a file keeps lines from the formatter."""
    return len(re.findall(r"#\s*fmt:", path.read_text(encoding="utf-8")))


def count_lines(path: Path) -> int:
    """Return the number of lines of a file."""
    return path.read_text(encoding="utf-8").count("\n")


if __name__ == "__main__":
    sys.exit(main())
