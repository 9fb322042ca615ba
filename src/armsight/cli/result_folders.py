"""Results of another run in a folder: replaced only with --overwrite, and only by new ones; inputs never."""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from armsight._files import real_path
from armsight.cli.command_ui import CommandUI
from armsight.errors import Cancelled, UsageError

MEASURED = ("poses.csv", "points.csv", "spots.csv", "poses.tum", "measure.json", "report.html")
VIEWS = ("left", "right", "image")
WORLD = ("scenario.yaml", "rig.yaml", "target.yaml", "truth.csv", "times.csv")
ARM = ("arm.yaml", "arm_true.yaml", "truth_world.csv", "joints.csv", "sweep_joints.csv", "handeye.yaml", "world.yaml")
SET_TABLES = ("robot_poses.csv", "pairs.csv", "robot.csv", "flange.csv", "points.csv", "holdout.csv", "observed.csv")
SET_FILES = ("photos", "complex", "lights", "camera.yaml", "rig_true.yaml", "arm_tool.yaml", "places_true.yaml")
SETS = (*SET_TABLES, *SET_FILES, "poses.csv", "handeye_true.yaml", "tip_true.yaml")
VERIFIED = ("verify.json", "errors.csv", "report.html", "live.mcap", "mastering.csv")

WRITTEN = {"out", "record", "log"}
"""Options that name what a command writes."""
STREAMED = {f"kinematics {name}" for name in ("fk", "ik", "jacobian", "path")} | {"join"}
"""Commands whose one table may go to the standard output (-o -)."""

NOT_TO_BE_TRUSTED = 3


class ResultsDoubted(typer.Exit):
    """The end of a command whose results are written and not to be trusted."""

    def __init__(self) -> None:
        super().__init__(NOT_TO_BE_TRUSTED)


OVERWRITE = Annotated[bool, typer.Option("--overwrite", help="Replace the results of another run in the folder.")]


def keeps_results(*names: str, own: str | None = None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command with an `out` folder the option --overwrite; names: the results that it writes there.

    own: a result whose presence says that the folder is this command's own, which it may replace unasked. A run that
    fails leaves the results that were there; one that was stopped keeps what it has.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)
        kinds = get_type_hints(command, include_extras=True)
        added = inspect.Parameter("overwrite", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=OVERWRITE)
        parameters = [
            one.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kinds[name])
            for name, one in signature.parameters.items()
        ]

        @functools.wraps(command)
        def run(**given: Any) -> None:
            overwrite, out = given.pop("overwrite"), given["out"]
            if out is None:  # a command that writes only where it is told to
                command(**given)
                return
            with CommandUI(as_json=given.get("json", False)):
                _refuse_inputs(out, names, given)
                _replacing(
                    out, names, overwrite or (own is not None and (out / own).exists()), lambda: command(**given)
                )

        run.__signature__ = signature.replace(parameters=[*parameters, added])  # type: ignore[attr-defined]  # as above
        run.__annotations__ = {one.name: one.annotation for one in [*parameters, added]}
        return run

    return decorate


def keep_inputs(app: typer.Typer, *, in_place: Collection[str] = ()) -> None:
    """Let no command write its output over one of its inputs, where another writes, or into what is no file.

    in_place: commands whose result takes the place of an input.
    """
    groups = [(group.name, group.typer_instance) for group in app.registered_groups]
    for prefix, one in [("", app), *groups]:
        for command in [] if one is None else one.registered_commands:
            name = f"{prefix} {command.name or getattr(command.callback, '__name__', '')}".strip().replace("_", "-")
            if command.callback is not None and WRITTEN & set(inspect.signature(command.callback).parameters):
                stream = name in STREAMED
                command.callback = _keeping_inputs(command.callback, in_place=name in in_place, stream=stream)


def _keeping_inputs(command: Callable[..., Any], *, in_place: bool, stream: bool) -> Callable[..., Any]:
    """stream: the command writes one table and nothing else, which may go to the standard output."""

    @functools.wraps(command)
    def run(**given: Any) -> Any:
        with contextlib.ExitStack() as held:
            with CommandUI(as_json=given.get("json", False)):
                from armsight.store.atomic import STREAM
                from armsight.store.outputs import held_outputs

                outs = [Path(out) for name in sorted(WRITTEN & set(given)) for out in _texts(given[name])]
                if stream and outs == [STREAM]:
                    _refuse_json(given)
                    outs = []
                for out in () if in_place else outs:
                    if not out.is_dir():
                        _refuse_inputs(out.parent, (out.name,), given)
                held.enter_context(held_outputs(outs))
            return command(**given)

    return run


def _refuse_json(given: Mapping[str, Any]) -> None:
    if given.get("json", False):
        raise UsageError(
            "-o - and --json both take the standard output", consequence="Nothing was done", cure="Give one of them"
        )


def _refuse_inputs(folder: Path, names: Collection[str], given: Mapping[str, Any]) -> None:
    """Raise UsageError where one of the results, names in a folder, is given as an input."""
    outputs = {real_path(folder / name) for name in names}
    for flag, value in given.items():
        for text in _texts(value) if flag not in WRITTEN else ():
            if Path(text).exists() and real_path(Path(text)) in outputs:
                raise UsageError(
                    f"{text} is an input, and would be written over by the result",
                    consequence="Nothing was done",
                    cure="Give another output (-o)",
                )


def _texts(value: Any) -> tuple[str, ...]:
    """Return what may be the paths of an option."""
    if isinstance(value, list | tuple):
        return tuple(text for one in value for text in _texts(one))
    return (str(value),) if isinstance(value, str | Path) and str(value) else ()


def _replacing(out: Path, names: tuple[str, ...], overwrite: bool, work: Callable[[], None]) -> None:
    """Do the work with earlier results aside; bring them back where it failed."""
    from armsight.store.earlier_results import EarlierResults, refuse_earlier

    if not overwrite:
        refuse_earlier(out, names)
    earlier = EarlierResults(out, names)
    try:
        work()
    except ResultsDoubted:
        earlier.settle()
        raise
    except typer.Exit as ended:
        if ended.exit_code in (0, Cancelled.exit_code):
            earlier.settle()
        else:
            earlier.put_back()
        raise
    except BaseException:
        earlier.put_back()
        raise
    earlier.settle()
