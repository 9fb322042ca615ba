"""How a function becomes a command: its flags, one CommandUI round it, and the results of other runs left as they are.

Results of another run in a folder are replaced only with --overwrite, and only by new ones; inputs never.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args

import typer

from armsight._files import real_path
from armsight.cli.command_ui import CommandUI, verdict_of
from armsight.cli.flags import CommandFlags, taken_by
from armsight.cli.lazy import Group, LazyCommand, load_rotations
from armsight.errors import ArmsightError, Cancelled, UsageError
from armsight.file_names import ARM, HANDEYE, POINTS, POSES, RIG, TARGET, WORLD
from armsight.ops import flags as shared
from armsight.ops.action import CommandTraits
from armsight.registry import COMMANDS, FILING, extension

if TYPE_CHECKING:
    from armsight.records.output import Output

VIEWS = ("left", "right", "image")
SIMULATED = ("scenario.yaml", RIG, TARGET, "truth.csv", "times.csv")
WITH_ARM = (ARM, "arm_true.yaml", "truth_world.csv", "joints.csv", "sweep_joints.csv", HANDEYE, WORLD)
SET_TABLES = ("robot_poses.csv", "pairs.csv", "robot.csv", "flange.csv", POINTS, "holdout.csv", "observed.csv")
SET_FILES = ("photos", "complex", "lights", "camera.yaml", "rig_true.yaml", "arm_tool.yaml", "places_true.yaml")
CELL_SET = ("left.csv", "right.csv", "cell_true.yaml")
SETS = (*SET_TABLES, *CELL_SET, *SET_FILES, POSES, "handeye_true.yaml", "tip_true.yaml")

WRITTEN = {"out", "record", "log"}
"""Options that name what a command writes."""
NOT_TO_BE_TRUSTED = 3
Filing: TypeAlias = "Callable[[Output, int, str], list[str]]"
"""Files a command's result, with its exit code and why that is not 0; returns what to tell the person."""
Face: TypeAlias = Callable[..., CommandUI]
"""Makes a command's way to the person, of as_json."""
JSON = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, nothing else.")]
HISTORY = "Filing in a history"
CELL = Annotated[
    str | None,
    typer.Option(
        "--cell", metavar="NAME", rich_help_panel=HISTORY, help="File the result in the history of this cell."
    ),
]
HISTORY_PLACE = Annotated[
    str | None, typer.Option("--history", metavar="FILE_OR_URL", rich_help_panel=HISTORY, help=shared.HISTORY_PLACE)
]
CHECK = Annotated[bool, typer.Option("--check", help="End with exit code 3 where the verdict is not good.")]
OVERWRITE = Annotated[bool, typer.Option("--overwrite", help="Replace the results of another run in the folder.")]


class ResultsDoubted(typer.Exit):
    """The end of a command whose results are written and not to be trusted."""

    def __init__(self) -> None:
        super().__init__(NOT_TO_BE_TRUSTED)


@dataclass(frozen=True, kw_only=True)
class Command(CommandTraits):
    """A command; the first parameter of its function is the CommandUI, and all others are flags.

    json: it has a result that programs read.
    """

    function: Callable[..., None]
    taken: Callable[[], Mapping[str, tuple[Any, Any]]]
    json: bool = True

    @functools.cached_property
    def flags(self) -> CommandFlags:
        """What the function takes."""
        return CommandFlags(self.taken())

    def parameters(self) -> list[inspect.Parameter]:
        """Return typer's parameters."""
        added = {"json": JSON} if self.json else {}
        added |= {"overwrite": OVERWRITE} if self.keeps else {}
        added |= {"check": CHECK} if self.judged else {}
        every = self.flags.parameters() + [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
            for name, kind in added.items()
        ]
        every += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
            for name, kind in ({"cell": CELL, "history": HISTORY_PLACE} if self.filed else {}).items()
        ]
        return sorted(every, key=self._panel)

    def _panel(self, parameter: inspect.Parameter) -> int:
        panel = get_args(parameter.annotation)[1].rich_help_panel
        return self.panels.index(panel) + 1 if panel in self.panels else 0

    def run(self, face: Face = CommandUI, /, **given: Any) -> None:
        """Run the function; a run that fails leaves the results that were there, one that was stopped what it has."""
        as_json, check = given.pop("json", False), self.judged and given.pop("check", False)
        with face(as_json=as_json):
            load_rotations()
        overwrite = given.pop("overwrite", False) if self.keeps else False
        with contextlib.ExitStack() as held:
            if self.filed:
                with face(as_json=as_json):
                    given["filing"] = self._filing(given)
            if WRITTEN & set(given):
                with face(as_json=as_json):
                    held.enter_context(self._outputs(given, as_json))
            if not self.keeps or given["out"] is None:  # None: it writes only where it is told to
                self._work(face, given, as_json, check)
                return
            with face(as_json=as_json):
                out = given["out"]
                refuse_inputs(out, self.keeps, given)
                overwrite = overwrite or (self.own is not None and (out / self.own).exists())
                _replacing(out, self.keeps, overwrite, lambda: self._work(face, given, as_json, check))

    def _work(self, ui: Face, given: Mapping[str, Any], as_json: bool, check: bool) -> None:
        with ui(as_json=as_json) as face:
            with _filed(face, given.get("filing")):
                self.function(face, **self.flags.arguments(given, face.say))
            verdict = verdict_of(face.given)
            if check and verdict is not None and verdict.level != "good":
                raise ResultsDoubted  # filed as what it is: the result holds, and is no good news

    def _filing(self, given: dict[str, Any]) -> Filing | None:
        """Return what files the result where a cell is named. Raises UsageError and DeviceNotFound, before any work."""
        cell, place = given.pop("cell", None), given.pop("history", None)
        if cell is None:
            if place is not None:
                raise UsageError("--history says where to file, and no cell is named", cure="Add --cell NAME")
            return None
        found: Filing = extension(FILING, "filing", "lab")(self.command, cell, place, dict(given)).file
        return found

    def _outputs(self, given: Mapping[str, Any], as_json: bool) -> contextlib.AbstractContextManager[Any]:
        """Hold what is written for this command alone. Raises UsageError for an input, and for what is no file."""
        from armsight.store.atomic import STREAM, held_outputs

        outs = [Path(out) for name in sorted(WRITTEN & set(given)) for out in _texts(given[name])]
        if self.streamed and outs == [STREAM]:
            if as_json:
                raise UsageError(
                    "-o - and --json both take the standard output",
                    consequence="Nothing was done",
                    cure="Give one of them",
                )
            outs = []
        kept = {flag: value for flag, value in given.items() if flag != self.in_place}
        for out in outs:
            if not out.is_dir():
                refuse_inputs(out.parent, (out.name,), kept)
        return held_outputs(outs)


