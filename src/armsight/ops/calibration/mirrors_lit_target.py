"""Complex images of the lit target, taken through mirrors that are known by their design only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import cast

import numpy as np

from armsight.calibrate.mirrors.calibration import MirrorCalibration
from armsight.calibrate.mirrors.diagnosis import LEAST_LIT, mirrors_from_target
from armsight.calibrate.mirrors.result import reasons
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, Unseen, UsageError
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup
from armsight.measure.poses.setup import SLACK_PX
from armsight.measure.spots import find_spots
from armsight.ops.calibration.cameras import Moments
from armsight.optics import Camera, Rig
from armsight.records import BoardView, Frame, NotSeen, PoseStatus, Progress, Spots, Target, TargetPose
from armsight.records.result_parts import RejectedFile

SLACKS_PX = (0.5, 1.0, 2.0, 4.0)
"""How far the mirrors may be out of their design. Well built ones are found with the least, and only with that: at 4 px
every frame of a target of 60 mm fits under all six namings, at 1 px one in five."""
MOST = 0.6
"""Share of the frames with spots enough in which the lights must be named before a slack is taken."""
FEWEST_LIGHTS = 3
REASONS_SHOWN = 3

CURES: Mapping[Unseen, str] = {
    Unseen.NO_SPOT: "Switch the lights on, expose longer, or give the target.yaml with the lights' colour",
    Unseen.DARK_PATH: "Open both paths: every light must be in the image twice",
    Unseen.AMBIGUOUS: "Give --baseline-mm, --near-mm and --gap-mm as the mirrors stand, or calibrate with --board",
    Unseen.OVERLAPPING: "Move the target a little, until the spots of the two views part",
    Unseen.HALF_HIDDEN: "Take away what stands before the lights, or turn the target until all are seen whole",
    Unseen.LIGHTS_MISSING: "Show all lights of the target to both views",
}
"""What helps against what kept the lights from being named."""
OTHER_CURE = "Check that --target, --camera and --baseline-mm are those of the rig and the target in the images"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """All spots of one complex image."""

    source: str
    t_s: float
    spots: Spots


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sorted:
    """The moments whose lights are named, as views of a board with their poses; rejected: the others."""

    views: list[tuple[BoardView, BoardView]]
    poses: list[TargetPose]
    rejected: list[tuple[str, NotSeen]]


def calibrate_lit(
    design: Rig, target: Target, moments: Moments, *, every: int, limit: int | None, progress: Progress
) -> tuple[MirrorCalibration, list[RejectedFile]]:
    """Return the mirror rig that took the complex images of the lit target, and those left out.

    design: as built, the lens known. moments: the complex images, in colour or not. The spots are sorted by the
    design, and again by the rig that this gives. Raises NotEnoughData, Inconsistent (sizes), Cancelled.
    """
    seen = _spots(design, target, islice(cast(Iterable[Frame], moments), 0, limit and limit * every, every))
    found = []
    for moment in seen:
        found.append(moment)
        progress.update(len(found), limit or 0, "finding the lights")
        if progress.cancelled():
            raise Cancelled("stopped", consequence="Nothing was written")
    first = sorted_views(design, target, found)
    _require_views(first, len(found))
    done = mirrors_from_target(design, first.views, first.poses, target)
    second = sorted_views(done.rig, target, found, (SLACK_PX, *SLACKS_PX))
    _require_views(second, len(found))
    rejected = [RejectedFile(source, seen.why) for source, seen in second.rejected]
    return mirrors_from_target(done.rig, second.views, second.poses, target), rejected


def require_lights(target: Target) -> None:
    """Raise UsageError for a target that cannot serve."""
    if target.is_board:
        raise UsageError("--target is a board", cure="Give it as --board, or --target with the lit target")
    if not target.model_known or len(target.names) < FEWEST_LIGHTS:
        raise UsageError(
            f"the target has {len(target.names)} lights{'' if target.model_known else ' whose positions are not known'}"
            f"; {FEWEST_LIGHTS} in known positions are needed to calibrate mirrors",
            cure="Measure the target, or calibrate with --board",
        )


def _spots(rig: Rig, target: Target, frames: Iterable[Frame]) -> Iterator[Moment]:
    settings = Setup(rig, target, overlaid=True).settings
    for frame in frames:
        _require_size(frame, rig.left)
        yield Moment(source=frame.source, t_s=frame.t_s, spots=find_spots(frame.image, settings))


def _require_size(frame: Frame, camera: Camera) -> None:
    if (frame.width, frame.height) == (camera.width, camera.height):
        return
    double = (frame.width, frame.height) == (2 * camera.width, camera.height)
    raise Inconsistent(
        f"{frame.source} is {frame.width}x{frame.height} px, the camera of --camera {camera.width}x{camera.height} px"
        + (": it looks like two images side by side, not one complex image" if double else ""),
        consequence="Nothing was calibrated",
        cure="Cut the images in two and use `armsight calibrate stereo`"
        if double
        else "Record at the resolution of the lens's calibration, or calibrate the lens at this one",
    )


def see_lights(rig: Rig, target: Target, frame: Frame) -> Sorted:
    """Return the lights of one complex image by their names; rig: as designed.

    Raises UsageError for a target that cannot serve, Inconsistent for another size of image.
    """
    require_lights(target)
    return sorted_views(rig, target, list(_spots(rig, target, [frame])))


def sorted_views(rig: Rig, target: Target, moments: Sequence[Moment], slacks_px: Sequence[float] = SLACKS_PX) -> Sorted:
    """Return the lights as sorted with the least slack that names most of them, else with the one that names most."""
    enough = sum(len(moment.spots) >= 2 * len(target.names) for moment in moments)
    needed = max(LEAST_LIT, MOST * enough)
    best: Sorted | None = None
    for slack_px in slacks_px:
        found = _with_slack(Setup(rig, target, slack_px=slack_px, overlaid=True), moments)
        if best is None or len(found.views) > len(best.views):
            best = found
        if len(found.views) >= needed:
            break
    return best or Sorted(views=[], poses=[], rejected=[])


def _with_slack(setup: Setup, moments: Sequence[Moment]) -> Sorted:
    out = Sorted(views=[], poses=[], rejected=[])
    camera, names = setup.rig.left, setup.target.names
    for moment in moments:
        found = measure_spots(setup, moment.t_s, moment.spots, moment.spots)
        if found.pose.status is not PoseStatus.OK:
            out.rejected.append((moment.source, found.missed))
            continue
        index = np.array([names.index(name) for name in found.names])
        left, right = (
            BoardView(
                uv_px=spots.uv_px,
                index=index,
                width=camera.width,
                height=camera.height,
                source=moment.source,
                sigma_px=float(np.sqrt(np.median(np.trace(spots.covariance_px2, axis1=1, axis2=2)) / 2.0)),
            )
            for spots in (found.left, found.right)
        )
        out.views.append((left, right))
        out.poses.append(found.pose)
    return out


def _require_views(found: Sorted, total: int) -> None:
    """Raise NotEnoughData with the commonest reasons, and what helps against the first of them."""
    if len(found.views) >= LEAST_LIT:
        return
    why = reasons([seen for _, seen in found.rejected])
    said = "; ".join(f"{seen.why} (in {count})" for seen, count in why[:REASONS_SHOWN])
    if why:
        cure = CURES.get(why[0][0].cause, OTHER_CURE)
    else:
        cure = f"Give {LEAST_LIT} images and more, the target turned, near and far, left and right"
    raise NotEnoughData(
        f"the target is seen whole in {len(found.views)} of {total} images, {LEAST_LIT} are needed"
        + (f": {said}" if said else ""),
        consequence="Nothing was calibrated",
        cure=cure,
    )
