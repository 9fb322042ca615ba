"""A lit target's geometry from any number of cameras, which need not see its lights together: every sight counts.

Moments in which two cameras see all lights name them and tell their shape, as a pair's do. Where too few do, some of
the lights are found in this way, and the others by the rays to them (`grown`). By the shape the lights of all moments
are named in all views, as in measuring, and all sights make one bundle: a light that one camera alone sees has no
point, and counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.calibrate.light_target.adjustment import (
    LETTERS,
    Layout,
    LightBundle,
    LightObservations,
    LitFrame,
    Sight,
    line_frame,
    line_layout,
    name_order,
    plane_layout,
    sights_of,
)
from armsight.calibrate.light_target.calibrate import (
    LabelledFrames,
    Rejected,
    clear_frames,
    epipolar,
    fit_frames,
    found_target,
    guess,
    named_by_shape,
    pair_of,
    turns,
)
from armsight.calibrate.light_target.checks import (
    MIN_FRAMES,
    few_frames,
    not_grown,
    on_one_line,
    require_lights,
    require_rigid,
    require_turned,
)
from armsight.calibrate.light_target.grown import LitMoment, more_lights
from armsight.calibrate.light_target.naming import Named, find_shape
from armsight.calibrate.light_target.result import TargetResult
from armsight.defaults import LIT_LIGHTS
from armsight.errors import Ambiguous, Inconsistent, Unseen, UsageError
from armsight.optics import PackedRig, Rig
from armsight.records import NotSeen, Spots, Target, spot_target


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedSights:
    """A known target in one moment: T_rig_target (4, 4), and by view its spots and which lights they are."""

    T_rig_target: Array
    spots: tuple[Spots, ...]
    names: tuple[tuple[str, ...], ...]


Pairing: TypeAlias = Callable[[Rig, Spots, Spots], Index]
"""Rows (p, 2) of two views' spots, by a rig of these two as left and right, that may be the same light."""
Naming: TypeAlias = Callable[[Rig, Target], Callable[[Sequence[Spots]], NamedSights | NotSeen]]
"""What finds a known target in the views of a moment."""


TOO_LITTLE = (Unseen.NO_SPOT, Unseen.LIGHTS_MISSING, Unseen.AMBIGUOUS, Unseen.CROWD)
"""Why a moment may be lost that does not contradict the target."""
Paired: TypeAlias = dict[int, tuple[int, int, Index]]
"""By which two cameras a moment's lights are placed, and which of their spots are paired."""


def calibrate_lights(
    rig: Rig, moments: Sequence[LitMoment], lights: int = LIT_LIGHTS, *, paired: Pairing, naming: Naming
) -> TargetResult:
    """Return where the lights are in the target's own frame, from moments of a calibrated rig of two cameras and more.

    paired, naming: how spots are put together, as in measuring. A is leftmost in the first camera's image. Raises as
    calibrate_target, and UsageError for a rig of one camera.
    """
    require_lights(lights)
    if len(rig.cameras) == 1:
        raise UsageError(
            "lights that one camera alone sees have no distances",
            consequence="Nothing tells how large the target is",
            cure="Give the rig.yaml of two cameras and more, and frames of each",
        )
    sights, of, rejected = _sights(rig, moments, lights, paired)
    part = _part(rig, moments, lights, paired) if len(sights) < MIN_FRAMES else None
    if part is None:
        labelled = named_by_shape(sights, rejected, len(moments), lights, many=True)
        shape = _shape(rig, moments, of, labelled, lights)
    else:
        shape = _grown(rig, moments, part, lights, paired, naming)
    if not shape.layout.on_line:
        shape = _completed(rig, moments, shape, naming) or shape
    seen, bundle, labelled = shape.seen, shape.bundle, shape.labelled
    require_turned(float(turns(bundle.poses)[0]))
    require_rigid(bundle, epipolar(rig, seen), lights, len(labelled.numbers))
    names = [moment.name for moment in moments]
    return found_target(rig, shape.layout, bundle, names, labelled.numbers, labelled.rejected, shape.unclear)


class Shape(NamedTuple):
    """Lights of a target as they are known so far, by the moments of labelled and what these saw of them.

    unclear: how many of the other moments show too little of it.
    """

    layout: Layout
    bundle: LightBundle
    labelled: LabelledFrames
    seen: LightObservations
    unclear: int = 0

    @property
    def xyz_m(self) -> Array:
        """The lights (n, 3)."""
        return self.layout.spots(self.bundle.values)


