"""A lit target's geometry from frames of a calibrated rig: which light is which, then all frames in one bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.light_target.adjustment import (
    LETTERS,
    Layout,
    LightBundle,
    LightObservations,
    LitFrame,
    Sight,
    fit_bundle,
    line_frame,
    line_layout,
    name_order,
    plane_frame,
    plane_layout,
    sights_of,
)
from armsight.calibrate.light_target.checks import (
    MIN_FRAMES,
    distinguishable_frames,
    few_frames,
    not_rigid,
    on_line,
    on_one_line,
    require_lights,
    require_names,
    require_rigid,
    require_side,
    require_turned,
)
from armsight.calibrate.light_target.naming import Named, distances, find_shape
from armsight.calibrate.light_target.result import RejectedFrame, TargetResult, advise, distances_of
from armsight.defaults import LIT_LIGHTS
from armsight.fitting.quantiles import chi2_isf, chi2_ppf
from armsight.optics import Rig, triangulate
from armsight.records import NamedCovariance
from armsight.records.checks import TARGET_M, check_metres
from armsight.units import MM

Flags = NDArray[np.bool_]
Rejected = list[tuple[int, str]]

FALSE_ALARM = 1e-4
"""Chance that any frame of a good recording is left out for its residuals."""

LEAST_SHARE = 0.6
"""Share of the frames with all lights that must agree on one shape."""

TINY = 1e-300


def calibrate_target(
    rig: Rig, frames: Sequence[LitFrame], lights: int = LIT_LIGHTS, *, overlaid: bool = False
) -> TargetResult:
    """Return where the lights are in the target's own frame, from frames of a calibrated rig.

    The lights are named across frames by their distances, so their order in the rows does not matter; A is leftmost in
    the mean of the left images, w points away from the camera (MATH 3.2). Standard deviations hold the spots' noise,
    widened where the residuals are larger, and the rig's covariance. overlaid: both views are in one image, which only
    changes what a refusal advises. Raises UsageError for a number of lights
    that is not 2 to 6, NotEnoughData below three frames, Degenerate for three and more lights on one line, Ambiguous
    where a symmetric arrangement leaves the names open, Inconsistent where the frames share no rigid shape.
    """
    require_lights(lights)
    labelled = named_by_shape(*sights_of(rig, frames, lights), len(frames), lights, overlaid=overlaid)
    named, numbers = labelled.named, labelled.numbers
    flat = on_one_line(named)
    keep = np.ones(len(numbers), bool) if flat else clear_frames(labelled)
    seen = _observations(frames, numbers, named)
    order = _order(named, seen, keep, flat)
    layout = line_layout(lights) if flat else plane_layout(lights)
    seen = LightObservations(uv_px=seen.uv_px[:, order], cov_px2=seen.cov_px2[:, order])
    bundle, used = fit_frames(rig, layout, seen, labelled, keep, *guess(layout, named, order))
    require_turned(float(turns(bundle.poses)[0]))
    require_rigid(bundle, epipolar(rig, seen.take(used)), lights, int(used.sum()))
    return found_target(rig, layout, bundle, [frame.name for frame in frames], numbers[used], labelled.rejected)


def found_target(
    rig: Rig,
    layout: Layout,
    bundle: LightBundle,
    frames: Sequence[str],
    used: NDArray[np.intp],
    rejected: Rejected,
    unclear: int = 0,
) -> TargetResult:
    """Return the target of a fit to the used of the frames, which are named. Raises Degenerate for lights on a line.

    unclear: of the rejected, those that show too little of it.
    """
    covariance = _covariance(layout, bundle)
    X = layout.spots(bundle.values)
    names = tuple(LETTERS[: len(X)])
    check_metres(distances(X), TARGET_M, "by this rig the lights are apart by")
    if layout.on_line and len(X) > 2:
        raise on_line(distances_of(names, X, covariance))
    return advise(
        TargetResult(
            names=names,
            xyz_m=X,
            covariance=NamedCovariance(names=tuple(f"{n}.{a}_m" for n in names for a in "xyz"), matrix=covariance),
            n_frames=len(frames),
            used=tuple(frames[i] for i in used),
            rejected=tuple(RejectedFrame(frames[i], why) for i, why in sorted(rejected)),
            residual_px=bundle.residual_px,
            left_out_px=bundle.left_out_px,
            scale=float(np.sqrt(bundle.scale2)),
            rig_share=None if rig.covariance is None else _share(layout, bundle, covariance),
            rotation_excitation_rms_rad=turns(bundle.poses),
            n_unclear=unclear,
            advice=(),
        )
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledFrames:
    """The shape that frames share with their lights named by it, and the frames' numbers (n,).

    rejected: number of each other frame, and why; grows while more are left out. overlaid: as in calibrate_target.
    """

    named: Named
    numbers: NDArray[np.intp]
    rejected: Rejected
    overlaid: bool


def named_by_shape(
    sights: Sequence[Sight],
    rejected: Rejected,
    n_frames: int,
    lights: int,
    *,
    overlaid: bool = False,
    many: bool = False,
) -> LabelledFrames:
    """Return the same of frames whose lights are seen; rejected: number of each other one, and why.

    many: any two of several cameras see them, and none of these is called left.
    """
    if len(sights) < MIN_FRAMES:
        raise few_frames(len(sights), n_frames, lights, rejected, overlaid=overlaid, many=many)
    named = find_shape(sights)
    rejected += [
        (sights[s].frame, f"distances of its lights differ by {off / MM:.2g} mm from those of the other frames")
        for s, off in named.misfit
    ]
    if len(named.number) < max(MIN_FRAMES, LEAST_SHARE * len(sights)):
        raise not_rigid(len(named.number), len(sights), named, overlaid=overlaid or many)
    numbers = np.array([sights[s].frame for s in named.number], dtype=np.intp)
    return LabelledFrames(named=named, numbers=numbers, rejected=rejected, overlaid=overlaid or many)


def clear_frames(labelled: LabelledFrames) -> Flags:
    """Return the frames whose lights can be named, and say of the others why not."""
    named = labelled.named
    told, other = distinguishable_frames(named)
    require_names(named, told, other)
    require_side(named)
    minority = named.behind if named.behind.mean() <= 0.5 else ~named.behind
    reversed_ = minority & (len(named.X) == 3)  # more lights in space do not fit from behind
    for i in np.flatnonzero(~told | reversed_):
        why = (
            "its lights run the other way round: a mirror image, or the target from behind"
            if reversed_[i]
            else "its lights cannot be told apart from this side"
        )
        labelled.rejected.append((int(labelled.numbers[i]), why))
    return np.asarray(told & ~reversed_)


def _observations(frames: Sequence[LitFrame], numbers: NDArray[np.intp], named: Named) -> LightObservations:
    views = [
        [(s.uv_px[rows], s.covariance_px2[rows]) for s in (frames[i].left, frames[i].right)]
        for i, rows in zip(numbers, named.rows, strict=True)
    ]
    return LightObservations(
        uv_px=np.array([np.stack([left[0], right[0]], axis=1) for left, right in views]),
        cov_px2=np.array([np.stack([left[1], right[1]], axis=1) for left, right in views]),
    )


def _order(named: Named, seen: LightObservations, keep: Flags, flat: bool) -> NDArray[np.intp]:
    """Return the order of the shape's lights that makes them A, B, C ..."""
    u = seen.uv_px[keep][:, :, 0, 0]
    u = (u - u.mean(axis=1, keepdims=True)).mean(axis=0)
    X = named.X
    if flat:
        along = X @ line_frame(X)[0][:, 0]
        order = np.argsort(along)
        return np.asarray(order if u[order[0]] <= u[order[-1]] else order[::-1])
    # the mean way from the camera to the target, in its own axes
    rays = named.t[keep] + named.R[keep] @ X.mean(axis=0)
    away = np.einsum("gji,gj->gi", named.R[keep], rays / np.linalg.norm(rays, axis=1, keepdims=True)).mean(axis=0)
    return name_order(X, away, u)


