"""Command line, Python and page tell the same default and the same bounds of what has one name.

Every flag of every command, every public function and every number field of a page is walked. What differs on purpose
stands in DIFFERENT with the reason, and an entry that is needed no more fails too.
"""

import ast
import dataclasses
import inspect
import math
import sys
from collections.abc import Iterator
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

import pytest
from typer.models import ArgumentInfo

import armsight
from armsight.app.operator.identify_run import IdentifyRequest
from armsight.app.operator.path_editor import PlayRequest
from armsight.calibrate.cameras import BoardOptions
from armsight.cli.command import Command
from armsight.cli.commands import app
from armsight.cli.flags import OneFlag, Parts
from armsight.control.joint_sweep import Pace
from armsight.control.play import PlaySettings
from armsight.control.servo import ServoSettings
from armsight.control.session.operator_session import FIRST_OVERRIDE
from armsight.fields import Bounds, bounds_of, known_hints
from armsight.ops.checks import bounds_of_parameters
from armsight.ops.commands import parameter
from armsight.optics import Plate
from armsight.store.cell_file import CellMirrors

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "src" / "armsight" / "console" / "pages"

NONE = inspect.Parameter.empty
DIFFERENT = {("simulate", "scenario"): "Python has a cell to try; a command names what it writes"}
OWN_FIELDS = {
    "mirrors.py: label": "as cell.yaml has them",
    "identify.py: f'{texts.LOWER} ({unit})'": "where the joint stands",
    "identify.py: f'{texts.UPPER} ({unit})'": "where the joint stands",
    "teach.py: texts.PATH_FIGURE": "of the tool that is chosen",
}
"""Number fields of pages that are of no request, and whose value they show."""


@pytest.fixture(scope="module")
def flags_page() -> Iterator[Any]:
    sys.path.insert(0, str(ROOT / "tools"))
    yield import_module("python_flags")
    sys.path.remove(str(ROOT / "tools"))


def commands() -> Iterator[tuple[str, Command]]:
    """Every command of the command line with its flags."""
    for group, typed in (("", app), *((str(one.name), one.typer_instance) for one in app.registered_groups)):
        for one in typed.registered_commands:  # type: ignore[union-attr]  # a group has its app
            command = vars(one.callback)["armsight"]
            command = command() if callable(command) else command
            name = one.name or command.function.__name__.replace("_", "-")
            yield f"{group} {name}".strip(), command


def parts(command: Command) -> list[tuple[OneFlag, Any]]:
    """A command's flags, each with its default in SI; of two of one name, in two of its modes, both."""
    return [pair for part, _ in command.flags._parts for pair in of_part(part, None)]


def of_part(part: OneFlag | Parts, kind: type | None) -> Iterator[tuple[OneFlag, Any]]:
    if isinstance(part, Parts):
        for one in part.parts:
            yield from of_part(one, part.kind)
        return
    given = part.parameter.default
    if given is None:  # not shown: what the request does without it
        yield part, getattr(kind, part.name, None)
    else:
        yield part, given if given is NONE or part.read is None else part.read(given)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float) and not isinstance(a, bool):
        return math.isclose(a, b, rel_tol=1e-9)
    return bool(a == b) or str(a) == str(b) or all(one in (None, "") for one in (a, b))


def compared(flags_page: Any) -> Iterator[tuple[str, OneFlag, Any, str, inspect.Parameter, Bounds | None]]:
    """Every flag and its default beside each parameter that is the same in Python, with that one's bounds."""
    for name, command in commands():
        for flag, here in parts(command):
            positional = isinstance(get_args(flag.parameter.annotation)[1], ArgumentInfo)
            wanted = flag.name if positional else parameter(flag.written)
            for public in flags_page.functions(name):
                call = reduce(getattr, public.split("."), armsight)
                if hasattr(call, "action"):  # said once, for both
                    continue
                there = inspect.signature(call).parameters  # type: ignore[arg-type]  # a function
                if wanted in there:
                    told = bounds_of_parameters(getattr(call, "requests", ())).get(wanted)
                    bounds = told or bounds_of(known_hints(call)[wanted])
                    yield name, flag, here, public, there[wanted], bounds


