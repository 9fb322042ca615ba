"""Poses of named spots: could the lights look like this there, and does something cover one of them in part?

Lights that are covered are told by their outlines, and taken with more doubt or left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array, Image, Index, Mask
from armsight.errors import Unseen
from armsight.geometry.kernels import rotvec
from armsight.measure.poses.correspondence import OUTLINE
from armsight.measure.poses.kernels import hidden as outlines
from armsight.measure.poses.kernels import pose as kernels
from armsight.measure.poses.kernels.moved import add_moved
from armsight.measure.poses.kernels.rig_covariance import MAX_DOUBTFUL_SIGMA
from armsight.measure.poses.outcome import Assignment
from armsight.measure.poses.pairs import Pairs
from armsight.measure.poses.pose import (
    TWO,
    UNKNOWN,
    NamedSpots,
    PoseSolution,
    fit_pose,
    lost,
    no_points,
    position_only,
    solve_frame,
    solve_points,
    solve_pose,
    stack_spots,
    with_covariance,
)
from armsight.measure.poses.setup import Setup, fit_limit
from armsight.measure.spots.kernels.outline import OUTLINE as OUTLINE_ROW
from armsight.records import Frame, NotSeen, PoseStatus, Spots
from armsight.records.checks import for_kernels

TIGHT_PX = 0.05
"""What a good calibration leaves; residuals beyond it are reason enough to try left and right exchanged."""


def solve_assignment(
    setup: Setup, t_s: float, left: Spots, right: Spots, pairs: Pairs, chosen: Assignment
) -> PoseSolution:
    """Return the pose of the pairs that a hypothesis chose, under its names."""
    index = pairs.index[chosen.pair]
    return solve_spots(setup, t_s, chosen.names, take_spots(left, index[:, 0]), take_spots(right, index[:, 1]))


class Views(NamedTuple):
    """Spots of n lights as [light, view]: uv_px (n, v, 2), cov_px2 (n, v, 2, 2), see NamedSpots.

    radius_m (n, v): of the flat light where the spot is its outline, else 0. start (4, 4): where a fit begins.
    """

    uv_px: Array
    cov_px2: Array
    radius_m: Array
    start: Array = UNKNOWN

    @property
    def sights(self) -> Mask:
        """Which view shows which light, (n, v)."""
        return np.asarray(np.isfinite(self.cov_px2[..., 0, 0]))


def solve_spots(setup: Setup, t_s: float, names: tuple[str, ...], left: Spots, right: Spots) -> PoseSolution:
    """Return the pose of three or more named spots (the frame of an unmeasured target), or the place of fewer."""
    return solve_views(setup, t_s, names, views_of(setup, (left, right)))


def views_of(setup: Setup, spots: Sequence[Spots]) -> Views:
    """Return the spots of a pair's views, in doubt by what perspective may do to outlines of unknown size."""
    radius_m = setup.model.radius_m
    views = Views(*stack_spots(spots), _radii(radius_m, spots))
    if radius_m <= 0.0:
        for side, one in enumerate(spots):
            if OUTLINE in one.model:
                shift2 = np.array(outline_shifts(one, float(setup.packed.k[side][0])))
                views.cov_px2[:, side] += shift2[:, None, None] * np.eye(2)
    return views


def solve_views(setup: Setup, t_s: float, names: tuple[str, ...], views: Views) -> PoseSolution:
    """Return the pose of named spots in all views; see solve_spots."""
    model, packed = setup.model, setup.packed
    uv, cov, _, start = views
    if len(names) < 3:
        seen = solve_points(packed, names, uv, cov)
        if isinstance(seen, NotSeen):
            return PoseSolution(pose=lost(t_s, seen.why), points=no_points(), fits=False, cause=seen.cause)
        whole = len(names) == len(model)
        why = "a target of one or two spots" if whole else f"{len(names)} of {len(model)} spots seen"
        return PoseSolution(
            pose=position_only(t_s, seen, f"{why}: only their position is known"),
            points=seen.points,
            cause=Unseen.SMALL_TARGET if whole else Unseen.LIGHTS_MISSING,
        )
    if not setup.target.model_known:
        return solve_frame(packed, t_s, names, uv, cov)
    limit, slack_px, covariance = _rules(setup, names, views)
    spots = named_spots(setup, names, views)
    return solve_pose(packed, t_s, spots, limit=limit, slack_px=slack_px, covariance=covariance, start=start)


