"""The target in the form the search takes it: positions, distances, plane, symmetry."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Degenerate
from armsight.geometry import align_points
from armsight.records import Target, frozen_array

Array = NDArray[np.float64]

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

    lean (3,): radius_m along the normal. limits (m + 1,): fit_limit of each number of spots. one_sided: the lights
    share a plane square to z, and are seen from its -z side only (z points away from the camera, as w does in Pachidis
    2005, eqs. 7-8, and as z of a printed board does).
    """

    names: tuple[str, ...]
    xyz_m: Array
    distance_m: Array
    normal: Array
    radius_m: float
    lean: Array
    one_sided: bool
    limits: Array

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def of(cls, target: Target) -> TargetModel:
        """Prepare a target. Raises Degenerate where three or more measured spots lie on one line."""
        X = np.asarray(target.xyz_m)
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
            normal=frozen_array("normal", normal, (3,)),
            radius_m=radius_m,
            lean=frozen_array("lean", radius_m * normal, (3,)),
            one_sided=one_sided,
            limits=frozen_array("limits", [fit_limit(n) for n in range(len(X) + 1)], (None,)),
        )


def fit_limit(n_spots: int) -> float:
    """Return the largest chi-square of n named spots in two views, 4 n - 6 degrees of freedom (Wilson-Hilferty)."""
    dof = max(4 * n_spots - 6, 1)
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
