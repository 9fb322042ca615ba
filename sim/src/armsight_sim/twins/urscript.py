"""URScript, as much of it as control programs use: a program is checked, turned into coroutines and run by cycles.

An emulated Universal Robots controller runs with this the very program that a client uploads, so that what the arm
does follows from the client's text and not from knowledge of the client. Statements: def, thread, if, elif, else,
while, return, break, continue, run, kill, enter_critical, exit_critical, assignments with global and local; values:
numbers, booleans, strings, lists, poses p[...]. Threads take turns where a call takes time, so that a critical section
needs no lock. Whatever is not of this list is refused, and names reach nothing but the controller's own functions.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

Routine = Generator[None, None, Any]

LOOPS = 20_000
"""Turns of loops within one cycle before a program counts as one that never waits."""

OPENS = re.compile(r"(def|thread|if|while)\b.*:$")
GOES_ON = re.compile(r"(elif\b.*|else\s*):$")
NEXT = re.compile(r"\s+(?=(?:global|local)\s+\w+\s*=)")
DECLARED = re.compile(r"(global|local)\s+(\w+)\s*=")
RUN = re.compile(r"\brun\s+(\w+\s*\(.*\))\s*$")
KILL = re.compile(r"(kill|join)\s+(\w+)$")
TEXT = re.compile(r'"[^"]*"')
RESERVED = re.compile(
    r"\b(as|assert|async|await|class|del|except|finally|from|import|is|lambda|nonlocal|raise|try|with|yield)\b"
)

ALLOWED = tuple(
    getattr(ast, name)
    for name in [
        "Module",
        "FunctionDef",
        "arguments",
        "arg",
        "Pass",
        "Expr",
        "Assign",
        "If",
        "While",
        "Break",
        "Continue",
        "Return",
        "Call",
        "keyword",
        "Name",
        "Load",
        "Store",
        "Constant",
        "BinOp",
        "Add",
        "Sub",
        "Mult",
        "Div",
        "Mod",
        "UnaryOp",
        "USub",
        "UAdd",
        "Not",
        "BoolOp",
        "And",
        "Or",
        "Compare",
        "Eq",
        "NotEq",
        "Lt",
        "LtE",
        "Gt",
        "GtE",
        "List",
        "Tuple",
        "Subscript",
    ]
)


class ScriptError(Exception):
    """A program that cannot be run, or that failed while it ran."""


class Pose(list[float]):
    """A pose p[x, y, z, rx, ry, rz] in m and as a rotation vector in rad."""


def complete(text: str) -> bool:
    """Tell whether a text ends with the end of its outermost block."""
    depth, begun = 0, False
    for line in text.split("\n")[:-1]:
        line = _plain(line)
        if OPENS.match(line):
            depth, begun = depth + 1, True
        elif line == "end":
            depth -= 1
    return begun and depth <= 0


class Program:
    """A program and its threads. step lets it run for one cycle.

    calls: the controller's functions that take no time. waits: those that take time, as generator functions that yield
    once for each cycle. Raises ScriptError for a text that is no program.
    """

    def __init__(
        self, text: str, calls: Mapping[str, Callable[..., Any]], waits: Mapping[str, Callable[..., Routine]]
    ) -> None:
        self._turns = 0
        self._threads: dict[int, Routine] = {}
        self._killed: set[int] = set()
        self._last = 0
        own = {"run": self._run, "kill": self._kill, "tick_": self._tick, "copy_": _copy, "missing_": _missing}
        space: dict[str, Any] = {"__builtins__": {}, **calls, **waits, **own, "pose_": _pose}
        source, declared = _to_python(text)
        try:
            tree = ast.parse(source)
            name = _check(tree)
            _Rewriter(declared, set(calls), set(waits), _functions(tree)).visit(tree)
            exec(compile(ast.fix_missing_locations(tree), "program", "exec"), space)
        except (SyntaxError, RecursionError, MemoryError) as error:
            raise ScriptError(f"no URScript: {error}") from error
        self._main = self._run(space[name]())

    def step(self) -> bool:
        """Let every thread run until it waits; return whether the program goes on. Raises ScriptError."""
        self._turns = 0
        for number in list(self._threads):
            thread = self._threads.get(number)
            if thread is None:
                continue
            try:
                next(thread)
            except StopIteration:
                self._threads.pop(number, None)
            except ScriptError:
                raise
            except Exception as error:
                raise ScriptError(f"the program failed: {error}") from error
        for number in self._killed:
            gone = self._threads.pop(number, None)
            if gone is not None:
                gone.close()
        self._killed.clear()
        return self._main in self._threads

    def _run(self, thread: Routine) -> int:
        self._last += 1
        self._threads[self._last] = thread
        return self._last

    def _kill(self, number: Any) -> None:
        if isinstance(number, int) and number in self._threads:
            self._killed.add(number)

    def _tick(self) -> None:
        self._turns += 1
        if self._turns > LOOPS:
            raise ScriptError("a loop of the program never waits")


def _plain(line: str) -> str:
    """Return a line without comment and blanks."""
    if "#" in line:
        offset, text = 0, False
        while offset < len(line) and (text or line[offset] != "#"):
            text ^= line[offset] == '"'
            offset += 1
        line = line[:offset]
    return line.strip()


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield each statement with the number of its line. A value may stand on the line after its equals sign."""
    open_line = ""
    for number, raw in enumerate(text.split("\n"), 1):
        line = f"{open_line} {_plain(raw)}".strip()
        open_line = ""
        parts = NEXT.split(line) if line.startswith(("global ", "local ")) else [line]
        for part in parts:
            if part.endswith("=") and part is parts[-1]:
                open_line = part
            else:
                yield number, part
    if open_line:
        raise ScriptError(f"{open_line} without a value")