def named_spots(setup: Setup, names: tuple[str, ...], views: Views) -> NamedSpots:
    """Return the spots with where their lights are on the target."""
    model = setup.model
    rows = model.xyz_m if names == model.names else model.xyz_m[[model.names.index(name) for name in names]]
    return NamedSpots(names, rows, *views[:3], model.normal)


def _rules(setup: Setup, names: tuple[str, ...], views: Views) -> tuple[float, float, Array]:
    """Return the limit, the slack and the covariance by which solve_pose judges these lights."""
    two = views.uv_px.shape[1] == TWO
    limit = float(setup.model.limits[len(names)]) if two else fit_limit(int(views.sights.sum()))
    return limit, setup.slack_px, setup.covariance_of(names)


def _matrix_of(setup: Setup, names: tuple[str, ...], views: Views) -> Array | None:
    """Return the pose (4, 4) of solve_views alone; None where it is not whole."""
    if len(names) < 3 or not setup.target.model_known:
        return solve_views(setup, 0.0, names, views).T
    fit = fit_pose(setup.packed, named_spots(setup, names, views), *_rules(setup, names, views), views.start)
    return fit.T if fit.state == kernels.SOLVED else None


def _radii(radius_m: float, views: Sequence[Spots]) -> Array:
    """Return (n, v): the radius of the flat light where the spot is its outline, else 0."""
    radius = np.zeros((len(views[0]), len(views)))
    if radius_m > 0.0:
        for side, spots in enumerate(views):
            radius[[kind == OUTLINE for kind in spots.model], side] = radius_m
    return radius


def misfit_chi2(solved: PoseSolution, left: Spots, right: Spots) -> float:
    """Return chi-square of the residuals with TIGHT_PX beside the spots' own standard deviations."""
    if solved.T is None:
        return 0.0
    uv, cov = stack_spots((left, right))
    return float(kernels.slack_chi2(np.array(solved.pose.residual_px).reshape(uv.shape), cov, TIGHT_PX**2))


def take_spots(spots: Spots, index: Index) -> Spots:
    """Return the spots in the order of index; itself where that changes nothing."""
    if len(index) == len(spots) and index.tolist() == list(range(len(spots))):
        return spots
    return spots.take(index)


OUTLINE_SHARE = 0.35
"""Root mean square of sin a cos a over tilts of up to 90 degrees: see outline_shifts."""

WRONG_SIZE = 1.6
BLOOM_PX = 2.0
"""Ratio and px by which flat lights may look larger or smaller than their diameter says: tilt, blur and bloom."""


def outline_shifts(spots: Spots, focal_px: float) -> list[float]:
    """Return the variance of each spot's centre in px^2 by its outline, 0 where it is none.

    The centre of a disc's image is off by r^2 sin a cos a / f, r in px, at a tilt of a.
    """
    shifts = [OUTLINE_SHARE * size**2 / focal_px for size in spots.size_px.tolist()]
    return [d * d if kind == OUTLINE else 0.0 for kind, d in zip(spots.model, shifts, strict=True)]


