"""What the calibration of a whole cell returns, with how well the tip is known over a work volume."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cameras.pairing import baseline_std
from armsight.calibrate.cell.checks import Suspicion
from armsight.calibrate.cell.knowledge import rigid_moves
from armsight.calibrate.cell.model import CellModel
from armsight.calibrate.cell.parts import CellParts
from armsight.calibrate.cell.rounds import Solved
from armsight.fields import Doc
from armsight.geometry.poses import skew
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.records import Target
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, PoseStd, Verdict
from armsight.shown import Shown, Table, digits, parameter_row, pose_rows
from armsight.units import MM

FEWEST_SEEN, FEWEST_SIGHTS = 3, 4
"""Lights by which a pose is measured, a pair's each in both images; and sights of them, in all images, by others."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipSlopes:
    """How the tip moves in base axes with the cell's parameters: measured, commanded (k, 3, P); seen (k,).

    measured: as the cameras see the target, by its lights. commanded: as the joints say. noise (k, 3, 3): what the
    spots' noise of one pair of frames does to the measured tip, m^2.
    """

    measured: Array
    commanded: Array
    noise: Array
    seen: NDArray[np.bool_]

    def take(self, rows: NDArray[np.intp]) -> TipSlopes:
        """Return those of some positions."""
        return TipSlopes(
            measured=self.measured[rows], commanded=self.commanded[rows], noise=self.noise[rows], seen=self.seen[rows]
        )

    def spread_m(self, slopes: Array, covariance: Array) -> Array:
        """Return the covariance (k, 3, 3) of the tip by that (P, P) of the parameters."""
        return np.asarray(slopes @ covariance @ slopes.transpose(0, 2, 1))

    def strayed_m(self, columns: NDArray[np.intp], std: Array) -> Array:
        """Return the covariance (k, 3, 3) of the commanded tip where joints, columns (n,), stray by std (n,)."""
        return self.spread_m(self.commanded[:, :, columns], np.diag(std**2))


def tip_slopes(
    model: CellModel,
    x: Array,
    q: Array,
    T_flange_target: RigidTransform,
    tip_m: Array,
    sigma_px: Sequence[float],
    looked: Array | None = None,
) -> TipSlopes:
    """Return how the tip at tip_m (3,) in target axes depends on the parameters, the arm standing at q (k, n).

    looked (k, V, n): which lights each camera sees there; None: all that are in its image.
    """
    k, n, P = len(q), len(model.lights), len(x)
    (uv, J), T = model.standing(x, q), model.flange(x, q)
    arm_at, lights = np.array(T_flange_target.apply(tip_m)), model.lights_m(x)
    tip = T[:, :3, :3] @ arm_at  # (k, 3) from the flange
    inside = _inside(model, uv)
    if looked is not None:
        inside &= looked.astype(bool)
        uv, J = np.where(inside[..., None], uv, 0.0), np.where(inside[..., None, None], J, 0.0)
    weight = inside / np.square(np.asarray(sigma_px))[None, :, None]
    # by the target's own motion (dt, dw) about the tip: a light at T (light - tip) moves by dt + dw x that
    a = model.lights_at
    by_flange = np.stack([J[:, :, i, :, a + 3 * i : a + 3 * i + 3] for i in range(n)], axis=2)  # by lights' places
    by_base = by_flange @ T[:, None, None, :3, :3].transpose(0, 1, 2, 4, 3)
    lever = (T[:, :3, :3] @ (lights - arm_at).T).transpose(0, 2, 1)  # (k, n, 3)
    by_pose = np.concatenate([by_base, by_base @ -skew(lever)[:, None]], axis=-1)  # (k, V, n, 2, 6)
    by_x = J.copy()
    by_x[..., model.arm_at : a] = 0.0  # where the arm stands is what is measured
    # how the target moves with its lights; what is no such motion is its shape
    carried = np.linalg.pinv(moves := rigid_moves(lights, arm_at))  # (6, 3 n)
    by_x[..., a:] = by_x[..., a:] @ (np.eye(len(moves)) - moves @ carried)
    A, B = by_pose.reshape(k, -1, 6), by_x.reshape(k, -1, P)
    w = np.repeat(weight.reshape(k, -1), 2, axis=1)[:, :, None]
    # the pose is where A' W (A dpose + B dx) = 0: what the parameters do to the pixels, the pose takes up
    H = A.transpose(0, 2, 1) @ (w * A)
    seen = _enough(inside, pair=model.recording.is_pair) & np.isfinite(uv).all(axis=(1, 2, 3))
    H[~seen] = np.eye(6)
    inverse = np.linalg.inv(H)
    measured = -(inverse @ (A.transpose(0, 2, 1) @ (w * B)))[:, :3]
    measured[~seen] = np.nan
    commanded = np.concatenate([_by_links(model, x, q, tip), T[:, :3, :3] @ carried[:3]], axis=2)
    return TipSlopes(measured=measured, commanded=commanded, noise=inverse[:, :3, :3], seen=seen)