def _shape(rig: Rig, moments: Sequence[LitMoment], of: Paired, labelled: LabelledFrames, lights: int) -> Shape:
    """Return the lights by which moments are labelled, by two cameras in each. Raises as clear_frames, fit_frames."""
    flat = on_one_line(labelled.named)
    keep = np.ones(len(labelled.numbers), bool) if flat else clear_frames(labelled)
    order = _order(rig, labelled.named, keep, flat=flat)
    layout = line_layout(lights) if flat else plane_layout(lights)
    seen = _observations(rig, moments, of, labelled, order)
    bundle, used = fit_frames(rig, layout, seen, labelled, keep, *guess(layout, labelled.named, order))
    return Shape(layout, bundle, replace(labelled, numbers=labelled.numbers[used]), seen.take(used))


def _part(rig: Rig, moments: Sequence[LitMoment], lights: int, paired: Pairing) -> Shape | None:
    """Return as many of the lights as two cameras see together in MIN_FRAMES moments, which show them by one shape."""
    for n in range(lights - 1, 2, -1):
        sights, of, _ = _sights(rig, moments, n, paired)
        if len(sights) < MIN_FRAMES:
            continue
        named = find_shape(sights)
        if n == 3:  # three other lights may be the mirror image of these
            named = named.take(named.behind == (named.behind.mean() > 0.5))
        if len(named.number) < MIN_FRAMES or on_one_line(named):
            continue
        numbers = np.array([sights[s].frame for s in named.number], dtype=np.intp)
        labelled = LabelledFrames(named=named, numbers=numbers, rejected=[], overlaid=True)
        with suppress(Ambiguous, Inconsistent):
            return _shape(rig, moments, of, labelled, n)
    return None


def _grown(rig: Rig, moments: Sequence[LitMoment], part: Shape, lights: int, paired: Pairing, naming: Naming) -> Shape:
    """Return all lights from some of them. Raises NotEnoughData where the moments do not tell the others."""
    sights, _, _ = _sights(rig, moments, 3, paired)
    X = more_lights(rig, moments, part.xyz_m, lights, sights)
    if len(X) < lights:
        raise not_grown(len(X), lights)
    shown = _shown(rig, moments, X, naming)
    if len(shown.numbers) < MIN_FRAMES:
        raise few_frames(len(shown.numbers), len(moments), lights, shown.rejected, many=True)
    named = replace(part.labelled.named, X=X, R=shown.R, t=shown.t)
    labelled = replace(part.labelled, named=named, numbers=shown.numbers, rejected=shown.rejected)
    layout, keep = plane_layout(lights), np.ones(len(shown.numbers), bool)
    order = _order(rig, named, keep, flat=False)
    seen = LightObservations(uv_px=shown.seen.uv_px[:, order], cov_px2=shown.seen.cov_px2[:, order])
    bundle, used = fit_frames(rig, layout, seen, labelled, keep, *guess(layout, named, order))
    return Shape(layout, bundle, replace(labelled, numbers=labelled.numbers[used]), seen.take(used))


def _sights(rig: Rig, moments: Sequence[LitMoment], n: int, paired: Pairing) -> tuple[list[Sight], Paired, Rejected]:
    """Return the moments in which two cameras see all lights, by which two and which of their spots are paired.

    Of several such pairs that of the widest angle is taken.
    """
    axes = PackedRig.of(rig).R[:, 2]
    pairs = sorted(combinations(range(len(rig.cameras)), 2), key=lambda p: float(abs(axes[p[0]] @ axes[p[1]])))
    sights: list[Sight] = []
    of: Paired = {}
    why = dict.fromkeys(range(len(moments)), f"no two cameras see all {n} lights")
    for a, b in pairs:
        two = pair_of(rig, a, b)
        left = [number for number in range(len(moments)) if number not in of]
        frames, index = [], []
        for number in left:
            views = moments[number].views
            rows = paired(two, views[a], views[b])
            frames.append(LitFrame(name="", left=views[a].take(rows[:, 0]), right=views[b].take(rows[:, 1])))
            index.append(rows)
        found, _ = sights_of(two, frames, n)
        for one in found:
            number = left[one.frame]
            sights.append(Sight(frame=number, rows=one.rows, xyz_m=one.xyz_m, cov_m2=one.cov_m2))
            of[number] = a, b, index[one.frame]
    sights.sort(key=lambda one: one.frame)
    return sights, of, [(number, why[number]) for number in range(len(moments)) if number not in of]