def impossible(setup: Setup, names: tuple[str, ...], solved: PoseSolution, left: Spots, right: Spots) -> NotSeen | None:
    """Return why the lights cannot look like this at the pose that fits them; None where they can."""
    if solved.T is None:
        return None
    model, packed = setup.model, setup.packed
    eye = -packed.R[0].T @ packed.t[0]
    if model.one_sided and solved.T[:3, 2] @ (solved.T[:3, 3] - eye) < 0.0:
        return NotSeen(
            "the lights fit the target seen from behind: a mirror image, or y counts upwards in target.yaml; "
            "z must point away from the cameras: change the sign of every y and z there",
            Unseen.WRONG_TARGET,
        )
    if model.radius_m <= 0.0:
        return None
    shares = []
    for side, spots in enumerate((left, right)):
        rows = [i for i, kind in enumerate(spots.model) if kind == OUTLINE]
        positions = solved.T[:3, :3] @ model.xyz_m[[model.names.index(names[i]) for i in rows]].T + solved.T[:3, 3:]
        depth = packed.R[side][2] @ positions + packed.t[side][2]
        whole = packed.k[side][0] * model.radius_m / depth
        shares += [(spots.size_px[i], r) for i, r in zip(rows, whole.tolist(), strict=True)]
    off = [size < r / WRONG_SIZE - BLOOM_PX or size > WRONG_SIZE * r + BLOOM_PX for size, r in shares]
    if 2 * sum(off) <= len(off):
        return None
    seen, wanted = np.median(np.array(shares), axis=0)
    return NotSeen(
        f"the lights are {2.0 * seen:.0f} px wide and would be {2.0 * wanted:.0f} px by diameter_m in target.yaml: "
        "correct it, or leave it out",
        Unseen.WRONG_TARGET,
    )


LEAST_STEP_PX = 1e-3
SHARES = (1.0, 0.5, 0.25)
"""Of what may be hidden, the shares by which a centre is moved until the target still fits."""
LITTLE_WIDER = 1.5
"""Factor by which doubt in a light may widen a rotation that is hardly known anyway before it is none."""

JOINT = "joint"
"""The model of lights that touch: the outline of one of them is that of all."""
TOUCH_SIZES = 3.0
"""Distance in sizes of both (sigmas) within which two lights share an outline."""


class Observation(NamedTuple):
    """Spots with their names, and what is solved from them. hidden: names of lights that were left out."""

    names: tuple[str, ...]
    left: Spots
    right: Spots
    solved: PoseSolution
    hidden: tuple[str, ...] = ()


def solve_seen(
    setup: Setup,
    t_s: float,
    names: tuple[str, ...],
    left: Spots,
    right: Spots,
    frames: tuple[Frame, Frame] | None,
) -> Observation:
    """Return the pose of named spots (solve_spots), after a look at whether all of each light is there.

    frames: the images that they were found in; without them nothing is looked at. A light unlike every other one is
    left out; where one may be cut off a little the pose is as uncertain as what may be hidden of it makes it.
    """
    solved = solve_spots(setup, t_s, names, left, right)
    n = len(names)
    if frames is None or solved.pose.status is PoseStatus.LOST or len(solved.points) != n:
        return Observation(names, left, right, solved)
    if n == 1 and setup.settings.colour is not None:  # outlines are of all colours together, its spot is of one
        return Observation(names, left, right, solved)
    verdict, out = compare(setup, solved.points.xyz_m, solved.T, (left, right), frames)
    if verdict == outlines.NO_DOUBT:
        return Observation(names, left, right, solved)
    odd: Mask = np.asarray(out[:, :, outlines.ODD].any(axis=0))
    if not odd.any():
        widened = widen(setup, t_s, names, views_of(setup, (left, right)), solved, out)
        if widened is not None:
            return Observation(names, left, right, widened)
        odd[np.argmax(out[:, :, [outlines.UU, outlines.VV]].sum(axis=(0, 2)))] = True
    hidden = tuple(name for name, is_odd in zip(names, odd.tolist(), strict=True) if is_odd)
    kept = np.flatnonzero(~odd)
    names, left, right = tuple(names[i] for i in kept.tolist()), left.take(kept), right.take(kept)
    if not names:
        return Observation(names, left, right, solved, hidden)
    rest = solve_seen(setup, t_s, names, left, right, frames)
    return rest._replace(hidden=(*hidden, *rest.hidden))


