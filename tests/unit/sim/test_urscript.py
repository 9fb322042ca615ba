"""URScript as the emulated controller runs it, and what it refuses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armsight_sim.twins.urscript import Program, ScriptError
from refusals import refuses

SAID: list[tuple[Any, ...]] = []


def sync() -> Iterator[None]:
    yield


def run(body: str, cycles: int = 10) -> list[tuple[Any, ...]]:
    """Run the body of a program; return what it has said."""
    SAID.clear()
    lines = "\n".join(f"  {line}" for line in body.split("\n"))
    program = Program(f"def program():\n{lines}\nend\n", {"say": lambda *a: SAID.append(a)}, {"sync": sync})
    for _ in range(cycles):
        if not program.step():
            break
    return list(SAID)


def test_branches_loops_and_functions() -> None:
    said = run(
        """
def twice(x):
  return x + x
end
i = 0
while i < 5: # a comment with "quotes"
  i = i + 1
  if i == 2:
    continue
  elif i == 4:
    break
  else:
    say(twice(i), "text with # and end")
  end
end
"""
    )
    assert said == [(2, "text with # and end"), (6, "text with # and end")]


@pytest.mark.parametrize(
    "body",
    [
        "x = say.__class__",
        "x = (1).real",
        "import os",
        "x = __builtins__",
        "x = [i for i in [1]]",
        "x = lambda: 1",
        "f()()",
        "x = 2 ** 10",
        "tick_ = 1",
        "while True:\nx = 1",
        "end",
        "x = ",
        'x = f"{1}"',
    ],
)
def test_what_is_no_urscript_is_refused(body: str) -> None:
    with pytest.raises(ScriptError):
        run(body)


@pytest.mark.parametrize(
    ("body", "match"),
    [
        ("open(1)", ("function", "open")),
        ("exec(1)", ("function", "exec")),
        ("x = y", ("y", "defined")),
        ("x = 1 / 0", "zero"),
        ("while True:\nx = 1\nend", "waits"),
        ("def f():\nf()\nend\nf()", "recursion"),
    ],
)
def test_a_program_that_fails_says_why(body: str, match: str) -> None:
    with refuses(ScriptError, match):
        run(body)


@given(st.text(alphabet='defnd thrau:()=,.p[]+-*/#"\n \t012_xy', max_size=120))
@settings(max_examples=60, deadline=None)
def test_garbage_never_gets_beyond_a_refusal(text: str) -> None:
    try:
        program = Program(text, {}, {"sync": sync})
        program.step()
    except ScriptError:
        return
