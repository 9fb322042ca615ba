"""What makes a target's geometry unknowable, said by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.light_target.adjustment import LETTERS, LightBundle, line_frame
from armsight.calibrate.light_target.naming import BEHIND, WIDE, Named, align, distances, facing
from armsight.calibrate.light_target.result import LightDistance
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.fitting.quantiles import chi2_isf
from armsight.units import DEG, MM

Flags = NDArray[np.bool_]

MIN_FRAMES = 3
"""Two frames can contradict each other, three can tell which is wrong."""

TOLD = 36.0
"""Chi-square by which another naming of a frame's lights must be worse, as expected without noise: one error in 700."""

LINE_SHARE = 0.02
"""Height over length of lights on one line."""

LINE_SIGMA = 5.0
"""Lights are on one line too where, in the middle frame, none is so many standard deviations off it: no frame then
knows the turn about it."""

SIDES_SHARE = 1.0 / 3.0
"""Frames in which the lights run the other way round: more than this share leave the sense of w open."""

SHAPE_LOOSE = 3.0
"""Residuals of the shape may exceed those of the epipolar lines, or the spots' noise, so many times ..."""

LOOSE_PX = 0.15
"""... and must be larger than this to be called a shape that changes: calibrations leave 0.1 px."""

FALSE_ALARM = 1e-6

LEAST_TURN_RAD = 0.1 * DEG
"""Root mean square turn below which a target stands still: lamps of the room then have the same distances in all frames
as its own lights. Four frames of a target in a workshop made one of six lights, 1.1 m wide, at 0.003 degrees."""


def require_lights(n: int) -> None:
    """Raise UsageError for a number of lights that cannot be searched."""
    if not 2 <= n <= len(LETTERS):
        raise UsageError(f"a target of {n} lights cannot be calibrated", cure=f"Give 2 to {len(LETTERS)} lights")


def few_frames(
    n: int, total: int, lights: int, rejected: Sequence[tuple[int, str]], *, overlaid: bool = False, many: bool = False
) -> NotEnoughData:
    """Return the refusal of too few frames; overlaid: both views are in one image; many: of several any two count."""
    why = f"; the first of the others: {rejected[0][1]}" if rejected else ""
    seen = "all lights in the image twice, neither path dark" if overlaid else "all lights seen by both cameras"
    if many:
        seen = (
            "in three moments and more the same lights, three at least, towards two cameras that stand near each other"
        )
    swapped = "; where all are there, check which source is the left one" if n == 0 and not (overlaid or many) else ""
    views = "two" if many else "both"
    return NotEnoughData(
        f"{n} of {total} frames show {lights} lights in {views} views, of which {MIN_FRAMES} are the fewest{why}",
        consequence="The target is not calibrated",
        cure=f"Record 10 frames and more, the target turned to several sides, {seen}{swapped}",
    )


def not_grown(n: int, lights: int) -> NotEnoughData:
    """Return the refusal of lights of which some cannot be joined to the others."""
    return NotEnoughData(
        f"no two cameras see all {lights} lights in {MIN_FRAMES} moments, and only {n} of them are joined to one "
        "another by the moments that show some",
        consequence="The target is not calibrated",
        cure="Record moments in which each light is seen together with three and more of the others, the target turned "
        "to several sides; check the number of lights",
    )


def not_rigid(n: int, total: int, named: Named, *, overlaid: bool = False) -> Inconsistent:
    """Return the refusal of lights whose distances differ from frame to frame."""
    off = max((m for _, m in named.misfit), default=0.0)
    much = f", others differ by up to {off / MM:.2g} mm" if off else ""
    return Inconsistent(
        f"only {n} of {total} frames share one set of distances between the lights{much}",
        consequence="The target is not rigid, or other lights were taken for its own; no geometry is given",
        cure="Fix the lights to one body, cover reflections"
        + ("" if overlaid else ", and check which source is the left one"),
    )


def on_one_line(named: Named) -> bool:
    """Tell whether no more than the distances along one line can be known."""
    X = named.X
    if len(X) == 2:
        return True
    axes, centre = line_frame(X)
    off = (X - centre) - np.outer((X - centre) @ axes[:, 0], axes[:, 0])
    heights = np.linalg.norm(off, axis=1)
    if heights.max() < LINE_SHARE * float(distances(X).max()):
        return True
    far = int(np.argmax(heights))
    across = named.R @ (off[far] / heights[far])  # in rig axes
    sigma2 = np.einsum("gi,gij,gj->g", across, np.linalg.inv(named.information[:, far]), across)
    return bool(heights[far] < LINE_SIGMA * float(np.median(np.sqrt(sigma2))))