def _to_python(text: str) -> tuple[str, set[str]]:
    """Return a program with Python's blocks, and the names that it declares as global."""
    lines: list[str] = []
    declared: set[str] = set()
    depth = 0
    for number, line in _statements(text):
        if line == "end":
            depth -= 1
            if depth < 0:
                raise ScriptError(f"line {number}: an end without a beginning")
            continue
        if GOES_ON.match(line):
            lines += ["    " * (depth - 1) + line, "    " * depth + "pass"]
        elif OPENS.match(line):
            line = re.sub(r"^thread\b", "def", _words(line))
            lines += ["    " * depth + line, "    " * (depth + 1) + "pass"]
            depth += 1
        elif line:
            match = DECLARED.match(line)
            if match:
                line = line[match.start(2) :]
                if match[1] == "global":
                    declared.add(match[2])
            line = _words(KILL.sub(r"\1(\2)", RUN.sub(r"run(\1)", line)))
            lines.append("    " * depth + ("pass" if line in ("enter_critical", "exit_critical") else line))
    if depth:
        raise ScriptError(f"{depth} blocks do not end")
    return "\n".join(lines), declared


def _words(line: str) -> str:
    """Return a line whose names are none of Python's reserved words."""
    parts = TEXT.split(line)
    texts = [*TEXT.findall(line), ""]
    return "".join(RESERVED.sub(r"\1_", part) + text for part, text in zip(parts, texts, strict=True))


def _check(tree: ast.Module) -> str:
    """Return the name of a program's function. Raises ScriptError for anything but the statements above."""
    for node in ast.walk(tree):
        if not isinstance(node, ALLOWED):
            raise ScriptError(f"line {getattr(node, 'lineno', 0)}: {type(node).__name__} is not part of this twin")
        name = node.id if isinstance(node, ast.Name) else node.name if isinstance(node, ast.FunctionDef) else ""
        if name.startswith("_") or (name.endswith("_") and name[:-1] in ("tick", "copy", "missing", "pose")):
            raise ScriptError(f"the name {name} cannot be")
        if isinstance(node, ast.Call) and not isinstance(node.func, ast.Name):
            raise ScriptError("only names can be called")
    if len(tree.body) != 1 or not isinstance(tree.body[0], ast.FunctionDef):
        raise ScriptError("a program is one def")
    return tree.body[0].name


def _functions(tree: ast.Module) -> set[str]:
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


class _Rewriter(ast.NodeTransformer):
    """Makes every function a coroutine that hands over at the controller's functions that take time."""

    def __init__(self, declared: set[str], calls: set[str], waits: set[str], functions: set[str]) -> None:
        self._declared = declared
        self._calls = calls
        self._waits = waits | functions
        self._functions = functions

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        own = {arg.arg for arg in node.args.args}
        shared = sorted((_assigned(node) & self._declared) - own)
        self.generic_visit(node)
        never = ast.If(test=ast.Constant(False), body=[ast.Expr(ast.Yield())], orelse=[])
        head: list[ast.stmt] = [never]
        if shared:
            head.insert(0, ast.Global(names=shared))
        node.body = head + node.body
        return node

    def visit_While(self, node: ast.While) -> ast.While:
        self.generic_visit(node)
        node.body.insert(0, ast.Expr(_call("tick_")))
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        self.generic_visit(node)
        if isinstance(node.value, ast.Name):  # lists are values in URScript
            node.value = _call("copy_", node.value)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.slice, ast.Tuple) and isinstance(node.value, ast.Name) and node.value.id == "p":
            return _call("pose_", *node.slice.elts)
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name == "run" and len(node.args) == 1 and isinstance(node.args[0], ast.Call):
            self.generic_visit(node.args[0])
            return node
        self.generic_visit(node)
        if name in self._waits:
            return ast.YieldFrom(node)
        return node if name in self._calls | {"kill"} else _call("missing_", ast.Constant(name))


def _call(name: str, *args: ast.expr) -> ast.Call:
    return ast.Call(func=ast.Name(name, ast.Load()), args=list(args), keywords=[])


def _assigned(function: ast.FunctionDef) -> set[str]:
    """Return the names that a function assigns to itself, not those of functions within."""
    names: set[str] = set()
    open_nodes: list[ast.AST] = list(function.body)
    while open_nodes:
        node = open_nodes.pop()
        if isinstance(node, ast.FunctionDef):
            continue
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        open_nodes += ast.iter_child_nodes(node)
    return names


def _copy(value: Any) -> Any:
    return type(value)(value) if isinstance(value, list) else value


def _pose(*values: float) -> Pose:
    return Pose(values)


def _missing(name: str) -> None:
    raise ScriptError(f"this twin has no function {name}")
