"""How much there is to hold: lines, declared fields, classes, public names, and what is said more than once.

    python tools/ratchet.py [--list] [--lower]

Each figure may only fall: exit code 1 where one is above its limit in ratchet.yaml. --lower writes what there is where
it is less. A figure that has to rise gets its new limit there by hand, beside the decision record that says why.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

HOME = Path(__file__).resolve().parent.parent
ROOTS = (
    HOME / "src" / "armsight",
    HOME / "sim" / "src" / "armsight_sim",
    HOME / "plant" / "src" / "armsight_plant",
    HOME / "lab" / "src" / "armsight_lab",
)
LIMITS = Path(__file__).with_name("ratchet.yaml")
DECISIONS = HOME / "docs" / "decisions"

UNIT = re.compile(r"_(m|mm|rad|deg|s|ms|px|hz|rad_s|m_s)$|^q[wxyz1-9]$|^status$")
"""How the name of a table's column ends, or is."""
FEWEST_COLUMNS = 3
"""Names with units that make a literal sequence a table's columns."""

Items = Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Count:
    """What a figure counts: how often, and each place with what is there."""

    n: int
    items: Items = ()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every figure beside its limit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--list", action="store_true", help="name the places of what is said more than once")
    parser.add_argument("--lower", action="store_true", help="write limits that have become lower")
    asked = parser.parse_args(arguments)
    found, limits = figures(*ROOTS), yaml.safe_load(LIMITS.read_text(encoding="utf-8"))
    for name, count in found.items():
        print(f"{name}: {count.n}")
        for place, what in sorted(count.items) if asked.list else ():
            print(f"    {place}: {what}")
    if asked.lower:
        limits["most"] = {name: min(count.n, limits["most"].get(name, count.n)) for name, count in found.items()}
        LIMITS.write_text(COMMENT + yaml.safe_dump(limits, sort_keys=False), encoding="utf-8")
    wrong = [*above(found, limits), *unexplained(limits)]
    for text in wrong:
        print(f"not in order: {text}", file=sys.stderr)
    return 1 if wrong else 0


COMMENT = """# Limits of tools/ratchet.py. They may only fall (python tools/ratchet.py --lower). One that has to rise
# is set by hand and names its decision: {figure: file of docs/decisions}.
"""


def above(found: Mapping[str, Count], limits: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Return the figures that are above their limits or have none, and the limits of what is counted no more."""
    most = limits["most"]
    over = [
        f"{name} is {count.n}, {most.get(name, 'no limit yet')} at most: take something out, or write a decision"
        for name, count in found.items()
        if count.n > most.get(name, -1)
    ]
    return over + [f"{name} is counted no more: take its limit out (--lower)" for name in most if name not in found]


def unexplained(limits: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the limits that rose by a decision that is not there."""
    raised = limits.get("raised") or {}
    return [
        f"{name}: no {file} in {DECISIONS.name}" for name, file in raised.items() if not (DECISIONS / file).exists()
    ]


def figures(*roots: Path) -> dict[str, Count]:
    """Return all figures of the packages at roots, by name: lines and declared fields a package, then of all."""
    files = {path: ast.parse(path.read_text(encoding="utf-8")) for root in roots for path in sorted(root.rglob("*.py"))}
    places = {
        path: path.relative_to(root.parent).as_posix() for root in roots for path in files if root in path.parents
    }
    lines: dict[str, int] = defaultdict(int)
    fields: dict[str, int] = defaultdict(int)
    for path, tree in files.items():
        package = "/".join(places[path].split("/")[:2]) if places[path].count("/") > 1 else places[path].split("/")[0]
        lines[package] += path.read_text(encoding="utf-8").count("\n")
        fields[package] += sum(1 for _ in declared(tree))
    out = {f"lines of {package}": Count(n) for package, n in sorted(lines.items())}
    out |= {f"declared fields of {package}": Count(n) for package, n in sorted(fields.items()) if n}
    out["files"] = Count(len(files))
    out["classes"] = Count(sum(isinstance(node, ast.ClassDef) for tree in files.values() for node in ast.walk(tree)))
    named = {places[path]: tree for path, tree in files.items()}
    out["public names"] = Count(len(public(named[PUBLIC], named)) if PUBLIC in named else 0)
    for name, found in (
        ("numeric defaults of one name in several modules", several_defaults(named)),
        ("literal columns of tables", [(at, text) for at, tree in named.items() for text in columns(tree)]),
        (
            "keywords that hand on a field of the same name",
            [(at, x) for at, tree in named.items() for x in handed(tree)],
        ),
    ):
        out[name] = Count(len(found), found)
    return out


PUBLIC = "armsight/__init__.py"


def public(tree: ast.Module, files: Mapping[str, ast.Module]) -> set[str]:
    """Return the names that a package's own file imports for type checkers: those are its public ones."""
    return {
        name
        for block in tree.body
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for node in ast.walk(block)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        for name in (listed(files[f"{str(node.module).replace('.', '/')}.py"]) if alias.name == "*" else [alias.name])
    }


def listed(tree: ast.Module) -> list[str]:
    """Return what a module's `__all__` lists."""
    found = [
        node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    ]
    return [str(name) for value in found for name in ast.literal_eval(value)]


def declared(tree: ast.Module) -> Iterator[tuple[str, ast.expr | None]]:
    """Yield name and default of the annotated fields of all classes."""
    for node in ast.walk(tree):
        for part in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
                yield part.target.id, part.value


def several_defaults(files: Mapping[str, ast.Module]) -> list[tuple[str, str]]:
    """Return the names of fields and parameters whose numeric default stands in more than one module, and where.

    A simulation shares nothing with what it tests: it counts by itself.
    """
    where: dict[tuple[str, str], set[str]] = defaultdict(set)
    for at, tree in files.items():
        pairs = list(declared(tree))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                a = node.args
                last = [*a.posonlyargs, *a.args][len(a.posonlyargs) + len(a.args) - len(a.defaults) :]
                pairs += zip((arg.arg for arg in (*last, *a.kwonlyargs)), (*a.defaults, *a.kw_defaults), strict=True)
        for name, default in pairs:
            if default is not None and is_number(default):
                where[at.partition("/")[0], name].add(at)
    return [(name, ", ".join(sorted(modules))) for (_, name), modules in where.items() if len(modules) > 1]


def is_number(node: ast.expr) -> bool:
    """Tell whether an expression is a number other than 0 and 1, which mean nothing, or off and on."""
    if isinstance(node, ast.UnaryOp | ast.BinOp):
        return not any(isinstance(part, ast.Call | ast.Attribute | ast.Name) for part in ast.walk(node))
    return isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in (0, 1)


def columns(tree: ast.Module) -> Iterator[str]:
    """Yield the literal sequences of texts of which three or more are the columns of a table."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            texts = [str(e.value) for e in node.elts if isinstance(e, ast.Constant) and isinstance(e.value, str)]
            if sum(bool(UNIT.search(text)) for text in texts) >= FEWEST_COLUMNS:
                yield ",".join(texts)[:80]


def handed(tree: ast.Module) -> Iterator[str]:
    """Yield the keywords x=y.x of calls: a value that is carried from one record to the next under one name."""
    for node in ast.walk(tree):
        for keyword in node.keywords if isinstance(node, ast.Call) else ():
            if isinstance(keyword.value, ast.Attribute) and keyword.arg == keyword.value.attr:
                yield f"{keyword.arg}={ast.unparse(keyword.value)}"


if __name__ == "__main__":
    sys.exit(main())
