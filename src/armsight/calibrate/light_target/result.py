"""What the calibration of a lit target returns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.light_target.naming import pairs_of
from armsight.fields import Doc
from armsight.records import NamedCovariance, Target, spot_target
from armsight.records.by_value import Saveable
from armsight.records.checks import checked_array, freeze
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Verdict
from armsight.shown import REJECTED_SHOWN, Shown, Table, digits
from armsight.units import DEG, MM

Vector3 = tuple[float, float, float]

GOOD_FRAMES = 10
GOOD_TURN_RAD = 10.0 * DEG
"""Root mean square tilt below which a depth difference of the lights is hardly seen from the side."""
LARGE_SCALE = 2.0
MANY_REJECTED = 0.2


@output
class LightDistance(Output):
    """The distance of two lights."""

    value_m: Annotated[float, Doc("The distance, m.")]
    std_m: Annotated[float, Doc("Its standard deviation, m.")]


class RejectedFrame(NamedTuple):
    """A frame that was left out."""

    frame: Annotated[str, Doc("The frame's file or source.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class TargetResult(Output, Saveable):
    """armsight calibrate target.

    names (n,) and xyz_m (n, 3) of the lights in the target's frame; covariance of 'A.x_m', ... in that frame.

    used: names of the frames that the answer rests on. residual_px (g, n, V, 2) [frame, light, camera, axis] predicted
    minus seen, NaN where a camera did not see a light; left_out_px: the same, each frame by the shape that the others
    give. scale: residuals over the spots' own standard deviations; above 1 the covariance is widened by it. rig_share:
    part of the standard deviation that comes from the rig's calibration, None where the rig has no covariance.
    n_unclear: of the rejected, moments that show too little of the target to speak for or against it.
    rotation_excitation_rms_rad (3,): root mean square turns between frames about their principal axes, falling.
    """

    names: tuple[str, ...]
    xyz_m: Array
    covariance: NamedCovariance
    n_frames: Annotated[int, Doc("Pairs of frames read.")]
    used: tuple[str, ...]
    rejected: Annotated[tuple[RejectedFrame, ...], Doc("Frames left out.")]
    residual_px: Array
    left_out_px: Array
    scale: float
    rig_share: float | None
    rotation_excitation_rms_rad: Array
    n_unclear: int = 0
    advice: Annotated[tuple[str, ...], Doc("What would make the result surer.")]

    def __post_init__(self) -> None:
        n = len(self.names)
        freeze(self, xyz_m=(n, 3))
        for name in ("residual_px", "left_out_px"):  # NaN is of a light that a camera did not see
            array = checked_array(name, np.array(getattr(self, name)), (None, n, None, 2), nan=True)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        freeze(self, rotation_excitation_rms_rad=(3,))

    @figure("Place of each light by name, in the target's frame, m.")
    def spots_m(self) -> dict[str, Vector3]:
        return {name: (x, y, z) for name, (x, y, z) in zip(self.names, self.xyz_m.tolist(), strict=True)}

    @figure("Standard deviations of these positions, m.", unit="m")
    def std(self) -> dict[str, Vector3]:
        return {name: (x, y, z) for name, (x, y, z) in zip(self.names, self.std_m.tolist(), strict=True)}

    @figure("Distances of the lights by pair of names.")
    def distances_m(self) -> dict[str, LightDistance]:
        return distances_of(self.names, self.xyz_m, self.covariance.matrix)

    @property
    def many_rejected(self) -> bool:
        """Whether more frames than by chance do not fit the target."""
        return len(self.rejected) - self.n_unclear > MANY_REJECTED * self.n_frames

    @figure("Pairs that the result rests on.")
    def n_used(self) -> int:
        return len(self.used)

    @property
    def target(self) -> Target:
        """The target, with positions and their covariance."""
        rows = tuple(f"{name}.{axis}_m" for name in self.names for axis in "xyz")
        return spot_target(self.spots_m, covariance=self.covariance.block(rows))

    @property
    def std_m(self) -> Array:
        """Standard deviations (n, 3) of the positions; zero where the frame's convention fixes a coordinate."""
        return np.sqrt(np.maximum(np.diag(self.covariance.matrix), 0.0)).reshape(-1, 3)

    @figure("Reprojection residual of the fit, RMS, px.")
    def residual_rms_px(self) -> float:
        return float(np.sqrt(np.nanmean(self.residual_px**2)))

    @figure("Reprojection residual of each frame by the shape of the others, RMS, px.")
    def loo_rms_px(self) -> float:
        return float(np.sqrt(np.nanmean(self.left_out_px**2)))

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        worst_mm = max(one.std_m for one in self.distances_m.values()) / MM
        said = (
            f"The lights' distances are known to {worst_mm:.2g} mm (one standard deviation) from {self.n_used} frames."
        )
        weak = self.n_used < GOOD_FRAMES or self.rotation_excitation_rms_rad[1] < GOOD_TURN_RAD
        doubted = self.scale > LARGE_SCALE or self.many_rejected
        if weak or doubted:
            headline = "Spots do not fit" if doubted else "Weak"
            return Verdict(level="care", headline=headline, reasons=[said], next=[f"{one}." for one in self.advice])
        todo = "Use it; calibrate again when a light was moved."
        return Verdict(level="good", headline="Good", reasons=[said], next=[todo])

    def summary(self) -> Iterator[Shown]:
        """Yield the lights, their distances, and what they rest on."""
        rows = [
            [name, *(digits(x / MM, 6) for x in xyz), " ".join(digits(s / MM, 2) for s in self.std[name])]
            for name, xyz in self.spots_m.items()
        ]
        yield Table("Lights in the target's frame", ["", "x mm", "y mm", "z mm", "+- mm"], rows)
        rows = [[name, digits(d.value_m / MM, 6), digits(d.std_m / MM, 2)] for name, d in self.distances_m.items()]
        yield Table("Distances", ["", "mm", "+-"], rows)
        residual, left_out = digits(self.residual_rms_px), digits(self.loo_rms_px)
        yield f"{self.n_used} of {self.n_frames} frames, residual {residual} px RMS, left-out frames {left_out} px"
        yield from (f"  left out: {one.frame}: {one.why}" for one in self.rejected[:REJECTED_SHOWN])
        yield from (f"- {text}" for text in self.advice)


