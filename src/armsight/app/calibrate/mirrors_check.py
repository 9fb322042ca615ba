"""How a mirror rig's mirrors stand, frame by frame, and which is to be turned how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from armsight.app.calibrate.board_pictures import BoardPictures
from armsight.app.calibrate.mirrors import Pair, board_name, complex_views
from armsight.app.calibrate.results import (
    CheckedAlignment,
    MirrorCheckOutput,
    PoseChange,
)
from armsight.app.requests.calibrate_cameras import MirrorsJob
from armsight.calibrate.mirrors.adjustment import Adjustment, adjust_to_parallel
from armsight.calibrate.mirrors.diagnosis import Alignment, check_alignment
from armsight.drivers import is_live
from armsight.errors import NotEnoughData, UsageError
from armsight.optics import Camera, Plate, Rig
from armsight.optics.mirrors import Mirrors
from armsight.records import NotSeen, Progress, Silent, Target
from armsight.records.output import keys
from armsight.store import parse_board, read_camera, read_rig

KEPT = 8
"""Frames that a live check looks back on: a turned screw should show."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """What the mirrors are held against: a rig as it was calibrated; or, None, parallel axes seen through a lens that
    is known. design: where the mirrors stand."""

    design: Mirrors
    rig: Rig | None = None
    camera: Camera | None = None


def reference_of(job: MirrorsJob) -> Reference:
    """Return what a job's mirrors are held against. Raises UsageError where too little is known, BadFile."""
    if job.rig is not None:
        rig = read_rig(job.rig)
        plate = rig.left.plate or Plate(thickness_m=job.thickness_m or 1e-3, index=job.index)
        design = _design(job, job.baseline_m or rig.baseline_m, plate)
        return Reference(camera=rig.left, design=design) if job.parallel else Reference(rig=rig, design=design)
    if job.camera is None or job.baseline_m is None:
        raise UsageError(
            "nothing to hold the mirrors against",
            cure="Give --rig rig.yaml, as it was calibrated; or, to make the axes parallel, --camera camera.yaml (the "
            "lens) and --baseline-mm (as designed)",
        )
    plate = Plate(thickness_m=job.thickness_m or 1e-3, index=job.index)
    return Reference(camera=read_camera(job.camera), design=_design(job, job.baseline_m, plate))


def _design(job: MirrorsJob, baseline_m: float, plate: Plate) -> Mirrors:
    return Mirrors(baseline_m=baseline_m, plate=plate, near_m=job.near_m, gap_m=job.gap_m)


@dataclass(slots=True, kw_only=True)
class AlignmentWatch:
    """Holds the mirrors against a reference, by the last views of a board; back: how many of them, None all."""

    reference: Reference
    board: Target
    back: int | None = KEPT
    _kept: list[Pair] = field(default_factory=list)

    def see(self, pair: Pair) -> Alignment | Adjustment:
        """Return how the mirrors stand with one more pair of views. Raises Inconsistent, NotEnoughData."""
        self._kept = [*self._kept, pair][-(self.back or 0) :]
        left, right = [a for a, _ in self._kept], [b for _, b in self._kept]
        reference = self.reference
        if reference.rig is not None:
            return check_alignment(reference.rig, left, right, self.board, design=reference.design)
        if reference.camera is None:
            raise UsageError("nothing to hold the mirrors against", cure="Give a rig, or the lens")
        return adjust_to_parallel(reference.camera, reference.design, left, right, self.board)


def run_check(job: MirrorsJob, progress: Progress | None = None) -> MirrorCheckOutput:
    """Tell how the mirrors stand against the rig as it was calibrated, or against parallel axes, frame by frame.

    Goes on until the frames end, job.limit is reached or it is cancelled; the answer is of the last frames. Raises
    UsageError, DataRefused or DeviceFailed.
    """
    progress = progress or Silent()
    if job.image is None:
        raise UsageError("nothing to check", cure="Give --image, and --rig rig.yaml as it was calibrated")
    if job.target is not None:
        raise UsageError(
            "mirrors are checked with a board, not with the lit target, whose lights turned mirrors pair wrongly",
            cure="Leave --target out and give --board",
        )
    board = parse_board(board_name(job))
    watch = AlignmentWatch(reference=reference_of(job), board=board, back=KEPT if is_live(job.image) else None)
    missed: list[str] = []
    last: Alignment | Adjustment | None = None
    for number, (source, seen) in enumerate(complex_views(job, board, BoardPictures()), 1):
        if isinstance(seen, NotSeen):
            missed.append(f"{source}: {seen.why}")
            progress.update(number, job.limit or 0, seen.why)
        else:
            last = watch.see(seen)
            progress.update(number, job.limit or 0, _line(last))
        if progress.cancelled():
            break
    if last is None:
        raise NotEnoughData(
            f"the board was found in both views of none of the images; {missed[0] if missed else 'there are none'}",
            consequence="The alignment is not known",
            cure="Show the whole board in both views",
        )
    return check_output(last, missed)


def _line(found: Alignment | Adjustment) -> str:
    now = found.now
    return (
        f"convergence {1e3 * now.convergence_rad:+.2f} mrad, vertical {now.vertical_px:+.2f} px, "
        f"roll {1e3 * now.roll_rad:+.2f} mrad; {found.advice()}"
    )


def check_output(found: Alignment | Adjustment, missed: Sequence[str]) -> MirrorCheckOutput:
    """Return a check of the alignment as --json gives it."""
    names = [key.attribute for key in keys(PoseChange)]
    if isinstance(found, Adjustment):
        change, std = (np.concatenate([np.zeros(3), part]) for part in (found.rotation_rad, found.std_rad))
        moved, certain, suspects = not found.parallel, False, []
        turns = list(found.turns)
    else:
        change, std, moved, certain, turns = found.change, found.std, found.moved, found.certain, None
        suspects = list(found.suspects)
    return MirrorCheckOutput(
        alignment=CheckedAlignment(
            **{name: getattr(found.now, name) for name in (key.attribute for key in keys(CheckedAlignment))}
        ),
        change=PoseChange(**dict(zip(names, change.tolist(), strict=True))),
        change_std=PoseChange(**dict(zip(names, std.tolist(), strict=True))),
        moved=moved,
        certain=certain,
        suspects=suspects,
        turns=turns,
        advice=[found.advice()],
        n_views=found.n_views,
        missed=list(missed),
    )
