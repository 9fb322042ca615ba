"""A mirror rig from views of a printed board: one lens, two virtual cameras, the plate (Pachidis 2005, section 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import fdtrc

from armsight.calibrate.cameras.bundle_adjustment import Bundle, bundle_of
from armsight.calibrate.cameras.calibrate import fit_pairs, judged
from armsight.calibrate.cameras.kernels import matrices_of
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_without_outliers
from armsight.calibrate.cameras.pairing import in_frame
from armsight.calibrate.cameras.result import StereoCalibration
from armsight.defaults import GLASS
from armsight.errors import DataRefused, Inconsistent, UsageError
from armsight.optics import Camera, Plate, Rig, RigKind
from armsight.optics.kernels.camera import plate_shift
from armsight.records import BoardView, Progress, Target

TRIED_M = 1e-3
"""Thickness at which the plate's part is worked out; it grows in proportion."""
SEEN = 4.0
"""A plate thinner than this many standard deviations of its thickness is not there, as far as the views tell."""
AT_ODDS = 5.0
"""Standard deviations between the thickness given and the one seen from which it is worth a word."""
THICKEST_M = 0.03
"""A thicker plate than this is in no rig: what looks like one is a wrong image or a wrong board."""
WIDE = 2.0
"""Width over height of an image from which it is two side by side; no common sensor is wider than 1.9."""
ONE_LENS = 1e-6
"""Probability below which the two views are not those of one lens through flat mirrors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MirrorCalibration:
    """The rig (kind mirror, axes those of the real camera) and how good it is.

    pair: the figures of the fit, as of a stereo pair. seen_m, seen_std_m: the plate's thickness as the views show it,
    None where it was taken as known.
    one_lens: whether both views were explained by one lens; else the rig is a general pair of pinholes.
    """

    rig: Rig
    pair: StereoCalibration
    seen_m: float | None
    seen_std_m: float | None
    one_lens: bool
    advice: tuple[str, ...]

    @property
    def shift_m(self) -> float:
        """How far the plate shifts the left view's chief ray: m of eq. (5), and the l that goes with it (MATH 3.1)."""
        plate = self.rig.left.plate
        return 0.0 if plate is None else float(plate_shift(plate.thickness_m, plate.index, 0.0, 0.0))


def calibrate_mirrors(
    left: Sequence[BoardView],
    right: Sequence[BoardView],
    board: Target,
    *,
    thickness_m: float | None = None,
    index: float = GLASS,
    options: BoardOptions | None = None,
    progress: Progress | None = None,
) -> MirrorCalibration:
    """Return the mirror rig that saw the board in the left and right views, paired by position.

    thickness_m, index: of the plate; the thickness is found from the views where none is given, or 0 for no glass.
    Raises as calibrate_stereo, UsageError for a plate that cannot be, and Inconsistent where the images are no complex
    ones but two side by side.
    """
    options = options or BoardOptions()
    if thickness_m is not None and thickness_m < 0.0:
        raise UsageError(f"a plate {thickness_m:g} m thick cannot be", cure="Give its thickness in metres, or 0")
    if thickness_m:
        Plate(thickness_m=thickness_m, index=index)
    halves = _in_halves(left, right)
    if halves and left[0].width >= WIDE * left[0].height:
        raise _side_by_side(left[0])
    try:
        return _calibrated(left, right, board, thickness_m, index, options, progress)
    except DataRefused as error:
        if halves:
            raise _side_by_side(left[0]) from error
        raise


def _in_halves(left: Sequence[BoardView], right: Sequence[BoardView]) -> bool:
    """Whether in every complex image the two boards keep to its two halves, as two images side by side do."""
    of_one = [(a, b) for a, b in zip(left, right, strict=False) if a.source == b.source]
    return bool(of_one) and all(a.uv_px[:, 0].min() > 0.5 * a.width > b.uv_px[:, 0].max() for a, b in of_one)


def _side_by_side(view: BoardView) -> Inconsistent:
    return Inconsistent(
        f"{view.source} and the others ({view.width}x{view.height} px) show one board in their left half and one in "
        "their right half: they look like two images side by side, not one complex image",
        consequence="Nothing was calibrated",
        cure="Cut every image in two and use `armsight calibrate stereo --left --right`",
    )


def _refuse_swapped(free: RobustFit) -> None:
    """Raise Inconsistent where the right view is from the left: the covered paths were exchanged."""
    x, y, z = bundle_of(free.fit, 2).side_pose[:3].tolist()
    if x < 0.0 and abs(x) > max(abs(y), abs(z)):
        raise Inconsistent(
            f"left and right are swapped: the right view's camera stands {-1e3 * x:.1f} mm to the left of the left "
            "one's",
            consequence="Nothing was calibrated: every later use would call the views by the wrong name",
            cure="Exchange the sources of --left-only and --right-only, or switch off the camera's mirror mode",
        )


def _calibrated(
    left: Sequence[BoardView],
    right: Sequence[BoardView],
    board: Target,
    thickness_m: float | None,
    index: float,
    options: BoardOptions,
    progress: Progress | None,
) -> MirrorCalibration:
    free, rejected, advice = fit_pairs(left, right, board, options, progress)
    _refuse_swapped(free)
    seen, seen_std = _thickness(free, index, options)
    used, notes = _plate_used(seen, seen_std, thickness_m)
    plate = Plate(thickness_m=used, index=index) if used > 0.0 else None
    tied = _refit(free, plate, options)
    one_lens = _as_good(tied, free)
    if not one_lens:
        plate = None
        notes.append("the two views are not those of one lens through flat mirrors: each has its own intrinsics")
    chosen = tied if one_lens else free
    pair = judged(chosen, options, n_pairs=len(left), rejected=rejected, advice=[*advice, *notes])
    rig = replace(pair.rig.with_each(camera=(replace(pair.rig.left, plate=plate), pair.rig.right)), kind=RigKind.MIRROR)
    return MirrorCalibration(
        rig=in_frame(rig, _camera_frame(rig)),
        pair=pair,
        seen_m=seen,
        seen_std_m=seen_std,
        one_lens=one_lens,
        advice=pair.advice,
    )


