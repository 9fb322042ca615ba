"""What stays the same from frame to frame, prepared once: the target as the search takes it, rig, settings, slack."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np

from armsight.arrays import Array, Mask
from armsight.errors import Degenerate
from armsight.geometry import align_points
from armsight.measure.settings import BATCH, Pace, SpotSettings
from armsight.optics import PLACE, PackedRig, Rig, mean_axes, moved_rig, shared_point
from armsight.optics.parallelism import difference_step
from armsight.records import NoiseModel, Target, frozen_array

SLACK_PX = 0.25
"""What calibration, the target's measures and the shutters' skew may add to a spot's own standard deviation, in each
coordinate, before a match is doubted. Real pairs calibrated with printed boards show 0.1-0.2 px. It decides what
belongs together, not the covariance that is handed out."""

COLLINEAR = 0.02
"""Second principal spread over the first below which spots count as lying on one line: the turn about it would be
50 times as uncertain as the others."""

FLAT_SHARE = 0.05
"""Third principal spread over the first below which the lights share a plane, whose normal is then theirs."""

FIT_SIGMA = 5.0
"""A fit whose chi-square lies further out than this normal deviation (3e-7) is not the target."""

FACING = 0.9
"""|cosine| between the plane's normal and the target's z above which z tells the two sides apart (25 degrees)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetModel:
    """names; xyz_m (m, 3); distance_m (m, m); normal (3,) of the plane; radius_m of a flat light, 0 where not used.

    reach_m: of the light that is furthest from their mean. lean (3,): radius_m along the normal. limits (m + 1,):
    fit_limit of each number of spots seen twice. flat: the lights share a plane, or are fewer than three. one_sided:
    the plane is square to z, and they are seen from its -z side only (z points away from the camera, as w does in
    Pachidis 2005, eqs. 7-8, and as z of a printed board does).
    """

    names: tuple[str, ...]
    xyz_m: Array
    distance_m: Array
    reach_m: float
    normal: Array
    radius_m: float
    lean: Array
    flat: bool
    one_sided: bool
    limits: Array

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of(cls, target: Target) -> TargetModel:
        """Prepare a target. Raises Degenerate where three or more measured spots lie on one line."""
        X = np.asarray(target.xyz_m)
        reach_m = float(np.linalg.norm(X - X.mean(axis=0), axis=1).max())
        normal, flat, one_sided = np.array([0.0, 0.0, 1.0]), True, False
        if target.model_known and len(X) >= 3:
            _, spread, axes = np.linalg.svd(X - X.mean(axis=0))
            if spread[1] <= COLLINEAR * spread[0]:
                raise Degenerate(
                    "the target's spots lie on one line",
                    consequence="Its turn about that line cannot be known",
                    cure="Use a target whose spots form a triangle",
                )
            normal, flat = axes[2], bool(spread[2] <= FLAT_SHARE * spread[0])
            one_sided = flat and bool(abs(normal[2]) >= FACING)
        radius_m = 0.5 * target.diameter_m if target.diameter_m is not None and flat else 0.0
        return cls(
            names=target.names,
            xyz_m=frozen_array("xyz_m", X, (None, 3)),
            distance_m=frozen_array("distance_m", np.linalg.norm(X[:, None] - X[None], axis=2), (None, None)),
            reach_m=reach_m,
            normal=frozen_array("normal", normal, (3,)),
            radius_m=radius_m,
            lean=frozen_array("lean", radius_m * normal, (3,)),
            flat=flat,
            one_sided=one_sided,
            limits=frozen_array("limits", [fit_limit(2 * n) for n in range(len(X) + 1)], (None,)),
        )


def fit_limit(n_sights: int) -> float:
    """Return the largest chi-square of n sights of named lights, 2 n - 6 degrees of freedom (Wilson-Hilferty)."""
    dof = max(2 * n_sights - 6, 1)
    spread = 2.0 / (9.0 * dof)
    return float(dof * (1.0 - spread + FIT_SIGMA * np.sqrt(spread)) ** 3)


