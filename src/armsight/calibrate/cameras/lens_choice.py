"""Is it a pinhole or a fisheye that took the images? Asked of every fit that leaves a doubt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, residuals_px
from armsight.calibrate.cameras.initial_guess import (
    board_poses,
    focal_lengths,
    homographies,
    start_intrinsics,
    start_of_fisheye,
)
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fixed_names
from armsight.calibrate.cameras.pairing import camera_of
from armsight.calibrate.cameras.preconditions import DOUBTFUL_TILT_DEG
from armsight.errors import DataRefused, Inconsistent
from armsight.optics import LensKind

OTHER = {LensKind.PINHOLE: LensKind.FISHEYE, LensKind.FISHEYE: LensKind.PINHOLE}
MUCH_BETTER, BETTER = 0.7, 0.9
"""Median residual of the other lens over that of this one: refused below the first, told below the second."""
WIDE = 1.0
"""Tangent of the angle from the axis (45 degrees) within which five coefficients say all that a lens does."""
NOISY = 1.5
"""Residuals of this many times what the detector claims are worth the question on narrow lenses too."""
KEPT = 0.9
"""A fit that leaves out more than a tenth of the points is worth the question too."""
GOOD_PX = 1.0
"""Where one lens cannot be fitted at all, the other is named if it leaves less than this, median."""


def start_of(observations: Observations) -> Bundle:
    """Return the start of one camera, of the lens that the observations are of."""
    if observations.lenses[0] is LensKind.FISHEYE:
        return start_of_fisheye(observations)
    H = homographies(observations)
    size = observations.sizes[0]
    focal = focal_lengths(H, size[0])
    return Bundle(k=start_intrinsics(focal, size)[None], poses=board_poses(H, focal, size[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """What a lens leaves of the points: the median distance, px, over all points given.

    tilt_deg: greatest angle between two boards. reach: greatest tangent of a point's angle from the axis.
    """

    lens: LensKind
    median_px: float
    tilt_deg: float
    reach: float


def refuse_other_lens(given: Observations, fit: RobustFit, options: BoardOptions, c: int, name: str) -> list[str]:
    """Return advice where the other kind of lens fits camera c somewhat better; raises Inconsistent for much better.

    given: all that was to be fitted. Asked where the lens is wide, residuals are large or many points were left out.
    """
    state, pair, options = bundle_of(fit.fit, given.n_cameras), options.lenses, options.of_camera(c)
    used = fit.observations
    kept = int(np.count_nonzero(used.weight[:, c])) / max(int(np.count_nonzero(given.weight[:, c])), 1)
    if fit.fit.scale < NOISY and kept > KEPT and options.lens is LensKind.PINHOLE:
        camera = camera_of(state.k[c], given.sizes[c], options.lens)
        rays = camera.rays(used.uv[:, c][used.weight[:, c] > 0.0])
        if float(np.nanmax(np.linalg.norm(rays, axis=1))) < WIDE and np.isfinite(rays).all():
            return []
    residual = np.linalg.norm(residuals_px(used, fit.fit)[:, c], axis=2)[used.weight[:, c] > 0.0]
    # points left out are no merit: what is kept must be better by their share
    own = float(np.median(residual)) / kept
    other = lens_alone(given.camera(c), options, OTHER[options.lens])
    if other is None or not other.median_px < BETTER * own:
        return []
    if given.n_cameras == 2:
        # on equal footing, of this camera alone: what makes the pairs disagree speaks for no other lens
        alone = lens_alone(given.camera(c), options, options.lens)
        own = own if alone is None else min(own, alone.median_px)
        if not other.median_px < BETTER * own:
            return []
    asked = other.lens.value if given.n_cameras == 1 else _of_pair(pair, c)
    seen = (
        f"{name}: a {other.lens.value} lens leaves {other.median_px:.2f} px of the board's points (median), "
        f"a {options.lens.value} {own:.2f} px"
    )
    if other.median_px < MUCH_BETTER * own:
        raise Inconsistent(
            f"{seen}: this looks like a {other.lens.value} lens",
            consequence="Towards the image's edge every ray would be wrong, so nothing was written",
            cure=f"Use --lens {asked}",
        )
    return [f"{seen}; compare the two with --lens {asked}"]


def _of_pair(lenses: tuple[LensKind, LensKind], c: int) -> str:
    """Return what to ask for where camera c of a pair has the other kind of lens."""
    swapped = [OTHER[lens] if side == c else lens for side, lens in enumerate(lenses)]
    if swapped[0] == swapped[1]:
        return swapped[0].value
    both = ",".join(lens.value for lens in swapped)
    return f"{swapped[c].value}, or {both} where the other camera is a {swapped[1 - c].value}"


def lens_alone(one: Observations, options: BoardOptions, lens: LensKind) -> Fitted | None:
    """Return what a kind of lens leaves of one camera's points, None where it cannot be fitted."""
    seen = replace(one, lenses=(lens,))
    plain = BoardOptions(lens=lens, max_iterations=options.max_iterations, automatic_k3=False)
    try:
        fit = adjust(seen, start_of(seen), fixed_names(plain, seen), max_iterations=plain.max_iterations)
    except DataRefused:
        return None
    left = np.linalg.norm(residuals_px(seen, fit), axis=3)[seen.weight > 0.0]
    rays = camera_of(bundle_of(fit, 1).k[0], seen.sizes[0], lens).rays(seen.uv[seen.weight > 0.0])
    normals = Rotation.from_rotvec(fit.local[:, 3:]).as_matrix()[:, :, 2]
    return Fitted(
        lens=lens,
        median_px=float(np.median(left)),
        tilt_deg=float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0))).max()),
        reach=float(np.nanmax(np.linalg.norm(rays, axis=1), initial=0.0)),
    )


def with_hint(error: DataRefused, one: Observations, options: BoardOptions) -> DataRefused:
    """Return the refusal of a fit; where the other kind of lens fits well, one that says so.

    Of boards that are not tilted, or in the middle of the image only, any lens fits.
    """
    other = lens_alone(one, options, OTHER[options.lens])
    if other is None or not (other.median_px < GOOD_PX and other.tilt_deg > DOUBTFUL_TILT_DEG):
        return error
    own = lens_alone(one, options, options.lens)
    if own is not None and not other.median_px < BETTER * own.median_px:
        return error
    if other.lens is LensKind.FISHEYE and other.reach < WIDE:
        return error
    return Inconsistent(
        f"{error.cause}; a {other.lens.value} lens fits the points to {other.median_px:.2f} px (median): "
        f"this looks like a {other.lens.value} lens",
        consequence=error.consequence,
        cure=f"Use --lens {other.lens.value}",
    )
