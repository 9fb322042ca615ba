"""Which kind of lens took the images? Asked of every fit that leaves a doubt."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, names_of, residuals_px, start_at
from armsight.calibrate.cameras.initial_guess import (
    board_poses,
    focal_lengths,
    homographies,
    start_intrinsics,
    start_of_fisheye,
)
from armsight.calibrate.cameras.observations import BoardOptions, Observations, pack
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_without_outliers, fixed_names
from armsight.calibrate.cameras.pairing import camera_of
from armsight.calibrate.cameras.preconditions import DOUBTFUL_TILT_DEG
from armsight.errors import DataRefused, Inconsistent
from armsight.optics import INTRINSICS, LensKind
from armsight.records import BoardView, Target

OTHERS = {
    LensKind.PINHOLE: (LensKind.FISHEYE, LensKind.RATIONAL),
    LensKind.FISHEYE: (LensKind.PINHOLE, LensKind.RATIONAL),
    LensKind.RATIONAL: (LensKind.FISHEYE,),  # a pinhole is one of its own
}
MORE_TERMS = 0.95
"""A rational lens is named before another where it leaves less than this share of what the other leaves: it has more
coefficients, which fit noise as well."""
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
    k = np.pad(start_intrinsics(focal, size), (0, observations.n_intrinsics - len(INTRINSICS)))
    return Bundle(k=k[None], poses=board_poses(H, focal, size[0]))


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
    """Return advice where another kind of lens fits camera c somewhat better; raises Inconsistent for much better.

    given: all that was to be fitted. Asked where the lens is wide, residuals are large or many points were left out.
    """
    state, pair, options = bundle_of(fit.fit, given.n_cameras), options.lenses, options.of_camera(c)
    used = fit.observations
    kept = int(np.count_nonzero(used.weight[:, c])) / max(int(np.count_nonzero(given.weight[:, c])), 1)
    if fit.fit.scale < NOISY and kept > KEPT and options.lens is not LensKind.FISHEYE:
        camera = camera_of(state.k[c], given.sizes[c], options.lens)
        rays = camera.rays(used.uv[:, c][used.weight[:, c] > 0.0])
        if float(np.nanmax(np.linalg.norm(rays, axis=1))) < WIDE and np.isfinite(rays).all():
            return []
    residual = np.linalg.norm(residuals_px(used, fit.fit)[:, c], axis=2)[used.weight[:, c] > 0.0]
    # points left out are no merit: what is kept must be better by their share
    own = float(np.median(residual)) / kept
    other = _best_other(given.camera(c), options)
    if other is None or not other.median_px < BETTER * own:
        return []
    if given.n_cameras == 2:
        # on equal footing, of this camera alone: what makes the pairs disagree speaks for no other lens
        alone = lens_alone(given.camera(c), options, options.lens)
        own = own if alone is None else min(own, alone.median_px)
        if not other.median_px < BETTER * own:
            return []
    asked = other.lens.value if given.n_cameras == 1 else _of_pair(pair, c, other.lens)
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


def _of_pair(lenses: tuple[LensKind, LensKind], c: int, other: LensKind) -> str:
    """Return what to ask for where camera c of a pair has another kind of lens."""
    swapped = [other if side == c else lens for side, lens in enumerate(lenses)]
    if swapped[0] == swapped[1]:
        return swapped[0].value
    both = ",".join(lens.value for lens in swapped)
    return f"{swapped[c].value}, or {both} where the other camera is a {swapped[1 - c].value}"


def _best_other(one: Observations, options: BoardOptions) -> Fitted | None:
    """Return what the other kind of lens leaves that leaves least, None where none can be fitted."""
    found = [lens_alone(one, options, lens) for lens in OTHERS[options.lens]]
    share = {LensKind.RATIONAL: 1.0 / MORE_TERMS}
    return min(filter(None, found), key=lambda fit: share.get(fit.lens, 1.0) * fit.median_px, default=None)


# Which kind of lens leaves least on images that had no part in the fit.

CHOICE = (LensKind.PINHOLE, LensKind.FISHEYE, LensKind.RATIONAL)
"""In this order: a later one takes the place where it leaves less for sure."""
CHOICE_FOLDS = 4
SURELY = 3.0
"""Standard deviations by which one kind of lens leaves less than another, by what it leaves in each image."""
WILD = 5.0
"""Times the median distance; a point further off counts as one there: a wrong corner is no lens's fault."""