def symmetries(target: Target, tolerance_m: float = 1e-3) -> tuple[tuple[str, ...], ...]:
    """Return the renamings under which a turned target looks the same, within tolerance_m in every spot.

    Each is the tuple of names that take the places of target.names. Empty where the names can be told from the
    positions alone. A turn that shows the other side of a flat target square to z does not count: its lights are seen
    from one side. For targets of up to eight spots; the equilateral triangle has two.
    """
    model = TargetModel.of(target)
    if len(model) < 3 or len(model) > 8 or not target.model_known:
        return ()
    found = []
    for order in permutations(range(len(model))):
        other = list(order)
        if other == sorted(other):
            continue
        if np.abs(model.distance_m - model.distance_m[np.ix_(other, other)]).max() > 2.0 * tolerance_m:
            continue
        fit = align_points(model.xyz_m[other], model.xyz_m)
        shown = not model.one_sided or fit.T_a_b.rotation.as_matrix()[2, 2] > 0.0
        worst = np.linalg.norm(fit.T_a_b.apply(model.xyz_m) - model.xyz_m[other], axis=1).max()
        if shown and worst <= tolerance_m:
            found.append(tuple(model.names[i] for i in other))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """The rig, the target and how spots are found.

    slack_px: what calibration, the target's measures and the shutters' skew may add to a spot's standard deviation
    before a match is doubted. A colour of the target is looked for unless the settings name their own. Raises
    Degenerate for a measured target whose spots (three or more) lie on one line. overlaid: one image holds both views,
    one upon the other (a mirror rig's complex image); it is then given as the left and as the right frame. covariance:
    of the rig's q parameters and of the target's positions, (q + 3 m, q + 3 m), (q, q) where the target is exact,
    (0, 0) where the rig is as well. Both are taken as independent. sides: the settings of each camera, with the gain of
    its noise where the rig knows it, and with its own of masks, (h, w), in place of the settings' one.
    pace: how long a moment may take, and on how many cores.
    """

    rig: Rig
    target: Target
    settings: SpotSettings = field(default_factory=SpotSettings)
    slack_px: float = SLACK_PX
    overlaid: bool = False
    masks: tuple[Mask | None, ...] = ()
    pace: Pace = BATCH
    packed: PackedRig = field(init=False, repr=False)
    model: TargetModel = field(init=False, repr=False)
    covariance: Array = field(init=False, repr=False)

    sides: tuple[SpotSettings, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "packed", PackedRig.of(self.rig))
        object.__setattr__(self, "model", TargetModel.of(self.target))
        object.__setattr__(self, "covariance", _joint_covariance(self.packed, self.target.covariance))
        if self.target.colour is not None and self.settings.colour is None:
            object.__setattr__(self, "settings", replace(self.settings, colour=self.target.colour))
        masks = self.masks or (None,) * len(self.rig.noise)
        own = [self.settings if mask is None else replace(self.settings, mask=mask) for mask in masks]
        sides = tuple(_with_noise(one, noise) for one, noise in zip(own, self.rig.noise, strict=True))
        object.__setattr__(self, "sides", sides)

    def pair(self, a: int, b: int) -> Setup:
        """Return the setup of two of the rig's cameras, for naming: without the rig's covariance, in the same axes."""
        packed, at = self.packed, [a, b]
        centres = [-packed.R[s].T @ packed.t[s] for s in at]
        of_two = PackedRig(
            k=frozen_array("k", packed.k[at], (2, None)),
            R=frozen_array("R", packed.R[at], (2, 3, 3)),
            t=frozen_array("t", packed.t[at], (2, 3)),
            baseline=frozen_array("baseline", centres[1] - centres[0], (3,)),
            covariance=np.empty((0, 0)),
        )
        out = copy(self)
        object.__setattr__(out, "packed", of_two)
        return out

    def covariance_of(self, names: tuple[str, ...]) -> Array:
        """Return the covariance of the rig's parameters and of these lights' positions, in their order."""
        if names == self.model.names or len(self.covariance) <= (n := n_parameters(self.packed)):
            return self.covariance
        lights = np.array([self.model.names.index(name) for name in names])
        index = np.concatenate([np.arange(n), (n + 3 * lights[:, None] + np.arange(3)).ravel()])
        out = np.ascontiguousarray(self.covariance[np.ix_(index, index)])
        out.setflags(write=False)  # as the whole one: one compilation serves both
        return out


