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

HOME = Path(__file__).resolve().parent.parent
ROOTS = (
    HOME / "src" / "armsight",
    HOME / "sim" / "src" / "armsight_sim",
    HOME / "plant" / "src" / "armsight_plant",
    HOME / "lab" / "src" / "armsight_lab",
)
MOST_LINES = 40
MOST_ARGUMENTS = 8
MOST_FILE_LINES = 400
SHARED, FEWEST_SHARED = 0.6, 4
"""Share of fields in common from which two classes are one thing twice, and the fewest fields that tell it."""
MOST_KERNEL_LINES = 60
MOST_KERNEL_ARGUMENTS = 10
LEAST_COMMENTS = 3.0
"""Lines with comments per 100 lines of code in a package of arithmetic: which formula it is, and why, no code says."""
ARITHMETIC = ("calibrate", "fitting")
"""Packages whose code is arithmetic, beside all kernels."""
DRIVERS = "settings of drivers, whose keys only the driver knows"
SCENES = "documents of simulated scenes, whose keys armsight-sim knows"
CALL = "what a function of any parameters was called with"
FLAGS = "a command: each of its flags is an argument, with a line or more of help"

EXCEPTIONS: Mapping[str, Mapping[str, str]] = {
    "long": {
        "cli/serve.py:serve": FLAGS,
        "ops/paths.py:export": FLAGS,
        "ops/verify.py:*": FLAGS,
        "ops/calibrate_*": FLAGS,
        "ops/measure.py:*": FLAGS,
        "ops/motion.py:*": FLAGS,
        "ops/teach.py:teach": FLAGS,
        "ops/identify.py:identify_arm*": FLAGS,
    },
    "arguments": {
        "ops/*": FLAGS,
        "armsight_lab/api/*": FLAGS,
        "cli/serve.py:console": FLAGS,
        "cli/serve.py:serve": FLAGS,
        "cli/verify.py:verify": FLAGS,
        "optics/rig.py:__init__": "a pair's cameras, poses and values, each by its keyword",
    },
    "dictionaries": {
        "ops/action.py": CALL,
        "ops/checks.py": CALL,
        "ops/given.py": CALL,
        "ops/compare/run.py": "any program's file, which is not one of those that are compared",
        "ops/requests/motion.py": DRIVERS,
        "ops/robot/hosting.py": DRIVERS,
        "ops/robot/opening.py": DRIVERS,
        "ops/robot/recorder.py": "a log of orders of every kind, each with its own values",
        "ops/robot/robot_run.py": "a recording of set points of every kind, each with its own values",
        "app/operator/job_runner.py": "what a remote robot's description holds of its arm",
        "ops/simulation/cells.py": SCENES,
        "ops/simulation/run.py": SCENES,
        "ops/simulation/scenarios.py": SCENES,
        "report/figures.py": "plotly's traces and layouts, under one name for all pages",
    },
    "imports by name": {
        "__init__.py": "public names are loaded when they are asked for",
        "ops/__init__.py": "modules of actions, which import this package",
        "cli/lazy.py": "help is drawn by what only help needs",
        "fields.py": "defaults of flags that are heavy to import",
        "kinematics/dynamics.py": "an extra that is not always there",
    },
    "types of a result": {
        "armsight_lab/history/series.py:Found": "of many runs by number what an entry has of one",
        "app/operator/identify_run.py:Entry": "of a web page, always with a deviation's place in its text",
        "ops/path/picks.py:PickedPointOutput": "in the path's frame; the match itself is in the rig's",
        "calibrate/timing/result.py:CameraClock": "of each camera by name what a pair's result has of two",
        "calibrate/identify/result.py:JointStd": "an arm's entries have the same names everywhere",
        "app/live/views.py:Counts": "what a page counts and what a recorder does go on apart",
    },
    "files": {
        "measure/spots/kernels/scan.py": "thresholds and connected components of one pass over an image",
        "armsight_sim/rooms/kernels.py": "rays and light of one scene, which is one tuple of arrays for all of them",
    },
}
"""What may be over a limit, by the limit's key: place (a pattern) -> reason. Every one of them is printed.

A place is a file's path in armsight; one of another distribution begins with the name of its package.
"""


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