def _enough(inside: NDArray[np.bool_], *, pair: bool) -> NDArray[np.bool_]:
    """Return where (k,) sights (k, V, n) make a pose."""
    lights = (inside.all(axis=1) if pair else inside.any(axis=1)).sum(axis=1)
    return np.asarray((lights >= FEWEST_SEEN) & (pair | (inside.sum(axis=(1, 2)) >= FEWEST_SIGHTS)))


def _by_links(model: CellModel, x: Array, q: Array, tip: Array) -> Array:
    """Return how the tip, (k, 3) from the flange, moves (k, 3, arm_at + arm's parameters) with cameras and links."""
    links = model.flange_slopes(x, q)  # (k, 6, arm parameters)
    by_arm = links[:, :3] + np.cross(links[:, 3:].transpose(0, 2, 1), tip[:, None, :]).transpose(0, 2, 1)
    return np.concatenate([np.zeros((len(q), 3, model.arm_at)), by_arm], axis=2)


def _inside(model: CellModel, uv: Array) -> NDArray[np.bool_]:
    """Return which pixels (k, V, n, 2) are in their camera's image."""
    largest = np.array(model.recording.sizes)[None, :, None] - 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(((uv >= 0.0) & (uv <= largest)).all(axis=-1))


UNLEARNED_BITS = 0.2
"""Of a parameter that the recording says so little about, only what was known before is known."""
NOTED_SCALE = 2.6
"""Deviations by which arm and target may differ in scale untold: one recording in a hundred does so by chance."""
COARSE_M = 2e-3
"""A tip known no better than this is told as weak: welding and gluing want a half of it."""


class Learned(NamedTuple):
    """A parameter, what was known of it before, and what the recording says."""

    name: Annotated[str, Doc("Its name, the unit in it; px and none for a lens's.")]
    value: Annotated[float, Doc("Its value; of the arm's links the change to the model.")]
    std: Annotated[float, Doc("Standard deviation.")]
    prior_std: Annotated[float | None, Doc("Standard deviation before the recording; null where nothing was known.")]
    bits: Annotated[float | None, Doc("Information gained: log2 of the ratio of the two; null with no prior.")]


@output
class TipDeviation(Output):
    """How well the tip is known in base axes over the volume of the recording, standard deviations of its place."""

    measured_m: Annotated[float, Doc("As the cameras see the target: by the calibration, median, m.")]
    measured_worst_m: Annotated[float, Doc("The same where it is worst, m.")]
    commanded_m: Annotated[float, Doc("As the calibrated arm's joints say, median, m.")]
    commanded_worst_m: Annotated[float, Doc("The same where it is worst, m.")]
    noise_m: Annotated[float, Doc("What the spots' noise of one pair of frames adds to a measurement, median, m.")]