def on_line(lengths: Mapping[str, LightDistance]) -> Degenerate:
    """Return the refusal of lights on one line, with the distances that are known."""
    known = ", ".join(f"{k} {d.value_m / MM:.4f} +- {d.std_m / MM:.2g} mm" for k, d in lengths.items())
    return Degenerate(
        f"all lights are on one line within what the frames can tell; only their distances are known: {known}",
        consequence="The turn of the target about that line cannot be seen; no frame of the target is given",
        cure="Move one light off the line, by a third of its length or more",
    )


def distinguishable_frames(named: Named) -> tuple[Flags, NDArray[np.intp] | None]:
    """Return the frames whose names another naming could not take, and the naming that is nearest to the true one.

    Judged without noise: the shape, renumbered, is laid onto its own true positions with each frame's information.
    """
    X, d = named.X, distances(named.X)
    spread = float(np.median(np.linalg.eigvalsh(np.linalg.inv(named.information))[..., 2]))
    n, g = len(X), len(named.R)
    told, nearest, least = np.ones(g, bool), None, np.inf
    positions = np.einsum("gij,nj->gni", named.R, X) + named.t[:, None]
    normal = np.linalg.svd(X - X.mean(axis=0))[2][2]
    own = facing(named.R, named.t, X, normal)
    for perm in list(permutations(range(n)))[1:]:
        q = np.array(perm, dtype=np.intp)
        # names whose distances differ by far more than is uncertain cannot be confused, and need no alignment
        if float(((distances(X[q]) - d) ** 2).sum()) > WIDE * spread:
            continue
        R, t, worse = align(X[q], positions, named.information)
        worse = worse + BEHIND * (facing(R, t, X, normal) * own < 0.0)
        told &= worse >= TOLD
        if float(np.median(worse)) < least:
            nearest, least = q, float(np.median(worse))
    return told, nearest


def require_names(named: Named, told: Flags, nearest: NDArray[np.intp] | None) -> None:
    """Raise Ambiguous where in most frames the lights could be exchanged without a trace."""
    if told.mean() > 0.5 and told.sum() >= MIN_FRAMES:
        return
    d = distances(named.X)
    lengths = ", ".join(f"{v / MM:.2f}" for v in np.sort(d))
    kind, cure = "another naming fits as well", "Move one light so that no two of the distances are alike"
    if len(named.X) == 3 and nearest is not None:
        kind = "an equilateral target is 3-fold ambiguous: any of its lights could be A"
        cure = "Make it isosceles: move one light so that two distances differ from the third by a fifth or more"
    raise Ambiguous(
        f"in {int((~told).sum())} of {len(told)} frames the lights (distances {lengths} mm) cannot be told apart; "
        f"{kind}",
        consequence="Nobody could name the lights of a later frame either; no geometry is given",
        cure=cure,
    )


def require_side(named: Named) -> None:
    """Raise Ambiguous where the sense of w cannot be decided: three lights seen from both sides, or mirrored."""
    share = float(named.behind.mean())
    if len(named.X) == 3 and min(share, 1.0 - share) > SIDES_SHARE:
        raise Ambiguous(
            f"the lights run one way round in {int((~named.behind).sum())} frames and the other way in "
            f"{int(named.behind.sum())}",
            consequence="Which side of the target is its front, and so the sense of w, is not known",
            cure="Show the target from one side only, and cover mirrors and shiny surfaces",
        )


def require_turned(turn_rad: float) -> None:
    """Raise NotEnoughData for a target that stands still: nothing tells its lights from others that do."""
    if turn_rad < LEAST_TURN_RAD:
        raise NotEnoughData(
            f"the target turns by {turn_rad / DEG:.2g} degrees RMS in these frames: it stands still, and so do lights "
            "that are not its own",
            consequence="Which lights are the target's, and its depth, are not known; no geometry is given",
            cure="Record it anew, turned by 20 to 40 degrees to several sides",
        )


def require_rigid(bundle: LightBundle, epipolar: tuple[float, int], n: int, frames: int) -> None:
    """Raise Inconsistent where the shape's residuals are larger than the spots and the epipolar lines explain."""
    chi2, dof = float(bundle.frame_chi2.sum()) - epipolar[0], bundle.dof - epipolar[1]
    if dof <= 0:
        return
    noise = max(epipolar[0] / max(epipolar[1], 1), 1.0)
    rms = float(np.sqrt(np.nanmean(bundle.residual_px**2)))
    limit = max(SHAPE_LOOSE**2, float(chi2_isf(FALSE_ALARM, dof)) / dof)
    if chi2 / dof > limit * noise and rms > LOOSE_PX:
        raise Inconsistent(
            f"the lengths change more than noise: no one shape of {n} lights fits {frames} frames better than "
            f"{rms:.2g} px",
            consequence="The target is not rigid, or the rig's calibration is wrong; no geometry is given",
            cure="Fix the lights to one body; where it is rigid, calibrate the rig anew",
        )
