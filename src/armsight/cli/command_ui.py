"""What every command shares: progress, messages, exit codes, one JSON object, Ctrl-C."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self, TextIO
from unicodedata import category

import typer
from rich.console import Console

from armsight._files import readable
from armsight.cli import discard
from armsight.errors import ArmsightError, Cancelled, DataRefused, DeviceFailed, UsageError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from armsight.records.output import Output
    from armsight.records.result_parts import Verdict

UNFORESEEN = 1
PRIVATE = 0o600
UNSEEN = ("Cc", "Cf", "Cs")
"""Kinds of letters that are not shown but do something: control, formatting (right to left) and halves of letters."""
STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what a service manager sends: both bring the work to its end, a second one stops it at once."""
LONGEST_SHOWN = 60
"""Letters of a name that the system found too long."""
LINE_EVERY_S = 5.0
"""How often progress is told where there is no terminal to draw a bar on."""
DRAW_EVERY_S = 0.1
"""How often a status line is drawn where there is one."""


def own_command() -> str:
    """Return how this armsight is called from here: by its name where the shell finds it, else by where it is."""
    own, found = Path(sys.executable).parent / "armsight", shutil.which("armsight")
    if not own.exists():
        return "armsight" if found else f"{sys.executable} -m armsight"
    if found is not None and own.samefile(found):
        return "armsight"
    return str(own.relative_to(Path.cwd())) if own.is_relative_to(Path.cwd()) else str(own)


def verdict_of(result: Output | None) -> Verdict | None:
    """Return what a result comes to; None of those that give no verdict."""
    found: Verdict | None = getattr(result, "verdict_", None)
    return found