def main(arguments: Sequence[str] | None = None, roots: Sequence[Path] = ROOTS) -> int:
    """Print the figures and the exceptions with their reasons; with --list also all that stands behind them."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--list", action="store_true", help="name the functions and files")
    listed = parser.parse_args(arguments).list
    wrong: list[str] = []
    for figure in figures(*roots):
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


def figures(*roots: Path, exceptions: Mapping[str, Mapping[str, str]] | None = None) -> list[Figure]:
    """Return all that is counted in the packages at roots."""
    exceptions = EXCEPTIONS if exceptions is None else exceptions
    files = {path: place(path, roots) for root in roots for path in root.rglob("*.py")}
    known = modules(roots)
    imports = {module: set(imported(known, path, module)) for module, path in known.items()}
    found = [function for path, name in files.items() for function in functions(path, name)]
    plain, kernels = [f for f in found if not f.kernel], [f for f in found if f.kernel]
    long_files = [(name, f"{n}") for path, name in files.items() if (n := count_lines(path)) > MOST_FILE_LINES]
    unformatted = [(name, f"{n}") for path, name in files.items() if (n := count_skips(path))]

    def long(some: Sequence[Function], most: int) -> list[tuple[str, str]]:
        return [(f.place, f"{f.lines} lines") for f in some if f.lines > most]

    def wide(some: Sequence[Function], most: int) -> list[tuple[str, str]]:
        return [(f.place, f"{f.arguments} arguments") for f in some if f.arguments > most]

    def figure(what: str, key: str, items: Sequence[tuple[str, str]]) -> Figure:
        return Figure(what, items, key, exceptions.get(key, {}))

    def sparse(some: Mapping[str, tuple[int, int]], least: float) -> list[tuple[str, str]]:
        shares = {name: 100.0 * lines / max(code, 1) for name, (lines, code) in some.items()}
        return [(name, f"{share:.1f}") for name, share in shares.items() if not 0.0 <= least <= share]

    comments = count_comments(files)
    return [
        figure("modules in circles", "circles", [(" <-> ".join(circle), "") for circle in circles(imports)]),
        *(
            Figure(f"imports between the children of {child}", [(text, "") for text in arrows(imports, child)])
            for child in ("calibrate", "ops", "app", "measure")
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
        Figure("packages of arithmetic, with their comments per 100 lines of code", sparse(comments, -1.0)),
        figure(
            f"packages of arithmetic with fewer comments than {LEAST_COMMENTS:g} per 100 lines of code",
            "comments",
            sparse(comments, LEAST_COMMENTS),
        ),
        figure("dictionaries of anything in app, ops and report", "dictionaries", list(open_dictionaries(files))),
        figure("modules imported by name", "imports by name", list(imports_by_name(files))),
        figure(
            "pairs of classes that share most fields, one of them a result", "types of a result", list(twice(files))
        ),
        figure("functions without types, kernels not counted", "types", [(f.place, "") for f in plain if not f.typed]),
        figure("files with lines kept from the formatter", "formatter", unformatted),
        figure(f"files over {MOST_FILE_LINES} lines", "files", long_files),
    ]


def open_dictionaries(files: Mapping[Path, str]) -> Iterator[tuple[str, str]]:
    """Yield the files of app and report that speak of dictionaries with values of any type, and how often."""
    for path, name in files.items():
        found = re.findall(r"(?:dict|Mapping)\[str, Any\]", path.read_text(encoding="utf-8"))
        if found and name.split("/")[0] in ("app", "ops", "report"):
            yield name, f"{len(found)}"


def imports_by_name(files: Mapping[Path, str]) -> Iterator[tuple[str, str]]:
    """Yield the files that import a module by a text, which no tool can follow."""
    for path, name in files.items():
        if found := len(re.findall(r"\bimport_module\(", path.read_text(encoding="utf-8"))):
            yield name, f"{found}"


def twice(files: Mapping[Path, str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of classes with at least SHARED of their fields in common, where one of them is a result."""
    classes = []
    for path, name in files.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef):
                is_result = any(ast.unparse(one) == "output" for one in node.decorator_list)
                bases = {ast.unparse(one) for one in node.bases}
                classes.append((f"{name}:{node.name}", node.name, bases, _fields(node), is_result))
    for k, (a, name_a, bases_a, fields_a, result_a) in enumerate(classes):
        for b, name_b, bases_b, fields_b, result_b in classes[k + 1 :]:
            related = name_a in bases_b or name_b in bases_a
            if (result_a or result_b) and not related and min(len(fields_a), len(fields_b)) >= FEWEST_SHARED:
                share = len(fields_a & fields_b) / len(fields_a | fields_b)
                if share >= SHARED:
                    yield a, f"{b}, {100.0 * share:.0f} %"


