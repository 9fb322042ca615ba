"""What the calibration of a lit target returns, and what would make its geometry better known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.light_target.naming import pairs_of
from armsight.records import NamedCovariance, Target, frozen_array, spot_target
from armsight.units import DEG, MM

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Distance:
    """Distance of two lights in m with its standard deviation."""

    value_m: float
    std_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetCalibration:
    """names (n,) and xyz_m (n, 3) of the lights in the target's frame; covariance of 'A.x_m', ... in that frame.

    used: names of the frames that the answer rests on. rejected: (frame, why). residual_px (g, n, 2, 2) [frame, light,
    side, axis] predicted minus seen; left_out_px: the same, each frame by the shape that the others give. scale:
    residuals over the spots' own standard deviations; above 1 the covariance is widened by it. rig_share: part of the
    standard deviation that comes from the rig's calibration, None where the rig has no covariance. turn_rms_rad (3,):
    root mean square turns between frames about their principal axes, falling.
    """

    names: tuple[str, ...]
    xyz_m: Array
    covariance: NamedCovariance
    n_frames: int
    used: tuple[str, ...]
    rejected: tuple[tuple[str, str], ...]
    residual_px: Array
    left_out_px: Array
    scale: float
    rig_share: float | None
    turn_rms_rad: Array
    advice: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (len(self.names), 3)))
        for name in ("residual_px", "left_out_px"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (None, len(self.names), 2, 2)))
        object.__setattr__(self, "turn_rms_rad", frozen_array("turn_rms_rad", self.turn_rms_rad, (3,)))

    @property
    def n_used(self) -> int:
        """Frames that the answer rests on."""
        return len(self.used)

    @property
    def target(self) -> Target:
        """The target, with positions and their covariance."""
        positions = {n: (x[0], x[1], x[2]) for n, x in zip(self.names, self.xyz_m.tolist(), strict=True)}
        rows = tuple(f"{name}.{axis}_m" for name in self.names for axis in "xyz")
        return spot_target(positions, covariance=self.covariance.block(rows))

    @property
    def std_m(self) -> Array:
        """Standard deviations (n, 3) of the positions; zero where the frame's convention fixes a coordinate."""
        return np.sqrt(np.maximum(np.diag(self.covariance.matrix), 0.0)).reshape(-1, 3)

    @property
    def residual_rms_px(self) -> float:
        """Root mean square of the residuals' coordinates."""
        return float(np.sqrt(np.mean(self.residual_px**2)))

    @property
    def loo_rms_px(self) -> float:
        """The same of the frames by the shape of the other frames, the pose fitted."""
        return float(np.sqrt(np.mean(self.left_out_px**2)))

    def distances(self) -> dict[str, Distance]:
        """Return the distance of every two lights, by both names."""
        return distances_of(self.names, self.xyz_m, self.covariance.matrix)


def distances_of(names: tuple[str, ...], X: Array, covariance: Array) -> dict[str, Distance]:
    """Return distances of the lights X (n, 3) with covariance (3 n, 3 n), by their names."""
    out = {}
    for i, j in zip(*pairs_of(len(X)), strict=True):
        v = X[i] - X[j]
        length = float(np.linalg.norm(v))
        J = np.zeros((len(X), 3))
        J[i], J[j] = v / length, -v / length
        variance = float(J.ravel() @ covariance @ J.ravel())
        out[names[i] + names[j]] = Distance(value_m=length, std_m=float(np.sqrt(max(variance, 0.0))))
    return out


# What would make a target's geometry better known, in words.

GOOD_FRAMES = 10
GOOD_TURN_RAD = 10.0 * DEG
"""Root mean square tilt below which a depth difference of the lights is hardly seen from the side."""

LARGE_SCALE = 2.0
RIG_RULES = 0.7
MANY_REJECTED = 0.2
EQUAL_SIGMA = 3.0


def advise(done: TargetCalibration) -> TargetCalibration:
    """Return the calibration with its advice."""
    advice: list[str] = []
    if len(done.names) == 2:
        advice.append("two lights: only their distance is known, and a pose's turn about their line never is")
    if done.n_used < GOOD_FRAMES:
        advice.append(f"{done.n_used} frames were used: {GOOD_FRAMES} and more tell wrong ones better")
    if done.turn_rms_rad[1] < GOOD_TURN_RAD:
        advice.append(
            f"the target was tilted by {done.turn_rms_rad[1] / DEG:.2g} degrees RMS about its second axis: turn it by "
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
    if len(done.rejected) > MANY_REJECTED * done.n_frames:
        advice.append(
            f"{len(done.rejected)} of {done.n_frames} frames were left out: cover reflections, show all lights"
        )
    return replace(done, advice=(*advice, *_apex(done)))


def _apex(done: TargetCalibration) -> list[str]:
    """Return a word on an isosceles target whose unlike corner is not A."""
    if len(done.names) != 3:
        return []
    lengths = done.distances()
    ab, bc, ac = (lengths[k] for k in ("AB", "BC", "AC"))
    for corner, (p, q) in {"B": (ab, bc), "C": (ac, bc)}.items():
        if abs(p.value_m - q.value_m) < EQUAL_SIGMA * np.hypot(p.std_m, q.std_m):
            return [
                f"the sides that meet at {corner} are equal ({p.value_m / MM:.2f} mm): the frame starts at A, "
                "which was leftmost; hold the target the way it will be seen if that is not wanted"
            ]
    return []
