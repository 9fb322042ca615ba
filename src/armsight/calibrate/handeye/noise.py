"""Whose noise the residuals are: the robot's or the camera's."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.handeye.solution import Solution
from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.units import DEG, MM


@output
class Part(Output):
    """One noise, as the standard deviation of one component, in m or rad, and how well that is known.

    deviation is infinite where the data cannot tell this noise from another; then size is its upper bound.
    """

    size: float
    deviation: float

    @property
    def known(self) -> bool:
        """Whether the data can tell this noise from the others."""
        return bool(np.isfinite(self.deviation))

    @figure("The noise, null where the data cannot tell it from another.")
    def value(self) -> float | None:
        return self.size if self.known else None

    @figure("Standard deviation of the noise, where known.", optional=True)
    def std(self) -> float | None:
        return self.deviation if self.known else None

    @figure("Its upper bound, where it is not known.", optional=True)
    def at_most(self) -> float | None:
        return None if self.known else self.size


@output
class Noise(Output):
    """Noise of one component of the poses of robot and camera.

    translation_m: of both together as seen at the target, without what the robot's orientation adds through the
    lever. Pose pairs cannot split it: a shift of the flange and a shift of the target look alike; with images, or
    covariances of the camera's poses, the camera's share is known.
    """

    translation_m: Annotated[Part, Doc("Of positions, robot and camera together, m, at the target.")]
    robot_m: Annotated[Part, Doc("Of the robot's positions, m.")]
    camera_m: Annotated[Part, Doc("Of the camera's positions, m.")]
    robot_rad: Annotated[Part, Doc("Of the robot's orientations, rad.")]
    camera_rad: Annotated[Part, Doc("Of the camera's orientations, rad.")]
    lever_m: float

    def explanation(self) -> str:
        """Return one sentence on whether robot or camera explains the residuals."""
        total = self.robot_rad.size**2 + self.camera_rad.size**2
        share = self.robot_rad.size**2 / total if total > 0.0 else 0.0
        uncertainty = 2.0 * np.hypot(
            self.robot_rad.size * self.robot_rad.deviation, self.camera_rad.size * self.camera_rad.deviation
        )
        size = f"{np.sqrt(total) / DEG:.2g} degrees"
        if total > 0.0 and uncertainty > 0.3 * total:
            turn = f"The data cannot yet tell whether robot or camera causes the {size} in orientation"
        elif share > 0.7:
            turn = f"The robot explains most of the {size} in orientation"
        elif share < 0.3:
            turn = f"The camera explains most of the {size} in orientation"
        else:
            turn = f"Robot and camera share the {size} in orientation"
        if not self.robot_m.known:
            return f"{turn}; the {self.translation_m.size / MM:.2g} mm in position may be either's"
        robot, corners = self.robot_m.size / MM, self.camera_m.size / MM
        rest = "the robot, or what bends an image as a whole (lens, sheet)"
        return f"{turn}; in position the noise of the image makes {corners:.2g} mm, {rest} {robot:.2g} mm"


def noise_of_pairs(solution: Solution, covariance: Array) -> Noise:
    """Return the noises of a fit to pose pairs, from the covariance (k, k) of its variances."""
    variances, lever_m = solution.variances, float(solution.lever[solution.keep].mean())
    if solution.weighed is not None:
        claimed = np.einsum("nii->i", solution.weighed.known[solution.keep]) / solution.n_used
        return noise_beside(variances[:3], covariance, lever_m, variances[3] * claimed)
    together = part(variances[0], covariance[0, 0])
    open_ = Part(size=together.size, deviation=float("inf"))
    return Noise(
        translation_m=together,
        robot_m=open_,
        camera_m=open_,
        robot_rad=part(variances[2], covariance[2, 2]),
        camera_rad=part(variances[1], covariance[1, 1]),
        lever_m=lever_m,
    )


def noise_beside(variances: Array, covariance: Array, lever_m: float, known: Array) -> Noise:
    """Return the noises where the mean variances (6,) of the camera's poses are known, from those found beside them."""
    camera_m, camera_rad = float(known[:3].mean()), float(known[3:].mean())
    return Noise(
        translation_m=part(variances[0] + camera_m, covariance[0, 0]),
        robot_m=part(variances[0], covariance[0, 0]),
        camera_m=part(camera_m, 0.0),
        robot_rad=part(variances[2], covariance[2, 2]),
        camera_rad=part(variances[1] + camera_rad, covariance[1, 1]),
        lever_m=lever_m,
    )


def part(variance: float, spread: float) -> Part:
    """Return the standard deviation of a variance; near zero its uncertainty is that of the variance itself, not of its
    slope."""
    value = float(np.sqrt(max(variance, 0.0)))
    uncertainty = float(np.sqrt(max(spread, 0.0)))
    return Part(
        size=value, deviation=float(min(uncertainty / (2.0 * value) if value > 0.0 else np.inf, np.sqrt(uncertainty)))
    )
