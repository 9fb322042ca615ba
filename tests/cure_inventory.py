"""All cures that the product gives, read from its source: what stands as cure=... in a call."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeGuard

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (
    (ROOT / "src" / "armsight", ""),
    (ROOT / "plant" / "src", "armsight_plant"),
    (ROOT / "lab" / "src", "armsight_lab"),
    (ROOT / "sim" / "src", "armsight_sim/reproduce"),
)
"""Where modules are named from, and the folder in it whose cures are a person's."""

NAMES = re.compile(
    r"(?<![\w-])--[a-z]|\barmsight (?!anew|is )[a-z]|"
    r"\b(metres?|millimetres?|centimetres?|mm|degrees?|radians?|rad|pixels?|px|seconds?)\b"
)
"""What a person can do to the letter: a flag, a command or a unit."""


@dataclass(frozen=True)
class Cure:
    """A cure of a module (path from src/armsight, or from another src), its text with {} for what is put in."""

    module: str
    text: str

    @property
    def named(self) -> bool:
        """Whether it names a flag, a command or a unit."""
        return NAMES.search(self.text) is not None


def cures() -> tuple[Cure, ...]:
    """Return all cures."""
    files = [(path, home) for home, part in SOURCES for path in sorted((home / part).rglob("*.py"))]
    return tuple(cure for path, home in files for cure in cures_of(path.relative_to(home).as_posix()))


@cache
def cures_of(module: str) -> tuple[Cure, ...]:
    """Return the cures of a module, each text once."""
    source = next(path for home, _ in SOURCES if (path := home / module).is_file()).read_text(encoding="utf-8")
    if "cure" not in source:
        return ()
    tree, found = ast.parse(source), {}
    constants = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if _is_cure(node):
            for text in texts(node.value, constants):
                if text.strip("{} "):
                    found[Cure(module, text)] = None
    return tuple(found)


def _is_cure(node: ast.AST) -> TypeGuard[ast.keyword | ast.Assign]:
    """Whether this gives a cure, or puts one together before it is given."""
    if isinstance(node, ast.Assign):
        return any(isinstance(target, ast.Name) and target.id == "cure" for target in node.targets)
    return isinstance(node, ast.keyword) and node.arg == "cure"


def texts(node: ast.expr, constants: dict[str, ast.expr]) -> Iterator[str]:
    """Yield what an expression may be as text."""
    if isinstance(node, ast.Constant):
        yield str(node.value) if isinstance(node.value, str) else ""
    elif isinstance(node, ast.JoinedStr):
        yield "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
    elif isinstance(node, ast.IfExp):
        yield from texts(node.body, constants)
        yield from texts(node.orelse, constants)
    elif isinstance(node, ast.BinOp):
        yield from (a + b for a in texts(node.left, constants) for b in texts(node.right, constants))
    elif isinstance(node, ast.Name) and node.id in constants:
        yield from texts(constants[node.id], constants)
    else:
        yield "{}"
