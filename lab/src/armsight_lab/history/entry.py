"""A run as the history holds it, and as a file where it could not be filed. Needs no package of the extra.

Poses and numbers of a run are told by names that are the same whatever found them: armsight_lab.history.figures.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any
from unicodedata import category, normalize

from armsight.errors import BadFile, UsageError
from armsight.fields import Doc
from armsight.records.output import Output, output
from armsight.store.atomic import read_bytes, write_json
from armsight.store.codec import read_output

LONGEST_CELL = 100
"""Letters of a cell's name."""
MOST_BYTES = 50_000_000
"""Of a file that holds a run: the largest results have a few hundred kilobytes."""


@output
class InputFile(Output):
    """What a run was given."""

    flag: Annotated[str, Doc("The flag that named it.")]
    path: Annotated[str, Doc("The path or source, as given.")]
    sha256: Annotated[
        str | None,
        Doc("Hash of the file's content; of a folder, of the names and hashes of its files; null of a live source."),
    ]


@output
class Quantity(Output):
    """A number of a result."""

    name: Annotated[str, Doc("Its name.")]
    value: Annotated[float | None, Doc("The number; null where the result has none.", unit="as unit says")]
    std: Annotated[float | None, Doc("Its standard deviation; null where none is told.", unit="as unit says")]
    unit: Annotated[str, Doc("m, rad, px, s ...; empty of a plain number.")]


@output
class StoredPose(Output):
    """A pose of a result."""

    name: Annotated[str, Doc("Its name.")]
    xyz_m: Annotated[tuple[float, float, float], Doc("Its place, m.")]
    quat_xyzw: Annotated[tuple[float, float, float, float], Doc("Its rotation as a quaternion.")]
    std: Annotated[
        tuple[float | None, ...],
        Doc(
            "Standard deviations of place, m, and of a small rotation about the parent's axes, rad; null: not told.",
            unit="m, rad",
        ),
    ]


@output
class RunHead(Output):
    """What is told of every run."""

    cell: Annotated[str, Doc("The cell.")]
    command: Annotated[str, Doc("The command.")]
    created: Annotated[str, Doc("When the result was made, UTC, as ISO 8601 with microseconds and Z.")]
    software: Annotated[str, Doc("What made it.")]
    verdict: Annotated[str, Doc("What the result says of itself; may be empty.")]
    trusted: Annotated[bool, Doc("Whether the result says that it can be trusted.")]
    exit_code: Annotated[int, Doc("Of the command.")]
    reason: Annotated[str, Doc("Why it is not to be trusted, or how it ended; may be empty.")]
    arm: Annotated[str, Doc("The arm's name; may be empty.")]
    joints: Annotated[str, Doc("Its joints from the base on: R, P, or ? where the result does not tell.")]


@output
class Entry(RunHead):
    """A run as it is filed."""

    inputs: Annotated[tuple[InputFile, ...], Doc("What it was given.")]
    figures: Annotated[tuple[Quantity, ...], Doc("All numbers of the result.")]
    parameters: Annotated[tuple[Quantity, ...], Doc("What was calibrated, by names that all kinds of results share.")]
    poses: Annotated[tuple[StoredPose, ...], Doc("Poses that were calibrated.")]
    result: Annotated[dict[str, Any], Doc("The result's whole JSON object.", unit="as named")]

    @property
    def fingerprint(self) -> str:
        """What tells this run from all others: the same one is filed once."""
        content = json.dumps([self.cell, self.command, self.created, self.result], sort_keys=True, default=str)
        return hashlib.sha256(content.encode()).hexdigest()


FORMAT = "armsight/history-entry"


def write_entry(path: Path, entry: Entry) -> None:
    """Write a run to a file that `armsight history add` files later. Raises DeviceFailed."""
    write_json(path, {"format": FORMAT, "version": 1, **entry.to_dict()})


def entry_of(content: Mapping[str, Any], where: str) -> Entry:
    """Return the run that such a file holds. Raises BadFile that names the key."""
    held = {key: value for key, value in content.items() if key not in ("format", "version")}
    return read_output(Entry, held, where)


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file. Raises BadFile."""
    try:
        content = json.loads(read_bytes(path, limit=MOST_BYTES))
    except (ValueError, RecursionError) as error:
        raise BadFile(
            f"{path}: is no JSON ({str(error)[:80]})",
            consequence="It is not filed",
            cure="Give what --json printed, a verify.json, or a YAML file that a calibration wrote",
        ) from error
    if not isinstance(content, dict):
        raise BadFile(f"{path}: holds no JSON object", consequence="It is not filed", cure="Give what --json printed")
    return content


def cell_name(given: str) -> str:
    """Return a cell's name, composed letters as one. Raises UsageError for what cannot be one."""
    name = normalize("NFC", given)
    why = ""
    if not name.strip():
        why = "is empty"
    elif name != name.strip():
        why = "begins or ends with a space"
    elif len(name) > LONGEST_CELL:
        why = f"has {len(name)} letters, and at most {LONGEST_CELL} are kept"
    elif any(category(letter) in ("Cc", "Cf", "Cs", "Zl", "Zp") for letter in name):
        why = "holds a letter that cannot be seen (a line break, a tab, a control or formatting letter)"
    if why:
        raise UsageError(
            f"the cell's name {given[:40]!a} {why}",
            consequence="Nothing was done",
            cure="Give a name such as --cell weld-3",
        )
    return name


def number(value: object) -> float | None:
    """Return a finite number, None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def deviation(value: object) -> float | None:
    """Return a standard deviation, None for what is none: nothing is known exactly."""
    found = number(value)
    return found if found is not None and found > 0.0 else None


def stored_pose(name: str, pose: Mapping[str, Any], std: Sequence[float | None]) -> StoredPose:
    """Return a pose as JSON objects hold it ({xyz_m, quat_xyzw}) with its six deviations."""
    x, y, z = (float(value) for value in pose["xyz_m"])
    a, b, c, d = (float(value) for value in pose["quat_xyzw"])
    return StoredPose(name=name, xyz_m=(x, y, z), quat_xyzw=(a, b, c, d), std=tuple(std))


DAY_S = 86_400.0


def utc(moment: datetime) -> str:
    """Return a moment as the history holds it, so that texts sort as moments do."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def moment(given: str) -> datetime:
    """Return a moment in ISO 8601, UTC where it tells no zone. Raises UsageError."""
    try:
        found = datetime.fromisoformat(given)
    except ValueError:
        raise UsageError(
            f"{given[:40]!r} is no day or moment",
            consequence="Nothing was done",
            cure="Write 2026-11-26 or 2026-11-26T14:00, in UTC; of another zone 2026-11-26T14:00+01:00",
        ) from None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)


def whole_moment(given: str) -> str:
    """Return a moment as the history holds it. Raises UsageError."""
    return utc(moment(given))


def optional_moment(given: str | None) -> str | None:
    """Return a moment as the history holds it, None for none. Raises UsageError."""
    return None if given is None else whole_moment(given)


def day_of(held: str) -> float:
    """Return a moment of the history in days since 1970."""
    return datetime.fromisoformat(held).timestamp() / DAY_S


def other_arm(a: str, b: str) -> bool:
    """Tell whether joints (R, P, ? each) are of two arms; '' is of none."""
    if not a or not b:
        return False
    return len(a) != len(b) or any("?" not in pair and pair[0] != pair[1] for pair in zip(a, b, strict=True))