def test_no_default_and_no_bound_has_two_values(flags_page: Any) -> None:
    wrong, seen, n = [], set(), 0
    for name, flag, here, public, there, bounds in compared(flags_page):
        n += 1
        at = there.default
        if (name, flag.written) in DIFFERENT or (name, flag.name) in DIFFERENT:
            seen |= {(name, flag.written), (name, flag.name)}
        elif NONE not in (here, at) and not same(here, at):
            wrong.append(f"{name} {flag.written} is {here}, {public}({there.name}) {at}")
        if flag.bounds != bounds and isinstance(flag.bounds or bounds, Bounds):
            wrong.append(f"{name} {flag.written} must be {flag.bounds}, {public}({there.name}) {bounds}")
    assert not wrong, "\n".join(wrong)
    assert set(DIFFERENT) <= seen
    assert n > 100  # the walk is of all that are no actions


def test_one_name_has_one_default_in_all_modes_of_a_command() -> None:
    for name, command in commands():
        known: dict[str, tuple[OneFlag, Any]] = {}
        for flag, here in parts(command):
            first, there = known.setdefault(flag.name, (flag, here))
            assert first.bounds == flag.bounds, (name, flag.written)
            assert NONE in (here, there) or same(here, there), (name, flag.written, here, there)


def test_numbers_on_pages_are_those_of_the_requests() -> None:
    own, fields = set(), 0
    for page in sorted(PAGES.glob("*.py")):
        module = import_module(f"armsight.console.pages.{page.stem}")
        for call in ast.walk(ast.parse(page.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            called = ast.unparse(call.func)
            if called in ("ui.number", "ui.slider", "ui.knob"):
                own.add(f"{page.name}: {ast.unparse(call.args[0])}")
            if called == "number_field":
                of, name = getattr(module, ast.unparse(call.args[1])), ast.literal_eval(call.args[2])
                known = vars(of)["action"].parameters if "action" in vars(of) else vars(of)
                assert name in known, f"{of.__name__} has no default of {name}"
                fields += 1
    assert own == set(OWN_FIELDS)
    assert fields >= 7


def test_what_the_program_below_assumes_is_what_is_asked() -> None:
    play, servo = PlaySettings(), {one.name: one.default for one in dataclasses.fields(ServoSettings)}
    followed = inspect.signature(armsight.servo).parameters
    played = {name: one.default for name, one in inspect.signature(armsight.play).parameters.items()}
    asked = (
        (played["path_speed_m_s"], play.speed_m_s),
        *((played[name], getattr(play, name)) for name in ("blend_m", "approach_speed_m_s")),
        *((played[name], getattr(play, name)) for name in ("retract_m", "keep_rotation")),
        *((followed[name].default, servo[name]) for name in ("resume_m", "resume_rad", "predict")),
        (inspect.signature(armsight.jog).parameters["speed"].default, FIRST_OVERRIDE),
        (PlayRequest.speed_m_s, played["path_speed_m_s"]),
        (IdentifyRequest.frames, Pace().frames_per_reading),
    )
    for a, b in asked:
        assert a == b
    built, given = CellMirrors(), inspect.signature(armsight.calibrate_mirrors).parameters
    assert all(getattr(built, name) == given[name].default for name in ("near_m", "gap_m", "index"))
    of_boards = (armsight.calibrate_camera, armsight.calibrate_stereo)
    known = (
        *((inspect.signature(one).parameters["lens"].default, BoardOptions().lens.value) for one in of_boards),
        (built.index, Plate(thickness_m=1e-3).index),
    )
    for a, b in known:
        assert a == b


def test_a_default_that_drifts_and_a_bound_that_is_left_out_are_found(
    flags_page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(armsight.design.__wrapped__.__kwdefaults__, "views", 30)  # type: ignore[attr-defined]
    with pytest.raises(AssertionError, match=r"design --views is 20, design\(views\) 30"):
        test_no_default_and_no_bound_has_two_values(flags_page)
    monkeypatch.undo()
    monkeypatch.setitem(vars(armsight.design), "requests", ())
    with pytest.raises(AssertionError, match=r"design --views.*None"):
        test_no_default_and_no_bound_has_two_values(flags_page)


def test_a_number_beyond_its_bounds_is_refused_by_its_python_name() -> None:
    from armsight.errors import UsageError
    from refusals import refuses

    with refuses(UsageError, "resume_rad", "1", "at most 0.523599"):
        armsight.servo("sim:webcam-cell", "rig.yaml", "target.yaml", "handeye.yaml", resume_rad=1.0)
    with refuses(UsageError, "speed", "2", "at most 1"):
        armsight.jog("sim:webcam-cell", 1, 0.01, speed=2.0)