def n_parameters(packed: PackedRig) -> int:
    """Return how many parameters the calibration of a rig has: all intrinsics, and all poses but the first."""
    return (packed.n_intrinsics + len(PLACE)) * len(packed.k) - len(PLACE)


def _joint_covariance(packed: PackedRig, target: Array | None) -> Array:
    rig, n = packed.covariance, n_parameters(packed)
    if target is None:
        return rig
    out = np.zeros((n + len(target), n + len(target)))
    out[:n, :n] = rig if rig.size else 0.0
    out[n:, n:] = target
    out.setflags(write=False)
    return out


def _with_noise(settings: SpotSettings, noise: NoiseModel | None) -> SpotSettings:
    """Return the settings with the shot noise's gain of a camera whose noise is known and follows a line."""
    if settings.gain is not None or noise is None or noise.linear is None:
        return settings
    return replace(settings, gain=noise.linear.gain_levels)


AWAY = 8.0
"""Baselines at which the miss is worked out: it hardly changes with distance."""

POINT_STEP_M = 1e-6

SHARED = 2.0
"""Slack for each standard deviation: slack is judged light by light, and a rig's error is the same at all of them, so
that three lights with a common miss of three standard deviations must still pass."""


def rig_slack_px(rig: Rig) -> float:
    """Return the slack that a rig's covariance asks for, in px; SLACK_PX at least.

    It is SHARED times the standard deviation of what two pixels of a point keep once the point is fitted to them.
    """
    if rig.covariance is None or len(rig.cameras) < 2:
        return SLACK_PX
    point = _far_point(rig) if rig.is_pair else shared_point(rig)
    if not all(np.isfinite(uv).all() for uv in rig.project(point)):
        return SLACK_PX
    J = np.column_stack([_slope(_pixels(rig, point + h), _pixels(rig, point - h), POINT_STEP_M) for h in _steps(3)])
    miss = np.linalg.svd(J)[0][:, 3:]  # (2 v, 2 v - 3): what no move of the point explains
    names = tuple(name for name in rig.parameters if name in rig.covariance.names)
    D = np.column_stack([_by_parameter(rig, name, point) for name in names])  # (2 v, p)
    variance = miss.T @ D @ rig.covariance.block(names) @ D.T @ miss
    if not rig.is_pair:  # of each pixel, in which a slack is counted
        variance = np.diag(miss @ variance @ miss.T)
    return max(SLACK_PX, SHARED * float(np.sqrt(variance.max())))


def _far_point(rig: Rig) -> Array:
    axes = mean_axes(rig)
    middle = 0.5 * (np.asarray(rig.T_rig_left.translation) + np.asarray(rig.T_rig_right.translation))
    return np.asarray(middle + AWAY * rig.baseline_m * axes[:, 2])


def _steps(n: int) -> Array:
    return np.asarray(POINT_STEP_M * np.eye(n))


def _pixels(rig: Rig, point: Array) -> Array:
    return np.concatenate([uv[0] for uv in rig.project(point)])


def _slope(plus: Array, minus: Array, step: float) -> Array:
    return np.asarray((plus - minus) / (2.0 * step))


def _by_parameter(rig: Rig, name: str, point: Array) -> Array:
    """Return d pixels (2 v,) of all views / d one of the rig's parameters."""
    size = difference_step(name)
    step = np.zeros(len(rig.parameters))
    step[rig.parameters.index(name)] = size
    return _slope(_pixels(moved_rig(rig, step), point), _pixels(moved_rig(rig, -step), point), size)