def _fields(node: ast.ClassDef) -> set[str]:
    """Return the fields of a class, and its methods that are keys of its result."""
    named = {one.target.id for one in node.body if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)}
    methods = [one for one in node.body if isinstance(one, ast.FunctionDef)]
    return named | {one.name for one in methods if any("figure(" in ast.unparse(d) for d in one.decorator_list)}


def place(path: Path, roots: Sequence[Path]) -> str:
    """Return a file's path in the first of the roots; in another one after that root's name."""
    root = next(root for root in roots if path.is_relative_to(root))
    inside = path.relative_to(root).as_posix()
    return inside if root == roots[0] else f"{root.name}/{inside}"


def modules(roots: Sequence[Path]) -> dict[str, Path]:
    """Return all modules by dotted name."""
    out = {}
    for root in roots:
        for path in root.rglob("*.py"):
            parts = [root.name, *path.relative_to(root).with_suffix("").parts]
            out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


def imported(known: Mapping[str, Path], path: Path, module: str) -> Iterator[str]:
    """Yield the modules of these packages that a file imports while it is loaded, those for type checkers left out."""
    packages = {name.partition(".")[0] for name in known}
    for node in _running(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in packages:
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


def functions(path: Path, name: str) -> Iterator[Function]:
    """Yield every function of a file that is called by this name."""
    kernel_file = "kernels" in name.removesuffix(".py").split("/")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        a = node.args
        every = [*a.posonlyargs, *a.args, *a.kwonlyargs]
        own = [arg for arg in every if arg.arg not in ("self", "cls")]
        told = ast.get_docstring(node, clean=False)
        yield Function(
            place=f"{name}:{node.name}",
            lines=(node.end_lineno or node.lineno) - node.lineno + 1 - (told.count("\n") + 1 if told else 0),
            arguments=len(own),
            typed=all(arg.annotation for arg in own) and (node.returns is not None),
            kernel=kernel_file,
        )


def count_comments(files: Mapping[Path, str]) -> dict[str, tuple[int, int]]:
    """Return the lines with a comment and the lines of code, docstrings left out, of each package of arithmetic.

    That is the folder of a module of kernels, or a module that is called so by itself, and each package of ARITHMETIC,
    but for its results: these declare, and reckon little.
    """
    out: dict[str, tuple[int, int]] = {}
    for path, at in files.items():
        module = Path(at)
        names = [module.parts[0]] if module.parts[0] in ARITHMETIC and "result" not in module.stem else []
        if module.stem == "kernels":
            names.append(at)
        elif "kernels" in module.parts:
            names.append(str(module.parent))
        lines, code = comment_lines(path.read_text(encoding="utf-8")) if names else (0, 0)
        for name in names:
            before = out.get(name, (0, 0))
            out[name] = before[0] + lines, before[1] + code
    return out


def comment_lines(text: str) -> tuple[int, int]:
    """Return how many lines of a source have a comment, and how many hold code: no docstrings of whatever they are."""
    told: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        for part in getattr(node, "body", None) or () if not isinstance(node, ast.Lambda | ast.IfExp) else ():
            if (
                isinstance(part, ast.Expr)
                and isinstance(part.value, ast.Constant)
                and isinstance(part.value.value, str)
            ):
                told.update(range(part.lineno, (part.end_lineno or part.lineno) + 1))
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
