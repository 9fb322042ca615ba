"""Frames of a lit target in, the positions of its lights out: target.yaml."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from itertools import islice

from armsight.app.requests.calibrate_cameras import TargetJob
from armsight.app.sources.frames import complex_pairs, open_pairs, open_source
from armsight.calibrate.light_target import LitFrame, TargetCalibration, calibrate_target
from armsight.drivers import PairSource
from armsight.errors import Cancelled, UsageError
from armsight.measure.poses.beacon import without_standing
from armsight.measure.poses.pairs import pair_spots
from armsight.measure.poses.pipeline import check_sizes
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.optics import PackedRig, Rig
from armsight.records import Frame, Progress, Silent, Spots
from armsight.store import read_rig, write_target

Pair = tuple[Frame, Frame]


def calibrate_lit_target(job: TargetJob, progress: Progress | None = None) -> TargetCalibration:
    """Find the target's geometry, write target.yaml, and return the figures as --json gives them.

    Raises UsageError, DataRefused (frames of another size, and as calibrate_target), DeviceFailed, Cancelled.
    """
    rig = read_rig(job.rig)
    settings = SpotSettings(threshold=job.threshold, inverted=job.inverted)
    if (job.image is None) == (job.left is None):
        raise UsageError("which frames?", cure="Give --left and --right, or --image with both views in one image")
    if job.image is None:
        source, overlaid = open_pairs(job.left, job.right, settings=job.camera_settings), False
    else:
        source, overlaid = complex_pairs(partial(open_source, job.image, settings=job.camera_settings), rig)
    with source as pairs:
        frames = _lit_frames(rig, pairs, settings, job.limit, progress or Silent())
    done = calibrate_target(rig, frames, job.lights, overlaid=overlaid)
    write_target(job.out, done.target, inputs=[job.rig], std_m={name: list(std) for name, std in done.std.items()})
    return done


def lit_frame(packed: PackedRig, name: str, left: Spots, right: Spots, *, overlaid: bool = False) -> LitFrame:
    """Return the pairs of a moment's spots that agree with the epipolar lines; overlaid: see pair_spots."""
    index = pair_spots(packed, left, right, overlaid=overlaid).index
    return LitFrame(name=name, left=left.take(index[:, 0]), right=right.take(index[:, 1]))


def _lit_frames(
    rig: Rig, pairs: PairSource, settings: SpotSettings, limit: int | None, progress: Progress
) -> list[LitFrame]:
    packed, seen = PackedRig.of(rig), []
    total = min(limit or pairs.total, pairs.total) if pairs.total else limit or 0
    found: Iterable[Pair] = islice(pairs, limit)
    for left, right in found:
        check_sizes(rig, left, right, "The calibration says nothing about such frames; no target is given")
        overlaid = left is right
        at_left = find_spots(left.image, settings)
        at_right = at_left if overlaid else find_spots(right.image, settings)
        seen.append((left.source, at_left, at_right))
        progress.update(len(seen), total, "looking for lights")
        if progress.cancelled():
            raise Cancelled(f"stopped after {len(seen)} pairs", consequence="No target was written")
    names, lefts, rights = zip(*seen, strict=True) if seen else ((), (), ())
    overlaid = bool(seen) and lefts[0] is rights[0]
    moving = without_standing(lefts)
    others = moving if overlaid else without_standing(rights)
    return [lit_frame(packed, *frame, overlaid=overlaid) for frame in zip(names, moving, others, strict=True)]