def guess(layout: Layout, named: Named, order: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return the layout's values (k,), and R (g, 3, 3), t (g, 3) of the frames, as they were named."""
    X = named.X[order]
    axes, origin = (line_frame if layout.on_line else plane_frame)(X)
    own = (X - origin) @ axes
    values = np.asarray(np.linalg.lstsq(layout.basis, own.ravel(), rcond=None)[0], float)
    return values, named.R @ axes, named.R @ origin + named.t


def fit_frames(
    rig: Rig,
    layout: Layout,
    seen: LightObservations,
    labelled: LabelledFrames,
    keep: Flags,
    values: Array,
    R: Array,
    t: Array,
) -> tuple[LightBundle, Flags]:
    """Return the bundle of the frames that agree, and which these are; the worst are left out one after the other.

    values (k,) of the layout, R (g, 3, 3), t (g, 3) of the frames: to begin with.
    """
    named, used = labelled.named, keep.copy()
    total = int(used.sum())
    for _ in range(total):
        if used.sum() < MIN_FRAMES or used.sum() < LEAST_SHARE * total:
            raise not_rigid(int(used.sum()), total, named, overlaid=labelled.overlaid)
        bundle = fit_bundle(rig, layout, seen.take(used), values, R[used], t[used])
        dof = seen.take(used).dof(layout)
        middle = max(float(np.median(bundle.frame_chi2 / chi2_ppf(0.5, dof))), 1.0)
        over = bundle.frame_chi2 / (middle * chi2_isf(FALSE_ALARM / total, dof))
        # one at a time: a wrong frame bends the shape and makes good ones look bad
        worst = int(np.argmax(over))
        if over[worst] <= 1.0:
            break
        number = int(np.flatnonzero(used)[worst])
        rms = float(np.sqrt(np.nanmean(bundle.residual_px[worst] ** 2)))
        why = f"residuals of {rms:.2g} px: a reflection, a wrong pair or a blur"
        labelled.rejected.append((int(labelled.numbers[number]), why))
        used[number] = False
    return bundle, used


def epipolar(rig: Rig, seen: LightObservations) -> tuple[float, int]:
    """Return chi-square of the views against each other, which no shape can change, and its degrees of freedom."""
    V = seen.uv_px.shape[2]
    uv, cov = seen.uv_px.reshape(-1, V, 2), seen.cov_px2.reshape(-1, V, 2, 2)
    there = seen.seen.reshape(-1, V)
    # of more views the first two that see a light: a sample of what all leave
    order = np.argsort(~there, axis=1, kind="stable")[:, :2]
    chi2, dof = 0.0, 0
    for a, b in combinations(range(V), 2):
        rows = (order == (a, b)).all(axis=1) & there[:, a] & there[:, b]
        if rows.any():
            points = triangulate(pair_of(rig, a, b), uv[rows, a], uv[rows, b], cov[rows, a], cov[rows, b])
            chi2, dof = chi2 + float(points.chi2[points.found].sum()), dof + int(points.found.sum())
    return chi2, dof


def pair_of(rig: Rig, a: int, b: int) -> Rig:
    """Return two cameras of a rig as left and right, in its axes."""
    if rig.is_pair:
        return rig
    one, two = rig.cameras[a], rig.cameras[b]
    return Rig(left=one.camera, right=two.camera, T_rig_left=one.T_rig_camera, T_rig_right=two.T_rig_camera)


def _covariance(layout: Layout, bundle: LightBundle) -> Array:
    """Return (3 n, 3 n); the noise is never believed to be smaller than the spots say."""
    covariance = bundle.covariance * max(bundle.scale2, 1.0) + bundle.rig_share
    return np.asarray(layout.basis @ covariance @ layout.basis.T)


def _share(layout: Layout, bundle: LightBundle, covariance: Array) -> float:
    """Return the part of the standard deviation that the rig's calibration alone would make."""
    own = np.trace(layout.basis @ bundle.rig_share @ layout.basis.T)
    return float(np.sqrt(own / max(np.trace(covariance), TINY)))


def turns(poses: Array) -> Array:
    """Return the root mean square turn (3,) about the principal axes, falling, in rad."""
    rotations = Rotation.from_rotvec(np.array(poses[:, 3:]))
    w = (rotations.mean().inv() * rotations).as_rotvec()
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(w.T @ w / len(w))[::-1], 0.0)))