class CommandUI:
    """One command's way to the person: used as a context manager round its work.

    Everything for people goes to stderr. With as_json, stdout carries one JSON object and nothing else: the result,
    or {"error": {...}}. Errors end the program with their exit code. Ctrl-C ends work with exit code 130: at its next
    step where it asks for that, else at once; until_stopped: the work has no other end, which is then a good one.
    """

    def __init__(self, *, as_json: bool, until_stopped: bool = False) -> None:
        self._as_json = as_json
        self.until_stopped = until_stopped
        # rich's own type of a file has more than what it calls
        self.console = Console(file=_Heard(sys.stderr), highlight=False, markup=False, emoji=False)  # type: ignore[arg-type]
        self.given: Output | None = None
        """The command's result, once it is given."""
        self._stopped = threading.Event()
        self._before: list[tuple[int, Any]] = []
        self._bar: Bar | None = None
        self._listener: Bar | None = None
        self.held = contextlib.ExitStack()  # what lasts as long as the command

    def progress(self, what: str) -> Bar:
        """Return the progress of a piece of work; the one before it ends."""
        self._end_bar()
        self._bar = self._listener = Bar(what, self.console, self._stopped)
        return self._bar

    def say(self, text: str) -> None:
        """Print a line for the person."""
        self._end_bar()
        self.console.print(visible(text), soft_wrap=True)

    def table(self, title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table for the person; the first column is text, the others are numbers."""
        from rich.table import Table

        self._end_bar()
        table = Table(title=title, title_justify="left", show_header=any(header))
        for column, name in enumerate(header):
            table.add_column(name, justify="left" if column == 0 else "right")
        for row in rows:
            table.add_row(*(visible(cell) for cell in row))
        self.console.print(table)

    def result(self, result: Output) -> None:
        """Give the command's result; printed only with --json."""
        self._end_bar()
        self.given = result
        if (verdict := verdict_of(result)) is not None:
            self.say(f"Verdict: {verdict.level}. {verdict.headline}. {' '.join(verdict.next)}")
        if self._as_json:
            _print_json(result.to_json())

    def moves(self, *, yes: bool) -> Callable[[str], bool]:
        """Return what says how a robot would move, and asks whether it may unless that is agreed to."""

        def confirm(question: str) -> bool:
            self.say(question)
            return yes or agreed("Move?")

        return confirm

    def __enter__(self) -> Self:
        os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # OpenCV's own complaints repeat ours without a cure
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        if threading.current_thread() is threading.main_thread():
            self._before = [(number, signal.signal(number, self._interrupt)) for number in STOPPING]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_bar()
        self.held.close()
        for number, handler in self._before:
            signal.signal(number, handler)
        if error is None and self._stopped.is_set() and not self.until_stopped:
            self._print_error(Cancelled("what was done until then is kept"), as_json=False)
            raise typer.Exit(Cancelled.exit_code)
        if error is None or isinstance(error, typer.Exit):
            return
        if isinstance(error, KeyboardInterrupt | typer.Abort):
            error = Cancelled("before it was done", consequence="What was not yet written stays as it was")
        if isinstance(error, MemoryError) or (
            isinstance(error, OSError) and (error.filename is not None or error.errno == errno.ENOENT)
        ):
            error = _refused_by_system(error)
        if isinstance(error, ArmsightError):
            self._print_error(error, as_json=self._as_json)
            raise typer.Exit(error.exit_code) from None
        if isinstance(error, Exception):
            self._print_error(unforeseen(error), as_json=self._as_json)
            raise typer.Exit(UNFORESEEN) from None

    def _print_error(self, error: ArmsightError, *, as_json: bool) -> None:
        head = "stopped" if isinstance(error, Cancelled) else "error"
        style = "bold red" if self.console.is_terminal else ""
        text = visible(str(error))
        self.console.print(text if text.startswith(head) else f"{head}: {text}", style=style, soft_wrap=True)
        if as_json:
            with contextlib.suppress(DeviceFailed):  # nobody reads: the exit code tells
                _print_json(_refusal(error))

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        heard = self.until_stopped if self._listener is None else self._listener.listens
        if self._stopped.is_set() or not heard:
            raise KeyboardInterrupt
        self._stopped.set()
        self.console.print("stopping ... (Ctrl-C again to stop at once)")

    def _end_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


class _Heard:
    """Standard error, whose loss (a full disk, a closed terminal) costs the words and not the work."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, text: str) -> int:
        """Write, or not."""
        with contextlib.suppress(OSError):
            self._file.write(text)
        return len(text)

    def flush(self) -> None:
        """Hand on, or not."""
        with contextlib.suppress(OSError):
            self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


class Bar:
    """A Progress drawn as a bar on a terminal, told in a line now and then elsewhere."""

    def __init__(self, what: str, console: Console, stopped: threading.Event) -> None:
        self._what = what
        self._console = console
        self._stopped = stopped
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._printed_s = time.monotonic()
        self._first: tuple[float, float] | None = None
        self._note = ""
        self._label = ""
        self.listens = False
        """Whether the work has asked for an end: before, nobody would hear of it."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Show that done of total is finished; total 0 means unknown. A new note begins the clock anew."""
        if note != self._note:
            self._note, self._first = note, None
        if self._first is None and done:
            self._first = (done, time.monotonic())  # what came before, compilation for one, is not the pace of the rest
        label = visible(f"{self._what}: {note}" if note else self._what)
        if self._console.is_terminal:
            self._draw(label, done, total)
        else:
            self._line(label, done, total)

    def cancelled(self) -> bool:
        """Tell whether Ctrl-C was pressed."""
        self.listens = True
        return self._stopped.is_set()

    def close(self) -> None:
        """Leave the bar as it stands."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _draw(self, label: str, done: float, total: float) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        if self._bar is None:
            name, speed = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[pace]}")
            columns = (name, BarColumn(), MofNCompleteColumn(), speed)
            self._bar = Progress(*columns, console=self._console)
            self._task = self._bar.add_task(label, total=total or None, pace="")
            self._bar.start()
        if self._task is not None:
            pace = self._pace(done, total)
            self._bar.update(self._task, description=label, completed=done, total=total or None, pace=pace)

    def _line(self, label: str, done: float, total: float) -> None:
        now_s = time.monotonic()
        finished = 0 < total <= done
        if now_s - self._printed_s < LINE_EVERY_S and not finished and label == self._label:
            return
        self._label, self._printed_s = label, now_s
        if not done:
            self._console.print(f"{label} ...", soft_wrap=True)
            return
        count = f"{done:.0f} of {total:.0f}" if total else f"{done:.0f}"
        parts = [f"{label} {count}", self._pace(done, total)]
        self._console.print(", ".join(filter(None, parts)), soft_wrap=True)

    def _pace(self, done: float, total: float) -> str:
        rate = self._rate(done)
        if not rate:
            return ""
        left = f", {time_left((total - done) / rate)} left" if done < total else ""
        return f"{rate:.1f} a second{left}"

    def _rate(self, done: float) -> float:
        if self._first is None:
            return 0.0
        first, at_s = self._first
        passed_s = time.monotonic() - at_s
        return (done - first) / passed_s if passed_s > 0.2 else 0.0


class StatusLine:
    """One line on the terminal, drawn again and again; elsewhere a line now and then, and at every change of state."""

    def __init__(self, face: CommandUI) -> None:
        self._console = face.console
        self._printed_s = 0.0
        self._before: object = None

    def due(self, state: object) -> bool:
        """Tell whether the line is to be told now, of this state."""
        now_s = time.monotonic()
        every_s = DRAW_EVERY_S if self._console.is_terminal else LINE_EVERY_S
        if state == self._before and now_s - self._printed_s < every_s:
            return False
        self._printed_s, self._before = now_s, state
        return True

    def draw(self, line: str) -> None:
        """Tell it."""
        if self._console.is_terminal:
            width = self._console.width - 1
            self._console.print(line[:width].ljust(width), end="\r", markup=False, soft_wrap=True)
        else:
            self._console.print(line, markup=False, soft_wrap=True)


def agreed(question: str) -> bool:
    """Ask the person; where nobody is there to answer, that is no."""
    try:
        return typer.confirm(question, err=True)
    except typer.Abort:
        return False


def time_left(seconds: float) -> str:
    """Return how long something still takes, as people say it: no more exact than such a guess is."""
    if seconds < 90.0:
        return f"about {seconds:.0f} s"
    return f"about {seconds / 60.0:.0f} min" if seconds < 5400.0 else f"about {seconds / 3600.0:.1f} h"


def _refusal(error: ArmsightError) -> str:
    """Return RefusalOutput as JSON, without its imports: they may be what was interrupted."""
    refusal = {
        "kind": type(error).__name__,
        "cause": error.cause,
        "consequence": error.consequence,
        "cure": error.cure,
        "exit_code": error.exit_code,
    }
    return readable(json.dumps({"error": refusal}, ensure_ascii=False))


def _refused_by_system(error: OSError | MemoryError) -> ArmsightError:
    """Return what the system said of a file, or of memory, as an error with a cure."""
    if isinstance(error, MemoryError):
        return DataRefused(
            "there is not enough memory", consequence="Nothing was done", cure="Give fewer or smaller data"
        )
    name = "the folder that you are in" if error.filename is None else str(error.filename)
    name = name if len(name) <= LONGEST_SHOWN else f"{name[:LONGEST_SHOWN]}..."
    if error.errno == errno.ENAMETOOLONG:
        return UsageError(f"the name is too long for this disk: {name}", cure="Give a shorter one")
    return DeviceFailed(
        f"{name}: {error.strerror or error}",
        consequence="It was not done",
        cure="Check that the file or folder is still there, its permissions, and the free space",
    )


def unforeseen(error: Exception) -> ArmsightError:
    """Write the traceback to a log file and return one line that says where."""
    path = log_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # a new file for its owner alone: in a folder that all may write to, another's link could lead anywhere
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE)
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{' '.join(sys.argv)}\n{''.join(traceback.format_exception(error))}")
        where = f"The details are in {path}"
    except OSError:
        where = "The details could not be written to a file"
    first = (str(error).splitlines() or [""])[0]
    return ArmsightError(f"armsight met something it does not know: {type(error).__name__}: {first}"[:300], cure=where)


def visible(text: str) -> str:
    """Return text with what a terminal would obey written out: files name things, and anybody may have written them."""
    text = readable(text)
    return "".join(one if one in "\n\t" or category(one) not in UNSEEN else repr(one)[1:-1] for one in text)


def _print_json(text: str) -> None:
    """Write to standard output. Raises DeviceFailed where it is full, or nobody reads it any more."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(json.loads(text))  # JSON's own way to write what this code page has not
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        discard(sys.stdout)
        raise DeviceFailed(
            f"standard output cannot be written ({error.strerror or error})",
            consequence="Files are written as they would be; what a program should read is lost",
            cure="Check where the output goes",
        ) from error


def log_path() -> Path:
    """Return a new log file's path: in $ARMSIGHT_LOG_FOLDER, else where the system keeps programs' state."""
    state = os.environ.get("XDG_STATE_HOME")
    home = Path(state) if state else Path.home() / ".local" / "state"
    given = os.environ.get("ARMSIGHT_LOG_FOLDER")
    folder = Path(given) if given else home / "armsight"
    if not given and not os.access(next(path for path in (folder, *folder.parents) if path.exists()), os.W_OK):
        folder = Path(tempfile.gettempdir())
    return folder / f"armsight-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
