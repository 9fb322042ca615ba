"""The commands that a batch may run: their words are checked as the command line does it, and run in a worker."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from armsight.cli.command import WRITTEN, Command
from armsight.cli.command_ui import Bar, CommandUI
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight_lab.batch.job_files import close_to
from armsight_lab.batch.jobs import Ended, Job
from armsight_lab.batch.work import unforeseen

if TYPE_CHECKING:
    from armsight.records.output import Output

OUTPUTS: Mapping[str, str] = {
    "measure": "",
    "simulate": "",
    "verify": "",
    "identify": "arm.yaml",
    "calibrate camera": "camera.yaml",
    "calibrate stereo": "rig.yaml",
    "calibrate mirrors": "rig.yaml",
    "calibrate zoom-rig": "rig.yaml",
    "calibrate handeye": "handeye.yaml",
    "calibrate tooltip": "tip.yaml",
    "calibrate arm": "arm.yaml",
    "calibrate robot-world": "world.yaml",
    "calibrate target": "target.yaml",
    "calibrate timing": "rig.yaml",
    "calibrate cell": "",
    "kinematics fk": "poses.csv",
    "kinematics ik": "solutions.csv",
    "kinematics jacobian": "jacobian.csv",
    "kinematics path": "joints.csv",
    "kinematics formulas": "formulas.py",
    "kinematics show": "arm.html",
}
"""Command -> what its -o is called in the job's folder; '' where -o is the folder itself."""

NOBODY = ("live", "robot", "yes")
"""Flags that move a robot or ask a person."""
OWN = ("out", "json", "overwrite")
"""Flags that the batch itself sees to."""
DEFAULT_OUT = "its-own"
WIDTH = 120
MOST_SAID = 20_000
"""Letters kept of what a job told the person."""

_Misuse: type[Exception] = typer.BadParameter.__bases__[0]


def commands_of(words: Sequence[str], where: str) -> tuple[str, list[str]]:
    """Return the command at the beginning of words, and the rest. Raises UsageError for one that is not for batches."""
    words = [*words[0].split(), *words[1:]] if words else []  # in quotes, as a whole
    plain = [word for word in words if word != "armsight"][:2]
    for name in (" ".join(plain), " ".join(plain[:1])):
        if name in OUTPUTS:
            return name, list(words)[words.index(name.split()[-1]) + 1 :]
    asked = " ".join(plain if plain[:1] in (["calibrate"], ["kinematics"], ["path"], ["convert"]) else plain[:1])
    why = "is not for batches" if asked in _every() else f"is no command{close_to(asked, list(OUTPUTS))}"
    raise UsageError(
        f"{where}: {asked[:60]!r} {why}",
        consequence="No job is begun",
        cure=f"Choose one of {', '.join(OUTPUTS)}",
    )


def parameters(command: str) -> list[Any]:
    """Return what a command takes, as the parser has it, without what the batch sees to."""
    return [one for one in _parser(command).params if one.name not in OWN and one.name != "help"]


def checked_job(name: str, command: str, words: Sequence[str], settings: Mapping[str, object], where: str) -> Job:
    """Return a job of a command's words. Raises UsageError for what the command line would refuse."""
    try:
        given = _parsed(command, words)
    except _Misuse as error:
        raise UsageError(
            f"{where}: {command}: {' '.join(str(getattr(error, 'message', error)).split())}{_more(error, command)}",
            consequence="No job is begun",
            cure=f"Correct it; `armsight {command} --help` lists the flags",
        ) from None
    except typer.Exit:  # --help
        raise UsageError(f"{where}: {' '.join(words)[:80]} does nothing", cure="Leave --help away") from None
    moving = [flag for flag in NOBODY if given.get(flag) not in (None, False)]
    if moving:
        flag = "--live" if moving[0] == "robot" and command == "identify" else f"--{moving[0]}"
        raise UsageError(
            f"{where}: {command} with {flag} needs a robot and a person beside it",
            consequence="No job is begun",
            cure="Run it by itself; a batch is for what can be done again",
        )
    _check_out(given["out"], command, where)
    texts = tuple(dict.fromkeys(text for flag, value in given.items() if flag not in WRITTEN for text in _texts(value)))
    return Job(name=name, command=command, arguments={"words": list(words), "settings": settings}, inputs=texts)