def _plate_used(seen: float, seen_std: float, thickness_m: float | None) -> tuple[float, list[str]]:
    """Return the thickness of the plate to take, given or seen (m, with its standard deviation), and what is to be said
    of it.

    Raises Inconsistent where none is given and the views would need one that is in no rig.
    """
    if thickness_m is None and seen > THICKEST_M:
        raise Inconsistent(
            f"the two views would need a glass plate {1e3 * seen:.0f} mm thick between them",
            consequence="Nothing was calibrated: these are not the two views of one camera through four mirrors",
            cure="Check that the images are complex ones of this rig, and the board's squares; or give --plate-mm",
        )
    looks = f"{1e3 * seen:.2f} +- {1e3 * seen_std:.2f} mm"
    if thickness_m is None:
        if seen < SEEN * seen_std:
            return 0.0, [f"the views do not show a glass plate ({looks}): none is taken"]
        return seen, []
    if abs(seen - thickness_m) > AT_ODDS * seen_std:
        return thickness_m, [f"the plate looks {looks} thick, {1e3 * thickness_m:g} mm was given"]
    return thickness_m, []


def without_plate(observations: Observations, state: Bundle, plate: Plate) -> Observations:
    """Return the sightings with the left view's points where they would be without the plate.

    The board's poses are known to a thousandth of their distance, and the plate moves points by a tenth of a pixel.
    """
    lens = Camera(width=observations.sizes[0][0], height=observations.sizes[0][1], intrinsics=state.k[0])
    R = np.empty((len(state.poses), 3, 3))
    matrices_of(np.ascontiguousarray(state.poses[:, 3:]), R)
    positions = (observations.X @ R.transpose(0, 2, 1) + state.poses[:, None, :3]).reshape(-1, 3)
    moved = replace(lens, plate=plate).project(positions) - lens.project(positions)
    uv = observations.uv.copy()
    uv[:, 0] -= np.nan_to_num(moved).reshape(uv[:, 0].shape)
    return replace(observations, uv=uv)


def _refit(free: RobustFit, plate: Plate | None, options: BoardOptions) -> RobustFit:
    """Return the fit with one lens for both views, the plate's part taken out of the left ones."""
    state = bundle_of(free.fit, 2)
    observations = replace(free.observations, one_lens=True)
    if plate is not None:
        observations = without_plate(observations, state, plate)
    return fit_without_outliers(observations, state, options)


def _thickness(free: RobustFit, index: float, options: BoardOptions) -> tuple[float, float]:
    """Return the plate's thickness (m) as the views show it, and its standard deviation: the cost's parabola over
    it."""
    careful = replace(options, reject=False)
    costs, dof, scale = [], 1, 1.0
    for k in range(3):
        plate = Plate(thickness_m=k * TRIED_M, index=index) if k else None
        fit = _refit(free, plate, careful).fit
        costs.append(fit.cost)
        dof, scale = fit.dof, np.sqrt(2.0 * min(costs) / max(fit.dof, 1))
    # half chi-square is a parabola of the thickness: its vertex is the estimate, its bend the information on it
    bend = (costs[0] - 2.0 * costs[1] + costs[2]) / TRIED_M**2
    slope = (costs[2] - costs[0]) / (2.0 * TRIED_M)
    if not bend > 0.0 or dof < 1:
        return 0.0, float("inf")
    return float(max(TRIED_M - slope / bend, 0.0)), float(scale / np.sqrt(bend))


def _as_good(tied: RobustFit, free: RobustFit) -> bool:
    """Whether one lens explains the views as well as two do, noise and the number of parameters considered."""
    if tied.observations.n_points != free.observations.n_points:
        return tied.fit.scale < 1.1 * free.fit.scale
    # one lens is the model of two with its intrinsics held equal: an F test of the constraints, or a rise that is of no
    # account in a set so large that any shows
    more = max(free.fit.dof * -1 + tied.fit.dof, 1)
    gained = max(tied.fit.cost - free.fit.cost, 0.0) / more / max(free.fit.cost / max(free.fit.dof, 1), 1e-30)
    return bool(fdtrc(more, free.fit.dof, gained) > ONE_LENS or tied.fit.scale < 1.05 * free.fit.scale)


def _camera_frame(rig: Rig) -> RigidTransform:
    """Return T_camera_rig, the axes of the real camera: half the baseline before the virtual ones, between them.

    The left one without the shift of the plate.
    """
    left, right = (T.rotation.as_matrix() for T in (rig.T_rig_left, rig.T_rig_right))
    plate = rig.left.plate
    mu = 0.0 if plate is None else plate_shift(plate.thickness_m, plate.index, 0.0, 0.0)
    a = np.asarray(rig.T_rig_left.translation) - left @ np.array([-mu, 0.0, mu])
    b = np.asarray(rig.T_rig_right.translation)
    # the virtual centres stand at (+-b/2, 0, -b/2) of the real camera, the left one shifted by (-mu, 0, mu) (MATH 3.1)
    z = left[:, 2] + right[:, 2]
    z /= np.linalg.norm(z)
    x = (b - a) - ((b - a) @ z) * z
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(z, x), z])
    origin = 0.5 * (a + b) + 0.5 * float(np.linalg.norm(b - a)) * z
    return RigidTransform.from_components(origin, Rotation.from_matrix(R)).inv()