def compare(
    setup: Setup, P: Array, T: Array | None, views: Sequence[Spots], frames: Sequence[Frame | None]
) -> tuple[int, Array]:
    """Return the verdict on the outlines of lights at P (n, 3) and what was found of each, (v, n, FINDING).

    views: each one's spots in the order of P, of size 0 where it shows none.
    """
    rig, n, v, P = setup.packed.arrays, len(P), len(views), for_kernels(P)
    T = UNKNOWN if T is None else T
    lean = T[:3, 0] * setup.model.lean[0] + T[:3, 1] * setup.model.lean[1] + T[:3, 2] * setup.model.lean[2]
    shape = np.empty((v, n, OUTLINE_ROW)), np.empty((v, n, OUTLINE_ROW))  # its own, and the others'
    found, sigma, out = np.empty((v, n, 3)), np.empty((v, n)), np.zeros((v, n, outlines.FINDING))
    for s, (frame, spots) in enumerate(zip(frames, views, strict=True)):
        if frame is None:
            shape[0][s], shape[1][s], found[s], sigma[s] = 0.0, 0.0, 0.0, 0.0
            continue
        seen = spots.uv_px, spots.covariance_px2, sizes(spots, overlaid=setup.overlaid)
        filled = shape[0][s], shape[1][s], found[s], sigma[s]
        outlines.look_at_view(channels(frame), setup.settings.options, setup.packed.camera(s), P, lean, seen, *filled)
    return int(outlines.judge_lights(rig, P, *shape, found, sigma, out)), out


def widen(
    setup: Setup, t_s: float, names: tuple[str, ...], views: Views, solved: PoseSolution, found: Array
) -> PoseSolution | None:
    """Return the solved pose, as uncertain as its lights' centres may be off: found (v, n, FINDING).

    Every centre is moved by a standard deviation of what may be hidden, both ways, and the pose solved anew: where a
    light is nearly free, poses bend too much for slopes. None where the rotation or the place is not known then.
    """
    T, own = solved.T, solved.pose.covariance
    if T is None or own is None:
        hidden = found[:, :, [[outlines.UU, outlines.UV], [outlines.UV, outlines.VV]]]
        views.cov_px2[:] += hidden.swapaxes(0, 1)
        placed = solve_views(setup, t_s, names, views)
        return None if placed.pose.status is PoseStatus.LOST else placed
    C, most = np.array(own), max(MAX_DOUBTFUL_SIGMA**2, LITTLE_WIDER**2 * float(np.diag(own)[3:].max()))
    if views.uv_px.shape[1] == TWO or not setup.target.model_known:
        for moved in _moves(setup, names, views, T, found):
            C += moved.T @ moved / len(moved)
            if np.diag(C)[3:].max() > most:
                return None  # the moves that are left would only add to it
    else:
        limit, slack_px, _ = _rules(setup, names, views)
        spots, rules = named_spots(setup, names, views), (slack_px**2, limit, LEAST_STEP_PX)
        of = for_kernels(spots.xyz_m), spots.radius_m, spots.normal
        add_moved(setup.packed.arrays, views[:2], rules, of, T, found, np.array(SHARES), C)
    return None if np.diag(C)[3:].max() > most else with_covariance(solved, C)


def widened_or_odd(
    setup: Setup, t_s: float, names: tuple[str, ...], views: Views, solved: PoseSolution, found: Array
) -> tuple[PoseSolution | None, Mask]:
    """Return the pose as wide as its sights may be off by found (v, n, FINDING), None if too wide; and which (v, n) are
    then to be left out: the odd ones, else the one that may hide most."""
    odd: Mask = found[:, :, outlines.ODD] > 0.0
    if odd.any():
        return None, odd
    doubt = found[:, :, [outlines.UU, outlines.VV]].sum(axis=2)
    return widen(setup, t_s, names, views, solved, found), np.asarray(doubt == doubt.max())


