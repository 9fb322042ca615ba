"""Have the mirrors of a rig moved, which, and how are they turned back, or until the virtual optical axes are parallel?

Parallel axes (Pachidis 2005, section 2) leave three angles to be brought to zero: convergence, vertical and roll. A
mirror that turns by an angle turns its virtual camera by twice as much about the same axis: mirror 2 about the vertical
answers for the convergence, and mirrors 2 and 4, tilted about the lines in their faces square to it, for the sum and
the difference of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, poses_of_boards, residuals_px
from armsight.calibrate.cameras.calibrate import rms, view_rms
from armsight.calibrate.cameras.initial_guess import board_poses, homographies
from armsight.calibrate.cameras.observations import Observations, pack
from armsight.calibrate.cameras.pairing import baseline_std, in_frame, rig_of
from armsight.calibrate.cameras.result import StereoCalibration
from armsight.calibrate.mirrors.calibration import MirrorCalibration, without_plate
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fields import Doc
from armsight.fitting import Fit
from armsight.optics import INTRINSICS, SIDES, Camera, Rig, RigKind
from armsight.optics.mirrors import Mirrors
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import BoardView, NamedCovariance, Target, TargetPose
from armsight.records.output import Output, output

LEAST_LIT = 5
"""Views of a lit target below which the mirrors' position is not asked for."""
GOOD_LIT = 10
VAGUE = 0.01
"""Standard deviation of the baseline, by itself, from which the views are too much alike."""
MIRRORS = 4
STEP_RAD = 1e-6
DIAGNOSIS_ROUNDS = 4
STILL = 25.0
"""Chi-square of six numbers (3e-4 by chance) below which nothing has moved."""
APART = 9.0
"""Chi-square by which the best mirror must be better than the next for the two to be told apart."""
FIXED = frozenset(f"{side}.{name}" for side in SIDES for name in INTRINSICS)
POSE = ("right.tx", "right.ty", "right.tz", "right.rx", "right.ry", "right.rz")


