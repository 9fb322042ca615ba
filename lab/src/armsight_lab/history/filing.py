"""A run filed after its command: its result is written by then, and stays whatever becomes of the filing."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from armsight._version import __version__
from armsight.errors import ArmsightError
from armsight.kinematics import Arm
from armsight.records.output import Output
from armsight.store.atomic import sha256
from armsight_lab.history.entry import Entry, InputFile, cell_name, utc, write_entry
from armsight_lab.history.figures import Content, Parameters, figures_of, parameters_of
from armsight_lab.history.place import Place, place_of, require_packages

PLANS = ("VerifyPlanOutput", "MasteringPlanOutput", "ProposedPlanOutput")
"""Results that say what to measure, and hold nothing that was."""
ARMS = ("arm", "model")
"""Flags that may name an arm that comes with armsight."""
LARGEST_HASHED = 4_000_000_000
"""Bytes of an input beyond which it has no hash: reading it again would take longer than most commands."""
OUTPUTS = ("out", "record", "log", "cell", "history")
MOST_UNFILED = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Filing:
    """What is to be filed: the result of a command, of a cell, at a place. given: the flags' values by name."""

    command: str
    cell: str
    place: Place
    given: Mapping[str, Any]

    def file(self, result: Output, exit_code: int, reason: str) -> list[str]:
        """File a result; return what to tell the person. Never raises for what a history may refuse."""
        if type(result).__name__ in PLANS:
            return ["Not filed: a plan holds nothing that was measured."]
        entry = self._entry(result, exit_code, reason)
        try:
            from armsight_lab.history.adding import added

            return added(self.place, entry)
        except ArmsightError as error:
            return [f"NOT FILED in the history: {error} The result itself is written.", self._kept(entry)]

    def _entry(self, result: Output, exit_code: int, reason: str) -> Entry:
        arm = getattr(result, "arm", None)
        content = json.loads(result.to_json())
        found = parameters_of(content, arm if isinstance(arm, Arm) else None)
        inputs, now = _inputs(self.given), utc(datetime.now(UTC))
        made = {"command": self.command, "cell": self.cell, "created": now, "reason": reason}
        return entry_of_result(content, found, inputs, exit_code=exit_code, **made)

    def _kept(self, entry: Entry) -> str:
        """Write the run beside its result, to be filed later; return what to tell."""
        out = self.given.get("out")
        if not isinstance(out, Path):
            return "File the result later: armsight history add RESULT --cell NAME"
        stem = out / "run" if out.is_dir() else out.with_suffix("")
        names = (Path(f"{stem}.unfiled{'' if i == 1 else f'-{i}'}.json") for i in range(1, MOST_UNFILED))
        path = next(name for name in names if not name.exists())
        try:
            write_entry(path, entry)
        except ArmsightError as error:
            return f"Nor could it be kept for later: {error}"
        return f"The run is kept in {path}; file it later: armsight history add {path}"


def filing(command: str, cell: str | None, history: str | None, given: Mapping[str, Any]) -> Filing | None:
    """Return what files a command's result, None where no cell is named. Before any work is done.

    Raises UsageError for a name that cannot be one, a place that is none, and packages that are missing.
    """
    if cell is None:
        return None
    place = place_of(history)
    name = cell_name(cell)
    require_packages(place)
    return Filing(command=command, cell=name, place=place, given=given)


def entry_of_result(
    content: Content,
    found: Parameters,
    inputs: Iterable[InputFile],
    *,
    command: str,
    cell: str,
    created: str,
    exit_code: int = 0,
    reason: str = "",
) -> Entry:
    """Return a run as the history holds it, of a result's JSON object. created: as the history holds moments."""
    concerns = content.get("concerns")
    doubts = "; ".join(map(str, concerns)) if isinstance(concerns, list) else ""
    return Entry(
        cell=cell,
        command=command,
        created=created,
        software=f"armsight {__version__}",
        verdict=str(content.get("verdict") or ""),
        trusted=exit_code == 0 and not doubts,
        exit_code=exit_code,
        reason=reason or doubts,
        arm=found.arm[:200],
        joints=found.joints[:60],
        inputs=tuple(inputs),
        figures=figures_of(content),
        parameters=found.quantities,
        poses=found.poses,
        result=dict(content),
    )


def _inputs(given: Mapping[str, Any]) -> Iterator[InputFile]:
    """Yield what of the flags' values is read: files, folders, patterns, live sources, arms by name."""
    seen = set()
    for flag, value in given.items():
        for one in _values(value) if flag not in OUTPUTS else ():
            text = _shown(str(one))
            if (flag, text) in seen or not (isinstance(one, Path) or _is_source(flag, str(one))):
                continue
            seen.add((flag, text))
            yield InputFile(flag=flag, path=text[-1000:], sha256=hash_of(str(one)))


def _values(value: object) -> Iterator[object]:
    if isinstance(value, list | tuple):
        for one in value:
            yield from _values(one)
    elif isinstance(value, str | Path) and str(value):
        yield value


def _is_source(flag: str, text: str) -> bool:
    return flag in ARMS or "camera:" in text or "://" in text or bool(_files(text))


def _shown(text: str) -> str:
    return re.sub(r"(://)[^/@]*@", r"\1", text)  # a camera's address may hold a password


def _files(text: str) -> Sequence[Path]:
    """Return the files that a path, folder or pattern names."""
    try:
        path = Path(text)
        if path.is_dir():
            return sorted(one for one in path.iterdir() if one.is_file())
        if path.is_file():
            return [path]
        if not re.search(r"[*?\[]", text):
            return []
        return sorted(one for one in Path(path.anchor).glob(str(path.relative_to(path.anchor))) if one.is_file())
    except (OSError, ValueError):  # a text that is no path at all
        return []


def hash_of(text: str) -> str | None:
    """Return the hash of a file's content; of several that of their names and hashes; None where there is none."""
    files = _files(text)
    try:
        if not files or sum(one.stat().st_size for one in files) > LARGEST_HASHED:
            return None
        if len(files) == 1 and Path(text).is_file():
            return sha256(files[0])
        lines = "".join(f"{sha256(one)}  {one.name}\n" for one in files)
        return hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()
    except (OSError, ArmsightError):
        return None
