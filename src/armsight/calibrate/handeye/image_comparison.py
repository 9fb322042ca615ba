"""Which of the calibrations from the same images is kept: of poses, of corners, or of corners with the camera freed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ttest_rel

from armsight.units import DEG, MM

Array = NDArray[np.float64]

FEWEST_JUDGED = 4
"""Images left out below which the spread of what changes between two calibrations says nothing."""
FEW_IMAGES = 12
"""Up to so many images a fit to the corners must be proved better, beyond that it must not be worse: the more images,
the surer it gains by what it knows of the corners."""
LEAST_FALL = 0.05
CHANCE = 0.05
"""Of few images, or where the camera is freed, errors left out must fall by this share, and beyond this chance (paired
t-test over the images, one-sided), at the board's points in m and in the image in px. Where poses and corners know the
same, chance makes smaller falls. Of 233 simulated sets of 5 to 12 images 34 were worse against truth than from poses
with plain "smaller", 6 (of 66 taken) at a chance of 0.1, 2 (of 29) at this one; other sets in
benchmarks/handeye_images.py."""


class Basis(StrEnum):
    """What a hand-eye calibration from images rests on: the target's poses in the images, or their corners."""

    POSES = "poses"
    CORNERS = "corners"
    CORNERS_AND_CAMERA = "corners and camera"

    @property
    def told(self) -> str:
        """The name in a sentence."""
        return "corners with the camera freed" if self is Basis.CORNERS_AND_CAMERA else str(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageErrors:
    """Errors of k images, each predicted by a calibration that never saw it. NaN where it gave no prediction.

    residuals (k, 6): T_camera_target seen against predicted, camera axes, m and rad. points_m (k,): of the board's
    points in space, root mean square of each image. reprojection_px (k,): of its corners, likewise.
    """

    residuals: Array
    points_m: Array
    reprojection_px: Array

    @classmethod
    def of(cls, rows: Array) -> ImageErrors:
        """Return the errors of rows (k, 8): residuals, points_m, reprojection_px."""
        return cls(residuals=rows[:, :6], points_m=rows[:, 6], reprojection_px=rows[:, 7])

    @property
    def judged(self) -> NDArray[np.bool_]:
        """Which images (k,) have a prediction."""
        return np.isfinite(self.points_m) & np.isfinite(self.reprojection_px)

    def rms(self, which: NDArray[np.bool_]) -> LeftOutErrors:
        """Return the figures over some of the images; infinite where one of them has no prediction."""
        size_m, angle_rad = (np.linalg.norm(self.residuals[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        values = (size_m, angle_rad, self.points_m, self.reprojection_px)
        position, angle, points, px = (_rms(x[which]) for x in values)
        return LeftOutErrors(position_m=position, angle_rad=angle, points_m=points, reprojection_px=px)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutErrors:
    """Root mean squares over images left out.

    T_camera_target's position in m and angle in rad, the board's points in m, its corners in px.
    """

    position_m: float
    angle_rad: float
    points_m: float
    reprojection_px: float

    def text(self) -> str:
        """Return the figures in words."""
        if not np.isfinite(self.points_m):
            return "no prediction"
        return f"{self.points_m / MM:.3g} mm, {self.angle_rad / DEG:.2g} degrees and {self.reprojection_px:.3g} px"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageComparison:
    """What was kept, and the errors of all candidates at the same images left out.

    judged (k,): which of the used images a calibration from the poses of others predicts. errors: over these. residuals
    (k, 6): what was kept, as ImageErrors has them.
    """

    kept: Basis
    judged: NDArray[np.bool_]
    errors: Mapping[Basis, LeftOutErrors]
    residuals: Array

    @property
    def n_judged(self) -> int:
        """Images that the candidates are compared by."""
        return int(self.judged.sum())

    @property
    def few(self) -> bool:
        """Whether the images are few: a fit to the corners must be proved better then."""
        return self.n_judged <= FEW_IMAGES

    def sentence(self) -> str:
        """Return what was kept and why, in words."""
        if self.n_judged < FEWEST_JUDGED:
            return (
                "The result from the poses is kept: a fit to the corners is judged by images left out, and here other "
                f"images predict {self.n_judged}, of which {FEWEST_JUDGED} are the fewest."
            )
        told = "; ".join(f"{basis.told}: {errors.text()}" for basis, errors in self.errors.items())
        freed = Basis.CORNERS_AND_CAMERA in self.errors
        why = {
            Basis.POSES: f"by cross-validation a fit to the corners is not {'proved ' * self.few}better",
            Basis.CORNERS: "by cross-validation it is better than that from the poses",
            Basis.CORNERS_AND_CAMERA: "by cross-validation it is better than with the camera as given",
        }[self.kept]
        if freed and self.kept is not Basis.CORNERS_AND_CAMERA:
            why += ", and a freed camera is not proved better: the camera stays as given"
        missed = f"{self.n_judged} images left out miss by, RMS, {told}"
        return f"The result from the {self.kept.told} is kept: {why} ({missed})."


def compare(errors: Mapping[Basis, ImageErrors]) -> ImageComparison:
    """Return which calibration to keep, by errors at the same images left out; poses unless another is better.

    With few images, and for a freed camera, better must be proved. errors: Basis.POSES first, then from poor to rich;
    each richer one must beat what was kept before it. An image that the poses of others do not predict is not judged; a
    candidate that fails at one that they predict is not taken.
    """
    which = errors[Basis.POSES].judged
    kept = Basis.POSES
    for basis, richer in errors.items():
        proof = basis is Basis.CORNERS_AND_CAMERA or which.sum() <= FEW_IMAGES
        if basis is not Basis.POSES and is_better(errors[kept], richer, which, proof=proof):
            kept = basis
    found = {basis: each.rms(which) for basis, each in errors.items()} if which.any() else {}
    return ImageComparison(kept=kept, judged=which, errors=found, residuals=errors[kept].residuals)


def is_better(before: ImageErrors, after: ImageErrors, which: NDArray[np.bool_], *, proof: bool = True) -> bool:
    """Whether errors at the images left out (k,) fall, in m and in px; proof: by LEAST_FALL and beyond CHANCE."""
    if which.sum() < FEWEST_JUDGED or not after.judged[which].all():
        return False
    for old, new in ((before.points_m, after.points_m), (before.reprojection_px, after.reprojection_px)):
        if _rms(new[which]) >= (1.0 - LEAST_FALL * proof) * _rms(old[which]):
            return False
        if proof and not ttest_rel(old[which], new[which], alternative="greater").pvalue < CHANCE:
            return False
    return True


def _rms(values: Array) -> float:
    """Return the root mean square; infinite where a value is missing."""
    size = float(np.sqrt(np.mean(values**2)))
    return size if np.isfinite(size) else float("inf")