@output
class Suspect(Output):
    """A mirror that may have moved."""

    mirror: Annotated[int, Doc("Which, 1 to 4.")]
    turn_rad: Annotated[float, Doc("How far about the vertical, rad.")]
    tilt_rad: Annotated[float, Doc("How far about the line in its face square to the vertical, rad.")]
    chi2: Annotated[float, Doc("Chi-square that it leaves.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """How the virtual cameras stand now, what has changed since the calibration, and which mirror explains it.

    change: of T_left_right as (dt m, rotation vector rad) in left axes, std its standard deviations. chi2: of no
    change.
    suspects: the best first; none where nothing has moved.
    """

    now: Parallelism
    rig: Rig
    change: Array
    std: Array
    chi2: float
    suspects: tuple[Suspect, ...]
    n_views: int

    @property
    def moved(self) -> bool:
        """Whether anything has moved beyond the views' noise."""
        return bool(self.suspects)

    @property
    def certain(self) -> bool:
        """Whether one mirror alone explains the change: it fits, and the next one does clearly worse."""
        return self.moved and self.suspects[1].chi2 - self.suspects[0].chi2 > APART

    def advice(self) -> str:
        """Return what to do, in words."""
        if not self.moved:
            return "the mirrors stand as they did when the rig was calibrated"
        best = self.suspects[0]
        turns = f"by {-1e3 * best.turn_rad:+.2f} mrad about the vertical and {-1e3 * best.tilt_rad:+.2f} mrad across"
        others = [str(one.mirror) for one in self.suspects[1:] if one.chi2 - best.chi2 <= APART]
        if others:
            return f"turn mirror {best.mirror} {turns}; mirror {' or '.join(others)} may be the one that moved"
        if best.chi2 > STILL * 4.0:
            return f"more than one mirror has moved; begin with mirror {best.mirror}: turn it {turns}"
        return f"turn mirror {best.mirror} back {turns}"


def check_alignment(
    rig: Rig, left: Sequence[BoardView], right: Sequence[BoardView], board: Target, *, design: Mirrors | None = None
) -> Alignment:
    """Return how the mirrors stand against a rig calibrated before, from views of a board (one pair is enough).

    design: where the mirrors stand; the rig's baseline and plate with the usual distances where it is not given.
    Raises Inconsistent for a rig without mirrors or another size of image, NotEnoughData without views.
    """
    if rig.kind is not RigKind.MIRROR:
        raise Inconsistent("this rig has no mirrors", cure="Give the rig.yaml of `armsight calibrate mirrors`")
    if not left or len(left) != len(right):
        raise NotEnoughData("the board is not seen in both views", cure="Show the board to both views")
    now = relative_rig(rig, left, right, board)
    before = rig.T_rig_left.inv() * rig.T_rig_right
    T_now = now.T_rig_left.inv() * now.T_rig_right
    change: Array = np.concatenate(
        [T_now.translation - before.translation, (T_now.rotation * before.rotation.inv()).as_rotvec()]
    )
    # a difference of two independent measurements: today's and the calibration's
    C = _covariance(now, POSE) + _in_left_axes(rig)
    if design is None:
        design = Mirrors(baseline_m=rig.baseline_m)
    # Mahalanobis distance of no change, six degrees of freedom: shifts and turns in one figure by what each is known to
    W = np.asarray(np.linalg.inv(C))
    chi2 = float(change @ W @ change)
    suspects: tuple[Suspect, ...] = ()
    if chi2 > STILL:
        found = [_suspect(design, mirror, change, W) for mirror in range(MIRRORS)]
        suspects = tuple(sorted(found, key=lambda one: one.chi2))
    return Alignment(
        now=parallelism(now),
        rig=now,
        change=change,
        std=np.sqrt(np.diag(C)),
        chi2=chi2,
        suspects=suspects,
        n_views=len(left),
    )


def mirrors_from_target(
    design: Rig, views: Sequence[tuple[BoardView, BoardView]], poses: Sequence[TargetPose], target: Target
) -> MirrorCalibration:
    """Return the mirror rig that saw the lit target in both views, started from its design and the poses that gives.

    The lens and the plate are taken as known: three lights do not tell them. Raises NotEnoughData for fewer than
    LEAST_LIT views.
    """
    if len(views) < LEAST_LIT:
        raise NotEnoughData(
            f"the target is seen in {len(views)} images, {LEAST_LIT} are needed",
            consequence="Nothing was calibrated",
            cure="Turn the target, and show it near and far, left and right",
        )
    observations = pack([[left for left, _ in views], [right for _, right in views]], target)
    # the bundle counts the lights from their middle, about which a view's turn and position are least correlated
    T_target_middle = RigidTransform.from_translation(observations.middle)
    local = []
    for pose in poses:
        if pose.pose is None:
            raise Inconsistent("a view without a pose")
        T = design.T_rig_left.inv() * pose.pose * T_target_middle
        local.append(np.concatenate([T.translation, T.rotation.as_rotvec()]))
    used, fit = _fit(design, observations, np.array(local))
    pair = _as_pair(used, fit)
    rig = replace(pair.rig.with_each(camera=(design.left, design.right)), kind=RigKind.MIRROR)
    return MirrorCalibration(
        rig=in_frame(rig, design.T_rig_left), pair=pair, seen_m=None, seen_std_m=None, one_lens=True, advice=pair.advice
    )


def _as_pair(used: Observations, fit: Fit) -> StereoCalibration:
    """Return the fit's figures as of a stereo pair; of left-out views and of the board's lengths there are none."""
    residual, seen = residuals_px(used, fit), used.weight > 0.0
    overall = rms(residual, seen)
    rig = rig_of(bundle_of(fit, 2), used.sizes, covariance=fit.covariance, rms_px=overall)
    advice = ["the lens and the plate are taken as they were given: an error in them is not in the standard deviations"]
    if used.n_views < GOOD_LIT:
        advice.append(f"{used.n_views} images were used: {GOOD_LIT} and more tell wrong ones better")
    if baseline_std(rig) > VAGUE * rig.baseline_m:
        advice.append(
            f"the baseline is known to {1e3 * baseline_std(rig):.2g} mm only: show the target turned to several sides, "
            "near and far, left and right"
        )
    return StereoCalibration(
        rig=rig,
        baseline_std_m=baseline_std(rig),
        rms_px=overall,
        n_pairs=used.n_views,
        n_used=used.n_views,
        rejected=(),
        holdout_rms_px=None,
        holdout_epipolar_rms_px=None,
        metric={},
        metric_is_left_out=False,
        view_rms_px=view_rms(residual, seen),
        used=used,
        residual_px={side: residual[:, c][seen[:, c]] for c, side in enumerate(SIDES)},
        T_left_board=poses_of_boards(used, fit),
        advice=tuple(advice),
    )


def relative_rig(rig: Rig, left: Sequence[BoardView], right: Sequence[BoardView], board: Target) -> Rig:
    """Return the rig with T_rig_right, and its covariance, as the views show it now; the lens is taken as it was."""
    observations = pack([left, right], board)
    for camera, size in zip((rig.left, rig.right), observations.sizes, strict=True):
        if (camera.width, camera.height) != size:
            raise Inconsistent(
                f"the images are {size[0]}x{size[1]} px, the rig's {camera.width}x{camera.height} px",
                cure="Use the resolution of the calibration",
            )
    poses = board_poses(homographies(observations.camera(0)), rig.left.intrinsics[:2], observations.sizes[0][0])
    used, fit = _fit(rig, observations, poses)
    overall = rms(residuals_px(used, fit), used.weight > 0.0)
    found = rig_of(bundle_of(fit, 2), used.sizes, covariance=fit.covariance, rms_px=overall)
    return replace(found.with_each(camera=(rig.left, rig.right)), kind=RigKind.MIRROR)


def _fit(rig: Rig, observations: Observations, poses: Array) -> tuple[Observations, Fit]:
    """Return the fit of T_left_right and the poses T_left_board (G, 6), and the sightings without the plate's part."""
    k = np.stack([rig.left.intrinsics, rig.right.intrinsics])
    T = rig.T_rig_left.inv() * rig.T_rig_right
    start = Bundle(k=k, sides=np.concatenate([T.translation, T.rotation.as_rotvec()])[None], poses=poses)
    fit = adjust(observations, start, FIXED, max_iterations=60)
    if rig.left.plate is not None:
        observations = without_plate(observations, bundle_of(fit, 2), rig.left.plate)
        fit = adjust(observations, bundle_of(fit, 2), FIXED, max_iterations=60)
    return observations, fit


def _covariance(rig: Rig, names: tuple[str, ...]) -> Array:
    if rig.covariance is None:
        raise NotEnoughData("the views leave nothing to find the noise by", cure="Show the whole board")
    return rig.covariance.block(names)


def _in_left_axes(rig: Rig) -> Array:
    """Return the covariance (6, 6) of the calibration's T_left_right, lens and pose together, 0 where not known.

    The lens's share is left out: it is the same now as it was then.
    """
    known: NamedCovariance | None = rig.covariance
    if known is None:
        return np.zeros((6, 6))
    R = rig.T_rig_left.rotation.as_matrix().T
    turn = np.kron(np.eye(2), R)
    inverse = np.linalg.pinv(known.matrix)
    at = [known.names.index(name) for name in POSE]
    # the inverse of a block of the information: the pose's covariance with the lens held
    return np.asarray(turn @ np.linalg.inv(inverse[np.ix_(at, at)]) @ turn.T)


def _suspect(design: Mirrors, mirror: int, change: Array, W: Array) -> Suspect:
    """Return the turn of one mirror that explains the change best."""
    tilt = np.zeros(2)
    # Gauss-Newton on two angles, six numbers weighed by their covariance; chi-square tells which mirror explains most
    for _ in range(DIAGNOSIS_ROUNDS):
        r = _with_tilt(design, mirror, tilt) - change
        J = np.column_stack(
            [
                (_with_tilt(design, mirror, tilt + step) - _with_tilt(design, mirror, tilt - step)) / (2.0 * STEP_RAD)
                for step in STEP_RAD * np.eye(2)
            ]
        )
        tilt = tilt - np.linalg.solve(J.T @ W @ J, J.T @ W @ r)
    r = _with_tilt(design, mirror, tilt) - change
    return Suspect(mirror=mirror + 1, turn_rad=float(tilt[0]), tilt_rad=float(tilt[1]), chi2=float(r @ W @ r))


def _with_tilt(design: Mirrors, mirror: int, tilt: Array) -> Array:
    tilts = np.zeros((MIRRORS, 2))
    tilts[mirror] = tilt
    return predicted_change(design, tilts)


def predicted_change(design: Mirrors, tilts_rad: Array) -> Array:
    """Return the change (6,) of T_left_right that turned mirrors (4, 2) make: dt in m, rotation vector in rad."""
    before = _left_right(replace(design, tilts_rad=np.zeros((MIRRORS, 2))))
    after = _left_right(replace(design, tilts_rad=tilts_rad))
    return np.concatenate(
        [after.translation - before.translation, (after.rotation * before.rotation.inv()).as_rotvec()]
    )


def _left_right(design: Mirrors) -> RigidTransform:
    return design.pose("left").inv() * design.pose("right")


ROUNDS = 4
CERTAIN = 16.3
"""Chi-square of three angles, 1e-3 by chance, beyond which axes are not parallel as far as the views tell."""
FREE = ((1, 0), (1, 1), (3, 1))
"""What is turned: mirror 2 about the vertical and across, mirror 4 across (mirrors counted from 0)."""


@output
class MirrorTurn(Output):
    """How a mirror is to be turned so that the virtual optical axes become parallel."""

    mirror: Annotated[int, Doc("1 to 4.")]
    turn_rad: Annotated[float, Doc("About the vertical y (down): positive is clockwise seen from above.")]
    tilt_rad: Annotated[
        float,
        Doc("About the line in its face square to y: positive brings its upper edge back, to the camera's side."),
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """How far the axes are from parallel, and the turns that make them so.

    rotation_rad (3,): the rotation vector of T_left_right, 0 where they are parallel, with std_rad (3,), in left axes.
    turns: of mirrors 2 and 4.
    """

    now: Parallelism
    rig: Rig
    rotation_rad: Array
    std_rad: Array
    turns: tuple[MirrorTurn, MirrorTurn]
    chi2: float
    n_views: int

    @property
    def parallel(self) -> bool:
        """Whether the views' noise alone could have made the angles."""
        return self.chi2 <= CERTAIN

    def advice(self) -> str:
        """Return what to do, in words."""
        if self.parallel:
            return "the virtual optical axes are parallel as far as the views tell"
        second, fourth = self.turns
        return (
            f"turn mirror 2 by {1e3 * second.turn_rad:+.2f} mrad about the vertical and {1e3 * second.tilt_rad:+.2f} "
            f"mrad across, and mirror 4 by {1e3 * fourth.tilt_rad:+.2f} mrad across"
        )


def adjust_to_parallel(
    camera: Camera, design: Mirrors, left: Sequence[BoardView], right: Sequence[BoardView], board: Target
) -> Adjustment:
    """Return how the mirrors must be turned, from views of a board (one pair is enough) through a lens that is known.

    design: where the mirrors should stand. Raises NotEnoughData without views, Inconsistent for another size of image.
    """
    if not left or len(left) != len(right):
        raise NotEnoughData("the board is not seen in both views", cure="Show the board to both views")
    now = relative_rig(design.rig(camera), left, right, board)
    T_left_right = now.T_rig_left.inv() * now.T_rig_right
    rotation, C = T_left_right.rotation.as_rotvec(), _covariance(now, POSE[3:])
    stands = _stands(design, rotation)
    turns = (
        MirrorTurn(mirror=2, turn_rad=float(-stands[0]), tilt_rad=float(-stands[1])),
        MirrorTurn(mirror=4, turn_rad=0.0, tilt_rad=float(-stands[2])),
    )
    return Adjustment(
        now=parallelism(now),
        rig=now,
        rotation_rad=rotation,
        std_rad=np.sqrt(np.diag(C)),
        turns=turns,
        chi2=float(rotation @ np.linalg.solve(C, rotation)),
        n_views=len(left),
    )


def _stands(design: Mirrors, rotation: Array) -> Array:
    """Return by how much (3,) the FREE turns are off that make this rotation (3,)."""
    x = np.zeros(3)
    # Newton, on three angles that are nearly linear in the turns
    for _ in range(ROUNDS):
        J = np.column_stack(
            [(_made(design, x + s) - _made(design, x - s)) / (2 * STEP_RAD) for s in STEP_RAD * np.eye(3)]
        )
        x = x - np.linalg.solve(J, _made(design, x) - rotation)
    return x


def _made(design: Mirrors, x: Array) -> Array:
    """Return the rotation vector (3,) of T_left_right that the FREE turns make."""
    tilts = np.zeros((MIRRORS, 2))
    for (mirror, which), angle in zip(FREE, x, strict=True):
        tilts[mirror, which] = angle
    return predicted_change(design, tilts)[3:]
