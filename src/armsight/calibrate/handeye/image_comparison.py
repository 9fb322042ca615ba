"""Which of the calibrations from the same images is kept: of poses, of corners, or of corners with the camera freed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.units import DEG, MM

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


class ObservationModel(StrEnum):
    """What a hand-eye calibration from images rests on: the target's poses in the images, or their corners."""

    POSES = "poses"
    CORNERS = "corners"
    CORNERS_AND_CAMERA = "corners and camera"

    @property
    def phrase(self) -> str:
        """The name in a sentence."""
        return "corners with the camera freed" if self is ObservationModel.CORNERS_AND_CAMERA else str(self)


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
        """Return the figures over some of the images; None where one of them has no prediction."""
        size_m, angle_rad = (np.linalg.norm(self.residuals[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        values = (size_m, angle_rad, self.points_m, self.reprojection_px)
        position, angle, points, px = (rms if np.isfinite(rms := _rms(x[which])) else None for x in values)
        return LeftOutErrors(position_m=position, orientation_rad=angle, points_m=points, reprojection_px=px)


@output
class LeftOutErrors(Output):
    """Errors of one calibration at images left out, RMS."""

    position_m: Annotated[float | None, Doc("Of T_camera_target's position, m; null where not all were predicted.")]
    orientation_rad: Annotated[float | None, Doc("Of T_camera_target's orientation, rad.")]
    points_m: Annotated[float | None, Doc("Of the board's points in space, m.")]
    reprojection_px: Annotated[float | None, Doc("Of the corners in the image, px.")]

    def text(self) -> str:
        """Return the figures in words."""
        if self.points_m is None or self.orientation_rad is None:
            return "no prediction"
        return (
            f"{self.points_m / MM:.3g} mm, {self.orientation_rad / DEG:.2g} degrees and {self.reprojection_px:.3g} px"
        )


@output
class ImageComparison(Output):
    """Calibrations from the same images, each judged by images it never saw (nested folds).

    judged (k,): which of the used images a calibration from the poses of others predicts. errors: over these. residuals
    (k, 6): what was kept, as ImageErrors has them.
    """

    kept: Annotated[ObservationModel, Doc("What the result is from: poses, corners, or corners and camera (freed).")]
    judged: NDArray[np.bool_]
    errors: Mapping[ObservationModel, LeftOutErrors]
    residuals: Array

    @figure("Images left out that they are judged by.", key="n_images")
    def n_judged(self) -> int:
        return int(self.judged.sum())

    @figure("From the target's poses; null where no image can be judged.")
    def poses(self) -> LeftOutErrors | None:
        return self.errors.get(ObservationModel.POSES)

    @figure("From the corners (bundle adjustment).")
    def corners(self) -> LeftOutErrors | None:
        return self.errors.get(ObservationModel.CORNERS)

    @figure("From the corners, the camera freed; with --free-camera.", optional=True)
    def corners_and_camera(self) -> LeftOutErrors | None:
        return self.errors.get(ObservationModel.CORNERS_AND_CAMERA)

    @figure("Why it was kept, in words.")
    def why(self) -> str:
        if self.n_judged < FEWEST_JUDGED:
            return (
                "The result from the poses is kept: a fit to the corners is judged by images left out, and here other "
                f"images predict {self.n_judged}, of which {FEWEST_JUDGED} are the fewest."
            )
        errors_text = "; ".join(f"{basis.phrase}: {errors.text()}" for basis, errors in self.errors.items())
        freed = ObservationModel.CORNERS_AND_CAMERA in self.errors
        proved = "proved " if self.n_judged <= FEW_IMAGES else ""
        why = {
            ObservationModel.POSES: f"by cross-validation a fit to the corners is not {proved}better",
            ObservationModel.CORNERS: "by cross-validation it is better than that from the poses",
            ObservationModel.CORNERS_AND_CAMERA: "by cross-validation it is better than with the camera as given",
        }[self.kept]
        if freed and self.kept is not ObservationModel.CORNERS_AND_CAMERA:
            why += ", and a freed camera is not proved better: the camera stays as given"
        missed = f"{self.n_judged} images left out miss by, RMS, {errors_text}"
        return f"The result from the {self.kept.phrase} is kept: {why} ({missed})."


def compare(errors: Mapping[ObservationModel, ImageErrors]) -> ImageComparison:
    """Return which calibration to keep, by errors at the same images left out; poses unless another is better.

    With few images, and for a freed camera, better must be proved. errors: ObservationModel.POSES first, then from poor
    to rich; each richer one must beat what was kept before it. An image that the poses of others do not predict is not
    judged; a candidate that fails at one that they predict is not taken.
    """
    which = errors[ObservationModel.POSES].judged
    kept = ObservationModel.POSES
    for basis, richer in errors.items():
        proof = basis is ObservationModel.CORNERS_AND_CAMERA or which.sum() <= FEW_IMAGES
        if basis is not ObservationModel.POSES and is_better(errors[kept], richer, which, proof=proof):
            kept = basis
    found = {basis: each.rms(which) for basis, each in errors.items()} if which.any() else {}
    return ImageComparison(kept=kept, judged=which, errors=found, residuals=errors[kept].residuals)


def is_better(before: ImageErrors, after: ImageErrors, which: NDArray[np.bool_], *, proof: bool = True) -> bool:
    """Whether errors at the images left out (k,) fall, in m and in px; proof: by LEAST_FALL and beyond CHANCE."""
    from scipy.stats import ttest_rel  # imported here: it takes longer than most commands need to begin

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