def distances_of(names: tuple[str, ...], X: Array, covariance: Array) -> dict[str, LightDistance]:
    """Return distances of the lights X (n, 3) with covariance (3 n, 3 n), by their names."""
    out = {}
    for i, j in zip(*pairs_of(len(X)), strict=True):
        v = X[i] - X[j]
        length = float(np.linalg.norm(v))
        J = np.zeros((len(X), 3))
        J[i], J[j] = v / length, -v / length
        variance = float(J.ravel() @ covariance @ J.ravel())
        out[names[i] + names[j]] = LightDistance(value_m=length, std_m=float(np.sqrt(max(variance, 0.0))))
    return out


# What would make a target's geometry better known, in words.

RIG_RULES = 0.7
EQUAL_SIGMA = 3.0


def advise(done: TargetResult) -> TargetResult:
    """Return the calibration with its advice."""
    advice: list[str] = []
    if len(done.names) == 2:
        advice.append("two lights: only their distance is known, and a pose's turn about their line never is")
    if done.n_used < GOOD_FRAMES:
        advice.append(f"{done.n_used} frames were used: {GOOD_FRAMES} and more tell wrong ones better")
    second_rad = done.rotation_excitation_rms_rad[1]
    if second_rad < GOOD_TURN_RAD:
        advice.append(
            f"the target was tilted by {second_rad / DEG:.2g} degrees RMS about its second axis: turn it by "
            "20 to 40 degrees to several sides, so that its depth is seen across the image"
        )
    if done.rig_share is None:
        advice.append(
            "the rig's file has no covariance: an error of its baseline scales all positions, and no residual shows it"
        )
    elif done.rig_share > RIG_RULES:
        advice.append(
            "most of the standard deviation comes from the rig's calibration: more frames will not help, a "
            "better rig will"
        )
    if done.scale > LARGE_SCALE:
        advice.append(
            f"residuals are {done.scale:.2g} times the spots' own standard deviations: the calibration, blur or "
            "shiny lights"
        )
    if done.many_rejected:
        advice.append(
            f"{len(done.rejected)} of {done.n_frames} frames were left out: cover reflections, show all lights"
        )
    return replace(done, advice=(*advice, *_apex(done)))


def _apex(done: TargetResult) -> list[str]:
    """Return a word on an isosceles target whose unlike corner is not A."""
    if len(done.names) != 3:
        return []
    lengths = done.distances_m
    ab, bc, ac = (lengths[k] for k in ("AB", "BC", "AC"))
    for corner, (p, q) in {"B": (ab, bc), "C": (ac, bc)}.items():
        if abs(p.value_m - q.value_m) < EQUAL_SIGMA * np.hypot(p.std_m, q.std_m):
            return [
                f"the sides that meet at {corner} are equal ({p.value_m / MM:.2f} mm): the frame starts at A, "
                "which was leftmost; hold the target the way it will be seen if that is not wanted"
            ]
    return []
