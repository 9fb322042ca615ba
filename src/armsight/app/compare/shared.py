"""What two measurements share: told by the fingerprints that measure.json keeps of rig and target."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from armsight.app.measure.outputs import SUMMARY
from armsight.errors import BadFile
from armsight.measure.results import MadeWith
from armsight.store.atomic import read_bytes
from armsight.store.codec import read_output

MAX_SUMMARY_BYTES = 100_000_000


@dataclass(frozen=True, slots=True)
class Shared:
    """Whether two measurements were made with one rig and one target; None: not recorded of one of them."""

    rig: bool | None
    target: bool | None

    @property
    def warning(self) -> str:
        """What the verdict must add: empty where nothing is known to differ."""
        other = [name for name, same in (("rig", self.rig), ("target", self.target)) if same is False]
        return f"They were measured with another {' and another '.join(other)}." if other else ""

    @property
    def notes(self) -> list[str]:
        """What to know of the comparison."""
        if self.rig is None:
            return [
                "Not recorded of both: which rig and target they were measured with (no measure.json beside poses.csv)."
            ]
        told = {
            (True, True): "One rig and one target: what is wrong with either is in both, and is not seen here.",
            (
                False,
                True,
            ): "Two rigs, or one calibrated anew: each brings its own errors, and its own axes where no world "
            "is given.",
            (
                True,
                False,
            ): "Two targets, or one measured anew: each has its own axes, and poses of two targets differ by that.",
            (False, False): "Two rigs and two targets: their axes and errors are in the differences.",
        }
        return [told[self.rig, bool(self.target)]]


def shared(a: Path, b: Path) -> Shared:
    """Tell of two poses.csv what their measurements share. Raises BadFile for a measure.json that is none."""
    first, second = _made_with(a.with_name(SUMMARY)), _made_with(b.with_name(SUMMARY))
    if first is None or second is None:
        return Shared(None, None)
    return Shared(first.rig == second.rig, first.target == second.target)


def _made_with(path: Path) -> MadeWith | None:
    """Return what measure.json keeps of rig and target; None where it, or they in it, are not there."""
    if not path.exists():
        return None
    try:
        held = json.loads(read_bytes(path, limit=MAX_SUMMARY_BYTES))
        told = held.get("made_with") if isinstance(held, dict) else None
        return None if told is None else read_output(MadeWith, told, str(path))
    except (ValueError, ValidationError, RecursionError) as error:
        raise BadFile(
            f"{path}: not the summary of a measurement ({str(error).splitlines()[0]})",
            consequence="Whether both runs had one rig and target cannot be told",
            cure="Give the folder that `armsight measure -o` wrote, or poses.csv copied out of it",
        ) from error