def _moves(setup: Setup, names: tuple[str, ...], views: Views, T: Array, found: Array) -> Iterator[Array]:
    """Give the ways (1 to 2, 6) from the pose T, of a pair or of unmeasured lights, to those with a spot moved.

    Each is moved both ways by what may be hidden; where the target then fits neither way, less is hidden; none where it
    never does. The poses begin as if nothing were known; those of other rigs begin from T (add_moved).
    """
    sides, lights = np.nonzero(found[:, :, outlines.UU] + found[:, :, outlines.VV] > 0.0)
    hidden = found[sides, lights][:, [[outlines.UU, outlines.UV], [outlines.UV, outlines.VV]]]
    variances, axes = np.linalg.eigh(hidden)
    steps = (np.sqrt(np.maximum(variances, 0.0))[:, None, :] * axes).swapaxes(1, 2).reshape(-1, 2)
    at, long = np.stack([lights, sides], axis=1).repeat(2, axis=0), (steps**2).sum(axis=1) > LEAST_STEP_PX**2
    for (i, s), way in zip(at[long].tolist(), steps[long], strict=True):
        moved = _moved(setup, names, views, T, (i, s), way)
        if len(moved):
            yield moved


def _moved(setup: Setup, names: tuple[str, ...], views: Views, T: Array, at: tuple[int, int], step_px: Array) -> Array:
    """Return the ways (0 to 2, 6) from the pose T of a pair to those with one spot moved; see _moves."""
    for share in SHARES:
        moved = [_moved_by(setup, names, views, T, at, sign * share * step_px) for sign in (-1.0, 1.0)]
        possible = [d for d in moved if d is not None]
        if possible:
            return np.array(possible)
    return np.empty((0, 6))


def _moved_by(
    setup: Setup, names: tuple[str, ...], views: Views, T: Array, at: tuple[int, int], step_px: Array
) -> Array | None:
    """Return the way (6,) from the pose T to that with one spot moved by step_px (2,); None where that fits no pose."""
    uv = views.uv_px.copy()
    uv[at] += step_px
    other = _matrix_of(setup, names, views._replace(uv_px=uv))
    return None if other is None else np.concatenate([other[:3, 3] - T[:3, 3], rotvec(other[:3, :3] @ T[:3, :3].T)])


def channels(frame: Frame) -> Image:
    """Return a frame's image as (h, w, channels)."""
    return frame.image if frame.image.ndim == 3 else frame.image[:, :, None]


def sizes(spots: Spots, *, overlaid: bool) -> Array:
    """Return the spots' sizes (n,); 0 for those whose outline is not their own: lights of the target that touch.

    What is left of a disc is fitted as two lights that touch, too, of which one is the target's: it is looked at. In an
    image of both views (overlaid) any light may touch one of the other view.
    """
    if JOINT not in spots.model:
        return spots.size_px
    apart = np.linalg.norm(spots.uv_px[:, None] - spots.uv_px[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    touching = (apart < TOUCH_SIZES * (spots.size_px[:, None] + spots.size_px[None])).any(axis=1) | overlaid
    size = np.where(touching & [kind == JOINT for kind in spots.model], 0.0, spots.size_px)
    size.setflags(write=False)  # as the others: one compilation serves both
    return size


def why_hidden(hidden: tuple[str, ...], status: PoseStatus) -> str:
    """Return why a pose is not given, or not of all lights."""
    which = f"light {hidden[0]} is" if len(hidden) == 1 else f"lights {' and '.join(hidden)} are"
    left = "nothing is known" if status is PoseStatus.LOST else "only the position of the others is known"
    return f"half hidden: {which} not as wide as the others and left out; {left}"