@contextlib.contextmanager
def _filed(face: CommandUI, filing: Filing | None) -> Iterator[None]:
    """File the result that a command has given when it ends, also where it ends badly; nothing where filing is None.

    The exit code stays that of the result: it is written, and good or not whether or not it could be filed.
    """
    exit_code, reason = 0, ""
    try:
        yield
    except typer.Exit as ended:
        exit_code, reason = ended.exit_code, "its results are not to be trusted" if ended.exit_code else ""
        raise
    except ArmsightError as error:
        exit_code, reason = error.exit_code, str(error)
        raise
    finally:
        if filing is not None and face.given is not None:
            for line in filing(face.given, exit_code, reason):
                face.say(line)


app = typer.Typer(
    name="armsight",
    cls=Group,
    help="See where a robot arm really is: one to eight cameras, light beacons, poses with honest uncertainty.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _group(name: str, text: str) -> typer.Typer:
    group = typer.Typer(name=name, cls=Group, help=text, no_args_is_help=True)
    app.add_typer(group, name=name)
    return group


calibrate = _group(
    "calibrate",
    "Calibrate cameras, hand-eye, a tool's tip, an arm (calibrate arm), where the rig stands, targets and clocks.",
)
convert = _group("convert", "Convert between armsight's files and those of other programs.")
history = _group(
    "history", "What calibrations and verifications of a cell found, run by run, and whether it has drifted."
)
kinematics = _group("kinematics", "Joints to poses and back, for any serial arm.")
path = _group("path", "Change, check and export the path of a tool's tip.")
robot = _group("robot", "Test the link to a robot, and move one of its joints.")


def command(
    group: typer.Typer, name: str | None = None, **more: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a function to a group as a command; more: of Command."""

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        made = Command(function=function, taken=functools.partial(taken_by, function), **more)
        add(group, name or function.__name__, inspect.getdoc(function), made)
        return function

    return decorate


def elsewhere(group: typer.Typer, extra: str, commands: Mapping[str, str]) -> None:
    """Add commands that the distribution armsight-EXTRA brings; commands: name -> the first paragraph of its help."""
    for name, told in commands.items():
        words = name if group is app else f"{group.info.name}.{name}"
        add(group, name, told, functools.partial(extension, COMMANDS, words, extra))


def add(group: typer.Typer, name: str, told: str | None, command: Command | Callable[[], Command]) -> None:
    """Add a command, or what returns it when it is asked for, under a line of help."""

    def run() -> None:
        """Stand for the command until its flags are made."""

    run.__doc__, run.__signature__ = told, inspect.Signature()  # type: ignore[attr-defined]  # none yet, see LazyCommand
    run.armsight = command  # type: ignore[attr-defined]
    group.command(name.replace("_", "-"), cls=LazyCommand)(run)


def declared(**more: Any) -> Callable[[Callable[..., None]], Command]:
    """Make a function a command, for the entry points of another distribution; more: of Command."""
    return lambda function: Command(function=function, taken=functools.partial(taken_by, function), **more)


def refuse_inputs(folder: Path, names: Collection[str], given: Mapping[str, Any]) -> None:
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
    if isinstance(value, list | tuple):
        return tuple(text for one in value for text in _texts(one))
    return (str(value),) if isinstance(value, str | Path) and str(value) else ()


def _replacing(out: Path, names: tuple[str, ...], overwrite: bool, work: Callable[[], None]) -> None:
    """Do the work with earlier results aside; bring them back where it failed."""
    from armsight.store.atomic import EarlierResults, refuse_earlier

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
            failed = earlier.put_back()
            if failed is not None:
                typer.echo(f"{out} holds the earlier results; what this run left is in {failed}", err=True)
        raise
    except BaseException:
        earlier.put_back()
        raise
    earlier.settle()