def chosen(
    views: Mapping[str, Sequence[BoardView]], board: Target, options: BoardOptions
) -> tuple[BoardOptions, list[str]]:
    """Return the options with the kinds of lens that leave least, and what to say of them; as they are where those are
    not asked for.

    views: of one camera, or of left and right, by what it is called.
    """
    if not options.choose_lens:
        return options, []
    found = {name: least(pack([one], board), options) for name, one in views.items()}
    kinds = [kind for kind, _ in found.values()]
    told = [f"{name}: {words}" for name, (_, words) in found.items()]
    return replace(options, choose_lens=False, lens=kinds[0], right_lens=kinds[-1]), told


def with_chosen(given: Observations, options: BoardOptions, known: Collection[str]) -> tuple[Observations, list[str]]:
    """Return what some cameras saw with the kinds of lens that leave least, and what to say; known: whose lens is."""
    kinds, told = list(given.lenses), list[str]()
    for c, name in enumerate(given.cameras if options.choose_lens else ()):
        views = np.flatnonzero((given.weight[:, c] > 0.0).any(axis=1))
        if name not in known and len(views):
            kinds[c], words = least(given.camera(c).take(views), options)
            told.append(f"the camera {name}: {words}")
    return replace(given, lenses=tuple(kinds)), told


def least(one: Observations, options: BoardOptions) -> tuple[LensKind, str]:
    """Return the kind of lens that leaves least of one camera's points, and what each leaves."""
    kinds = [lens for lens in CHOICE if one.radius_m == 0.0 or lens is not LensKind.FISHEYE]  # which bends circles
    left = {lens: px for lens in kinds if (px := _left_out_px(one, options, lens)) is not None}
    if not left:
        return LensKind.PINHOLE, "no kind of lens can be fitted to a part of the images, so a pinhole is taken"
    seen = one.weight[:, 0] > 0.0
    wild = WILD * min(float(np.median(px[seen])) for px in left.values())
    squares = {lens: (np.minimum(px, wild) ** 2 * seen).sum(axis=1) for lens, px in left.items()}  # (G,) of each image
    best = next(iter(squares))
    for lens, of_views in squares.items():
        less = squares[best] - of_views
        if less.sum() > SURELY * np.sqrt(len(less)) * less.std():
            best = lens
    words = ", ".join(f"{lens.value} {np.median(px[seen]):.3g} px" for lens, px in left.items())
    return best, f"--lens {best.value} is chosen by what the kinds leave on images left out (median): {words}"


def _left_out_px(one: Observations, options: BoardOptions, lens: LensKind) -> Array | None:
    """Return the distances (G, n) in px that a kind of lens leaves in images left out, None where it cannot be fitted.

    In these only the boards' poses are fitted.
    """
    seen, plain = replace(one, lenses=(lens,)), replace(options, lens=lens, right_lens=None, automatic_k3=False)
    fixed, everything = fixed_names(plain, seen), frozenset(names_of(seen))
    views = np.arange(seen.n_views)
    px = np.zeros(seen.weight.shape[::2])
    try:
        whole = bundle_of(adjust(seen, start_of(seen), fixed, max_iterations=options.max_iterations), 1)
        for fold in range(CHOICE_FOLDS):
            stay, out = views[views % CHOICE_FOLDS != fold], views[views % CHOICE_FOLDS == fold]
            fit = fit_without_outliers(seen.take(stay), start_at(whole, stay), plain).fit
            part, state = seen.take(out), replace(start_at(whole, out), k=bundle_of(fit, 1).k)
            posed = adjust(part, state, everything, max_iterations=options.max_iterations)
            px[out] = np.linalg.norm(residuals_px(part, posed)[:, 0], axis=2)
    except DataRefused:
        return None
    return px


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
    """Return the refusal of a fit; where another kind of lens fits well, one that says so.

    Of boards that are not tilted, or in the middle of the image only, any lens fits.
    """
    other = _best_other(one, options)
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
