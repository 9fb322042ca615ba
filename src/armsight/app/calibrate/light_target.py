"""The lights of a target in pairs of frames."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from armsight.calibrate.light_target import LitFrame
from armsight.drivers import PairSource
from armsight.errors import Cancelled
from armsight.measure.poses.beacon import without_standing
from armsight.measure.poses.pairs import pair_spots
from armsight.measure.poses.pipeline import check_sizes
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.optics import PackedRig, Rig
from armsight.records import Frame, Progress, Spots

Pair = tuple[Frame, Frame]


def lit_frame(packed: PackedRig, name: str, left: Spots, right: Spots, *, overlaid: bool = False) -> LitFrame:
    """Return the pairs of a moment's spots that agree with the epipolar lines; overlaid: see pair_spots."""
    index = pair_spots(packed, left, right, overlaid=overlaid).index
    return LitFrame(name=name, left=left.take(index[:, 0]), right=right.take(index[:, 1]))


def lit_frames(
    rig: Rig, pairs: PairSource, settings: SpotSettings, limit: int | None, progress: Progress
) -> list[LitFrame]:
    """Return the lights in pairs of frames, those that stand still left out. Raises DataRefused, Cancelled."""
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