def _order(rig: Rig, named: Named, keep: NDArray[np.bool_], *, flat: bool) -> Index:
    """Return the order of the shape's lights that makes them A, B, C ... by where the first camera would see them."""
    X, T = named.X, rig.cameras[0].T_rig_camera.inv()
    at = np.einsum("gij,nj->gni", named.R[keep], X) + named.t[keep][:, None]
    at = T.apply(at.reshape(-1, 3)).reshape(at.shape)
    at = at[(at[:, :, 2] > 0.0).all(axis=1)]
    if not len(at):  # never before the first camera: by how they lie in the rig's axes
        at = np.einsum("gij,nj->gni", named.R[keep], X) + np.array([0.0, 0.0, 1.0])
    u = at[:, :, 0] / at[:, :, 2]
    u = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
    if flat:
        order = np.argsort(X @ line_frame(X)[0][:, 0])
        return np.asarray(order if u[order[0]] <= u[order[-1]] else order[::-1])
    eye = np.mean([one.T_rig_camera.translation for one in rig.cameras], axis=0)
    rays = named.t[keep] + named.R[keep] @ X.mean(axis=0) - eye
    away = np.einsum("gji,gj->gi", named.R[keep], rays / np.linalg.norm(rays, axis=1, keepdims=True)).mean(axis=0)
    return name_order(X, away, u)


def _blank(g: int, n: int, V: int) -> tuple[Array, Array]:
    return np.full((g, n, V, 2), np.nan), np.full((g, n, V, 2, 2), np.nan)


def _observations(
    rig: Rig, moments: Sequence[LitMoment], of: Paired, labelled: LabelledFrames, order: Index
) -> LightObservations:
    """Return the spots by which the lights were named, those of two cameras in each moment."""
    uv, cov = _blank(len(labelled.numbers), len(order), len(rig.cameras))
    for g, (number, rows) in enumerate(zip(labelled.numbers.tolist(), labelled.named.rows, strict=True)):
        a, b, index = of[number]
        for side, at in ((a, index[rows[order], 0]), (b, index[rows[order], 1])):
            spots = moments[number].views[side]
            uv[g, :, side], cov[g, :, side] = spots.uv_px[at], spots.covariance_px2[at]
    return LightObservations(uv_px=uv, cov_px2=cov)


class Shown(NamedTuple):
    """Moments that show a target, by their numbers (g,), all sights of its lights, why the others do not, and R (g, 3,
    3), t (g, 3) of it. unclear: how many of the others show too little to tell."""

    numbers: Index
    seen: LightObservations
    rejected: Rejected
    R: Array
    t: Array
    unclear: int


def _shown(rig: Rig, moments: Sequence[LitMoment], X: Array, naming: Naming) -> Shown:
    """Return the moments that show the lights X (n, 3)."""
    names = LETTERS[: len(X)]
    look = naming(rig, spot_target({name: tuple(xyz) for name, xyz in zip(LETTERS, X.tolist(), strict=False)}))
    numbers, rejected, R, t, unclear = [], [], [], [], 0
    uv, cov = _blank(len(moments), len(X), len(rig.cameras))
    for number, moment in enumerate(moments):
        found = look(moment.views)
        if isinstance(found, NotSeen):
            rejected.append((number, found.why))
            unclear += found.cause in TOO_LITTLE
            continue
        for side, (spots, shown) in enumerate(zip(found.spots, found.names, strict=True)):
            at = [names.index(name) for name in shown]
            uv[number, at, side], cov[number, at, side] = spots.uv_px, spots.covariance_px2
        numbers.append(number)
        R.append(found.T_rig_target[:3, :3])
        t.append(found.T_rig_target[:3, 3])
    kept = np.array(numbers, dtype=np.intp)
    seen = LightObservations(uv_px=uv[kept], cov_px2=cov[kept])
    return Shown(kept, seen, rejected, np.array(R).reshape(-1, 3, 3), np.array(t).reshape(-1, 3), unclear)


def _completed(rig: Rig, moments: Sequence[LitMoment], shape: Shape, naming: Naming) -> Shape | None:
    """Return the target by all moments that show it as it is known so far; None where these are too few."""
    shown = _shown(rig, moments, shape.xyz_m, naming)
    if len(shown.numbers) < MIN_FRAMES:
        return None
    labelled = replace(shape.labelled, numbers=shown.numbers, rejected=shown.rejected)
    every = np.ones(len(shown.numbers), bool)
    bundle, used = fit_frames(rig, shape.layout, shown.seen, labelled, every, shape.bundle.values, shown.R, shown.t)
    labelled = replace(labelled, numbers=shown.numbers[used])
    return Shape(shape.layout, bundle, labelled, shown.seen.take(used), shown.unclear)
