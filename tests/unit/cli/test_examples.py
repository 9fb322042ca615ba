"""The examples below each command's help can be typed."""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
from typer.main import get_command
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.cli.examples import every_example

ROOT = get_command(app)


def test_each_example_is_taken() -> None:
    for example in (text for texts in every_example().values() for text in texts):
        words = shlex.split(example)
        assert words[0] == "armsight", example
        parent, command = click.Context(ROOT), ROOT
        while hasattr(command, "commands"):
            words = words[1:]
            command = command.commands[words[0]]
        context = command.make_context(words[0], words[1:], parent=parent)  # raises where a flag is unknown or missing
        assert context.params, example


def test_help_shows_them_and_the_overview_has_panels_and_completion() -> None:
    run = CliRunner().invoke
    shown = run(app, ["robot", "test", "--help"]).output
    assert every_example()["robot test"][0] in shown
    overview = run(app, ["--help"]).output
    for text in ("Begin", "Calibrate and identify", "Robots", "--install-completion"):
        assert text in overview
    names = {name for name, texts in every_example().items() if texts}
    leaves = {f"{n} {m}" for n, c in ROOT.commands.items() if hasattr(c, "commands") for m in c.commands}
    assert names == leaves | {n for n, c in ROOT.commands.items() if not hasattr(c, "commands")}


PROJECT = Path(__file__).resolve().parents[3]
SOURCES = (PROJECT / "src", PROJECT / "sim" / "src", PROJECT / "lab" / "src")
GIVEN = re.compile(r"armsight ([a-z]+(?: [a-z][a-z-]*)?)((?: (?!armsight )[^\s`';(),]+)*)")


def texts_of_errors() -> Iterator[tuple[str, str]]:
    """Yield file and text of every string in the source but docstrings; parts that are computed are left out."""
    for file in sorted(path for source in SOURCES for path in source.rglob("*.py")):
        code = file.read_text(encoding="utf-8")
        if not GIVEN.search(code):
            continue
        nodes = list(ast.walk(ast.parse(code)))
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if id(node) in docstrings:
                continue
            if isinstance(node, ast.JoinedStr):
                parts = [part.value if isinstance(part, ast.Constant) else "X" for part in node.values]
                yield file.name, "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "\n" not in node.value:
                yield file.name, node.value


def test_what_advice_tells_to_type_is_there() -> None:
    """A command that an error or a note names exists, and so does every flag behind it."""
    seen = set()
    for file, text in texts_of_errors():
        for words, rest in GIVEN.findall(text):
            first, *second = words.split()
            command = ROOT.commands.get(first)
            if command is None or words == "robot server":  # the program's name in a sentence
                continue
            if hasattr(command, "commands"):
                command = command.commands.get(second[0]) if second else command
                assert command is not None or not second, f"{file}: {text}"
            flags = set(re.findall(r"--[a-z][a-z-]*", rest))
            known = {name for param in getattr(command, "params", ()) for name in param.opts}
            assert flags <= known, f"{file}: {text}"
            seen.add(words)
    assert {"calibrate arm", "join", "path smooth", "calibrate timing"} <= seen


def leaves() -> Iterator[tuple[str, click.Command]]:
    for name, command in ROOT.commands.items():
        if hasattr(command, "commands"):
            yield from ((f"{name} {inner}", leaf) for inner, leaf in command.commands.items())
        else:
            yield name, command