@output
class ScaleCheck(Output):
    """The arm's lengths and the target's, each held against the other; the better known one sets the scale."""

    set_by: Annotated[str, Doc("arm or target: whose lengths weigh more.")]
    ratio: Annotated[float, Doc("The target's size as the arm says, over that in its file.")]
    std: Annotated[float, Doc("Standard deviation of the ratio.")]


@output
class StrayingArm(Output):
    """How far the arm strays from its readings, slowly."""

    std_rad: Annotated[float, Doc("Of a turning joint, rad.")]
    time_s: Annotated[float, Doc("After which it is forgotten, s.")]


@output
class CellResult(Output):
    """armsight calibrate cell.

    parts: rig, place, target and arm as files hold them. covariance (P, P) of solved.model.names. doubts: what speaks
    against one model, none of it alarming. samples (k, n), tip_measured, tip_commanded (k, 3, 3): covariances of the
    tip in base axes at joint positions over the volume; tip_places_m (k, 3). nominal: the arm as it was given.
    """

    nominal: Arm
    parts: CellParts
    solved: Solved
    covariance: Array
    doubts: tuple[Suspicion, ...]
    samples: Array
    tip_places_m: Array
    tip_measured: Array
    tip_commanded: Array
    n_frames: Annotated[int, Doc("Frames of all cameras together.")]
    n_spots: Annotated[int, Doc("Spots used, each of one light.")]
    n_left_out: Annotated[int, Doc("Spots of no light: lamps, reflections, touched ones.")]
    duration_s: Annotated[float, Doc("How long the arm was seen, s.")]
    residual_px: Annotated[dict[str, float], Doc("RMS residual of a spot's coordinate by camera, px.", unit="px")]
    left_out_px: Annotated[
        dict[str, float], Doc("The same of stretches of motion that were left out of the fit by turns, px.", unit="px")
    ]
    delay_s: Annotated[
        dict[str, float], Doc("Robot's time less each camera's stamp in the middle of the recording, s.", unit="s")
    ]
    learned: Annotated[tuple[Learned, ...], Doc("All parameters that were fitted.")]
    gauges: Annotated[tuple[str, ...], Doc("What no recording can tell, and how it was fixed.")]
    fixed: Annotated[tuple[str, ...], Doc("Parameters of the arm that are as in its model.")]
    straying: Annotated[StrayingArm, Doc("How far the arm strays from its readings.")]
    scale: Annotated[ScaleCheck, Doc("Arm and target held against each other.")]
    tip: Annotated[TipDeviation, Doc("How well the tip is known in base axes over the recording's volume.")]
    notes: Annotated[tuple[str, ...], Doc("What to know about the result.")]
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]

    @property
    def rig(self) -> Rig:
        """The cameras, with their timing."""
        return self.parts.rig

    @property
    def target(self) -> Target:
        """With its lights where they were found."""
        return self.parts.target

    @property
    def arm(self) -> Arm:
        """As it was found, the target its tool."""
        return self.parts.arm

    @figure("Where the rig, its first camera, stands in base axes.")
    def T_base_rig(self) -> RigidTransform:
        return self.parts.T_base_rig

    @figure("Standard deviations of T_base_rig.")
    def std(self) -> PoseStd:
        return PoseStd(**self.parts.base_covariance.std())

    @figure("The target on the flange.")
    def T_flange_target(self) -> RigidTransform:
        return self.parts.T_flange_target

    @figure("From left to right, m; null of other cameras.")
    def baseline_m(self) -> float | None:
        return self.rig.baseline_m if self.rig.is_pair else None

    @figure("Standard deviation of the baseline, m.")
    def baseline_std_m(self) -> float | None:
        return baseline_std(self.rig) if self.rig.is_pair else None

    @figure("Parameters of which the recording says nothing beyond what was known.")
    def unlearned(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.learned if one.bits is not None and one.bits < UNLEARNED_BITS)

    @figure("Whether the result can be trusted, in words.")
    def verdict(self) -> str:
        return f"{'good' if self.verdict_.level == 'good' else 'weak'}: {self._known}"

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        first, rest = self._known[0], self._known[1:]
        known = f"{first.upper()}{rest} (one standard deviation, base axes, as {self.all_cameras} measure it)."
        if abs(self.scale.ratio - 1.0) > NOTED_SCALE * self.scale.std:
            return Verdict(level="care", headline="Check the scale", reasons=[known], next=[f"{self.notes[-1]}."])
        if self.tip.measured_worst_m > COARSE_M:
            todo = "Record longer, with larger turns of the wrist, nearer to the cameras."
            return Verdict(level="care", headline="Weak", reasons=[known], next=[*self.advice[:1]] or [todo])
        todo = "Use rig.yaml, world.yaml, target.yaml and arm.yaml; measure a place you know before you trust it."
        return Verdict(level="good", headline="Good", reasons=[known], next=[*self.advice[:1]] or [todo])

    def summary(self) -> Iterator[Shown]:
        """Yield how well the tip is known, where the rig stands, what changed in the arm, and what it rests on."""
        tip, T, std = self.tip, self.T_base_rig, self.std
        rows = [
            [f"as {self.all_cameras} measure it", digits(tip.measured_m / MM, 2), digits(tip.measured_worst_m / MM, 2)],
            ["as the arm's joints say", digits(tip.commanded_m / MM, 2), digits(tip.commanded_worst_m / MM, 2)],
            [f"added by the noise of one {'pair' if self.rig.is_pair else 'moment'}", digits(tip.noise_m / MM, 2), ""],
        ]
        yield Table("The tip in base axes, +- mm", ["", "typical", "worst"], rows)
        rows = pose_rows(T.translation, T.rotation.as_rotvec(), std.translation_m, std.rotation_rad)
        yield Table("T_base_rig", ["", "value", "+-"], rows)
        rows = [
            parameter_row(one.name, one.value, one.std)
            for one in self.learned
            if one.name in self.solved.model.arm.geometry or one.name.endswith(".sag")
        ]
        yield Table("Changes of the arm", ["", "by", "+-"], rows)
        yield self.verdict
        residual, left_out = (" and ".join(map(digits, px.values())) for px in (self.residual_px, self.left_out_px))
        if not self.rig.is_pair:
            yield Table("Cameras", ["", "from the first, mm", "+-", "px RMS", "left out"], self._camera_rows())
        yield (
            f"{self.n_frames} frames, {self.n_spots} spots, {self.n_left_out} of no light; residual "
            f"{residual} px RMS, in stretches left out {left_out} px"
        )
        yield (
            f"Size of the target by the arm's lengths over its file's: {self.scale.ratio:.4f} +- {self.scale.std:.4f}; "
            f"the {self.scale.set_by} sets the scale"
        )
        yield from self.notes
        yield from (f"- {text}" for text in self.advice)

    @property
    def all_cameras(self) -> str:
        """The cameras in words."""
        return "both cameras" if self.rig.is_pair else "the cameras"

    def _camera_rows(self) -> list[list[str]]:
        rows, C = [], self.rig.covariance
        for one in self.rig.cameras:
            t, names = (
                np.asarray(one.T_rig_camera.translation),
                tuple(f"{one.name}.{key}" for key in ("tx", "ty", "tz")),
            )
            far, std = float(np.linalg.norm(t)), None
            if C is not None and set(names) <= set(C.names):
                std = float(np.sqrt(t @ C.block(names) @ t)) / far
            px = [digits(self.residual_px[one.name]), digits(self.left_out_px[one.name])]
            rows.append([one.name, digits(far / MM, 6), digits(None if std is None else std / MM, 2), *px])
        return rows

    @property
    def _known(self) -> str:
        """How well the tip is known, in words."""
        return f"the tip to {1e3 * self.tip.measured_m:.2g} mm, {1e3 * self.tip.measured_worst_m:.2g} mm at worst"