def run_command(job: Job, folder: Path) -> Ended:
    """Run a job's command in this process, as the command line would with --json and -o in the folder."""
    words, settings = job.arguments["words"], job.arguments["settings"]
    end = _End()
    with _environment(settings):  # type: ignore[arg-type]  # as checked_job made them
        given = _parsed(job.command, words)  # type: ignore[arg-type]
        out, own = str(given["out"]), OUTPUTS[job.command]
        given["out"] = folder / (own if out == DEFAULT_OUT else out)
        given["json"] = False
        code = 0
        try:
            _command(job.command).run(functools.partial(_Caught, end), **given)
        except typer.Exit as ended:
            code = ended.exit_code
    said = end.said.getvalue()[:MOST_SAID]
    if end.crash is not None:
        return unforeseen(end.crash)
    if end.error is not None:
        return Ended.of(end.error, said)
    return Ended(figures=end.figures, exit_code=code, said=said)


class _End:
    """What a command left: its result or the error, and what it told the person."""

    def __init__(self) -> None:
        self.said = io.StringIO()
        self.figures: Mapping[str, object] | None = None
        self.error: ArmsightError | None = None
        self.crash: Exception | None = None


class _Caught(CommandUI):
    """The face of a command that nobody sees: what it tells is kept."""

    def __init__(self, end: _End, *, as_json: bool) -> None:
        super().__init__(as_json=as_json)
        self._end = end
        self.console = Console(file=end.said, highlight=False, markup=False, emoji=False, width=WIDTH)

    def progress(self, what: str) -> Bar:
        return _Quiet(what, self.console, self._stopped)

    def result(self, result: Output) -> None:
        self.given = result
        self._end.figures = json.loads(result.to_json())

    def _print_error(self, error: ArmsightError, *, as_json: bool) -> None:
        self._end.error = error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, MemoryError):  # not the data's fault: with fewer workers there may be enough
            error = DeviceFailed("there is not enough memory", cure="Give fewer workers (--jobs)")
        elif isinstance(error, Exception) and not isinstance(error, ArmsightError | OSError | typer.Exit | typer.Abort):
            self._end.crash = error
            raise typer.Exit(ArmsightError.exit_code) from None
        super().__exit__(kind, error, trace)


class _Quiet(Bar):
    """Progress of one job of many: the batch tells its own."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Say nothing."""


@contextlib.contextmanager
def _environment(settings: Mapping[str, object]) -> Iterator[None]:
    """Hold the settings of who began the batch, wherever this worker is."""
    from armsight.config.settings import PREFIX

    before = dict(os.environ)
    os.environ.update({PREFIX + name.upper(): str(value) for name, value in settings.items() if value is not None})
    try:
        yield
    finally:
        for name in settings:
            variable = PREFIX + name.upper()
            os.environ.pop(variable, None)
            os.environ.update({variable: before[variable]} if variable in before else {})


def _parsed(command: str, words: Sequence[str]) -> dict[str, Any]:
    """Return a command's arguments by name. Raises what typer raises of wrong ones."""
    parser = _parser(command)
    asked = list(words)
    if not {"-o", "--out"} & {word.partition("=")[0] for word in asked}:
        asked = ["-o", DEFAULT_OUT, *asked]
    context = parser.make_context(command, asked)
    return dict(context.params)


def _more(error: Exception, command: str) -> str:
    """Return what an error's own message leaves out: which flag it is of, or which was meant."""
    param = getattr(error, "param", None)
    if param is not None:
        name = param.opts[0] if param.param_type_name == "option" else param.human_readable_name
        return f" ({name})" if getattr(error, "message", "") else f"{name} is missing"
    flags = [flag for one in _parser(command).params for flag in one.opts]
    return close_to(str(getattr(error, "option_name", "")), flags)


def _check_out(out: object, command: str, where: str) -> None:
    """Raise UsageError for a -o that is no plain name of a file in the job's own folder."""
    text = "" if out is None else str(out)
    if text == DEFAULT_OUT:
        return
    if not OUTPUTS[command] or Path(text).name != text or text in ("-", ".", ".."):
        cure = f"Give a file's name alone, such as {OUTPUTS[command]}" if OUTPUTS[command] else "Leave it away"
        raise UsageError(
            f"{where}: -o {text}: each job writes into its own folder", consequence="No job is begun", cure=cure
        )


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, list | tuple):
        for one in value:
            yield from _texts(one)
    elif isinstance(value, str | Path) and str(value):
        yield str(value)


@functools.cache
def _parser(command: str) -> Any:
    found: Any = typer.main.get_command(_app())
    for name in command.split():
        found = found.commands[name]
    return found


@functools.cache
def _every() -> dict[str, Command]:
    from armsight.cli.examples import every_command

    return {name: getattr(info.callback, "armsight") for name, info in every_command(_app())}  # noqa: B009


def _command(name: str) -> Command:
    return _every()[name]


def _app() -> typer.Typer:
    from armsight.cli.commands import app  # with all commands; that module imports this one

    return app
