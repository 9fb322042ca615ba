"""A result's files and page, as the action that gives it names them; a record's file, of which the ending decides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

from armsight.fields import loaded
from armsight.file_names import REPORT, report_path
from armsight.ops import actions
from armsight.ops.action import Action, Given, action_of
from armsight.records.output import Output
from armsight.store import write_text
from armsight.store.saving import WRITERS, YAML, file_to_write


@cache
def _by_result() -> Mapping[str, Action]:
    """Return the actions by the name of the class that their function says to return, the first of several."""
    done = [action_of(call) for call in reversed([*actions()])]
    return {name: one for one in done for name in one.function.__annotations__["return"].split(" | ")}


def action_giving(result: object) -> Action | None:
    """Return the action that gives results of this class, or of its nearest base; None where none does."""
    if not isinstance(result, Output):
        return None
    return next((done for kind in type(result).__mro__ if (done := _by_result().get(kind.__name__))), None)


def _writer(place: str) -> Callable[..., Any]:
    """Return a function of store.saving, or of the module that its place names."""
    made: Callable[..., Any] = loaded(place if ":" in place else f"armsight.store.saving:{place}")()
    return made


def save(record: object, path: str | PathLike[str]) -> Path:
    """Write a record's file and return its path. Raises UsageError for another ending or no such folder, DeviceFailed.

    Raises TypeError for a record that has no file.
    """
    known = next((WRITERS[kind.__name__] for kind in type(record).__mro__ if kind.__name__ in WRITERS), {})
    writers = {ending: f"armsight.store.{place}" for ending, place in known.items()}
    if (done := action_giving(record)) is not None and isinstance(done.writes, str):
        writers = {**dict.fromkeys(("",) if done.keeps else YAML, done.writes), **writers}
    if not writers:
        raise TypeError(f"{type(record).__name__} has no file of its own; {path} is not written")
    file = file_to_write(path, *writers)
    _writer(writers[file.suffix.lower()])(file, record)
    return file


def write_with_page(out: Path, result: Any, files: Sequence[Path] = (), given: Given = MappingProxyType({})) -> None:
    """Write a result's files, with the hashes of the files that went in, and its page beside them. Raises DeviceFailed.

    given: what the action was called with, of which the page tells.
    """
    done = action_giving(result)
    if done is None or not isinstance(done.writes, str):
        result.write(out)
        return
    _writer(done.writes)(out, result, inputs=files)
    if (page := page_path(out, result)) is not None:
        write_text(page, loaded(f"armsight.report.{done.page}")()(result, files, given))


def page_path(out: Path, result: object) -> Path | None:
    """Return where a result's page goes, None where it has none: into the folder, or beside a file, rig.report.html."""
    done = action_giving(result)
    if done is None or not done.page:
        return None
    return out / REPORT if done.keeps else report_path(out)
