"""Tests hold classes, fields and names, not sentences: rewording a message breaks the tests of messages alone."""

import ast
import re
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from armsight.errors import BadFile, DataRefused
from refusals import refuses

TESTS = Path(__file__).resolve().parents[1]
OF_MESSAGES = {"unit/test_errors.py", "architecture/test_wording.py"}
WORD = "[A-Za-z][A-Za-z'-]+"
SENTENCE = re.compile(rf"\b{WORD}(?:[,;:]? (?:a )?{WORD}){{3}}")
"""Four words in a row."""
NAMES = {"refuses", "names_it"}
STARTS = {"startswith", "endswith", "count"}


def sentences(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text where a test holds a sentence: of a refusal, or asserted of what was told."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            texts = [one.value for one in node.keywords if one.arg == "match"]
            if isinstance(node.func, ast.Name) and node.func.id in NAMES:
                texts += node.args
        elif isinstance(node, ast.Assert):
            texts = [text for part in ast.walk(node.test) for text in compared(part)]
        else:
            continue
        yield from ((node.lineno, text) for text in map(words, texts) if SENTENCE.search(text))


def compared(node: ast.AST) -> list[ast.expr]:
    """Return what an expression asks a text for."""
    if isinstance(node, ast.Compare):
        return [node.left, *node.comparators]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in STARTS:
        return list(node.args)
    return []


def words(node: ast.expr) -> str:
    """Return what is written out of a text; what is put in has a digit's place."""
    if isinstance(node, ast.JoinedStr):
        return "".join(words(part) if isinstance(part, ast.Constant) else "0" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def test_no_test_holds_a_sentence() -> None:
    found = {
        f"{name}:{line}: {text}"
        for path in TESTS.rglob("*.py")
        if (name := path.relative_to(TESTS).as_posix()) not in OF_MESSAGES
        for line, text in sentences(path.read_text(encoding="utf-8"))
    }
    assert not found


@pytest.mark.parametrize(
    "planted",
    [
        'with pytest.raises(BadFile, match="it cannot be read"):\n    pass',
        'with refuses(BadFile, "it cannot be read"):\n    pass',
        'assert "nothing was written, as asked" in told',
        'assert told == f"the camera {n} is gone for good"',
        'assert told.startswith("nothing was written here")',
    ],
)
def test_a_sentence_is_seen(planted: str) -> None:
    assert [line for line, _ in sentences(planted)] == [1]


@pytest.mark.parametrize(
    "planted",
    [
        'with refuses(BadFile, "a.yaml", "line 5", "j1, j2, j3, j4"):\n    pass',
        'assert found.cause is Unseen.MOTION, "the target moved and was followed"',
    ],
)
def test_names_and_fields_are_none(planted: str) -> None:
    assert not list(sentences(planted))


@pytest.mark.parametrize(
    ("kind", "names", "fields", "seen"),
    [
        (BadFile, ("a.yaml", "line 15"), {"consequence": "It is not read"}, True),
        (DataRefused, ("a.yaml",), {}, False),
        (BadFile, ("a.yaml", "line 5"), {}, False),
        (BadFile, (), {"consequence": "It is read"}, False),
    ],
    ids=["the same", "another class", "another name", "another field"],
)
def test_another_refusal_is_not_taken_for_the_one_expected(
    kind: type[Exception], names: tuple[str, ...], fields: dict[str, str], seen: bool
) -> None:
    with nullcontext() if seen else pytest.raises(AssertionError), refuses(kind, *names, **fields):
        raise BadFile("a.yaml, line 15: empty", consequence="It is not read")
