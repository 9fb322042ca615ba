"""What the calibrations of cameras and mirror rigs come to, and the noise of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from armsight.calibrate.camera_noise.photon_transfer import NoiseCalibration
from armsight.calibrate.cameras import StereoCalibration
from armsight.calibrate.cameras.verdict import GOOD_RMS_PX
from armsight.calibrate.mirrors.adjustment import MirrorTurn
from armsight.calibrate.mirrors.diagnosis import GOOD_LIT, VAGUE, Suspect
from armsight.fields import Doc
from armsight.optics.mirrors import FormError
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import NoiseModel
from armsight.records.output import Output, extended, figure, output
from armsight.shown import WRITTEN, Shown
from armsight.units import MM


@output
class NoiseOutput(Output):
    """armsight calibrate camera --noise, without a board."""

    noise: Annotated[
        NoiseCalibration | NoiseModel,
        Doc("The camera's noise; the keys from n_given on of still frames, not of a file."),
    ]

    def summary(self) -> Iterator[Shown]:
        """Yield the noise."""
        yield from self.noise.summary()
        yield WRITTEN


@output
class PlateOutput(Output):
    """The glass plate of a mirror rig (Pachidis), whose shift moves the left view."""

    m_m: Annotated[float, Doc("Shift m of the left view's chief ray, m.")]
    l_m: Annotated[float, Doc("The l that goes with it, m.")]
    thickness_m: Annotated[float, Doc("Thickness, m; 0 without a plate.")]
    index: Annotated[float | None, Doc("Refractive index, null without a plate.")]
    seen_thickness_m: Annotated[float | None, Doc("Thickness as the views show it, m; null where it was given.")]
    seen_thickness_std_m: Annotated[float | None, Doc("Standard deviation of the thickness seen, m.")]


@output
class MirrorAlignment(Parallelism):
    """How parallel the two views of a mirror rig stand, and its plate."""

    plate: Annotated[PlateOutput, Doc("The glass plate.")]


@output
class MirrorsOutput(StereoCalibration):
    """armsight calibrate mirrors: as of a pair, in axes of the left view. lit: from the lit target, not a board."""

    plate: PlateOutput
    one_lens: Annotated[bool, Doc("Whether one lens explains both views.")]
    forms: Annotated[list[FormError], Doc("How far the paper's equations are off; empty without a plate.")]
    lit: bool = False

    @property
    def thing(self) -> str:
        """What the images show."""
        return "lit target" if self.lit else "board"

    def doubted(self) -> list[str]:
        """Return what speaks against relying on the rig, its mirrors included."""
        out = StereoCalibration.doubted(self)  # slots make another class of it than super() knows
        if self.lit and self.rms_px > GOOD_RMS_PX:  # lights leave nothing out of the fit
            out.append(f"the lights are met to {self.rms_px:.3g} px, beyond {GOOD_RMS_PX} px")
        if self.lit and self.n_used < GOOD_LIT:
            out.append(f"{self.n_used} images are few, {GOOD_LIT} and more tell wrong ones")
        if not self.one_lens:
            out.append("one lens does not explain both views")
        if self.baseline_std_m > VAGUE * self.baseline_m:
            out.append(f"the baseline is known to {self.baseline_std_m / MM:.2g} mm only")
        return out

    @figure("How parallel the two views stand, and the plate.")
    def alignment(self) -> MirrorAlignment:
        return extended(parallelism(self.rig), MirrorAlignment, plate=self.plate)


@output
class CheckedAlignment(Output):
    """How parallel the two views stand now, the right one against the left one."""

    convergence_rad: Annotated[float, Doc("How far the optical axes turn towards each other, rad.")]
    vertical_px: Annotated[float, Doc("Row at infinity, right minus left, px.")]
    vertical_rad: Annotated[float, Doc("How far the right axis points below the left one, rad.")]
    roll_rad: Annotated[float, Doc("Turn of the right image about its axis, rad.")]
    std: Annotated[dict[str, float] | None, Doc("Standard deviations of the alignment by name.")]


@output
class PoseChange(Output):
    """A change of T_left_right, in axes of the left view."""

    dx_m: Annotated[float, Doc("Along x, m.")]
    dy_m: Annotated[float, Doc("Along y, m.")]
    dz_m: Annotated[float, Doc("Along z, m.")]
    drx_rad: Annotated[float, Doc("Rotation vector, x, rad.")]
    dry_rad: Annotated[float, Doc("Rotation vector, y, rad.")]
    drz_rad: Annotated[float, Doc("Rotation vector, z, rad.")]


@output
class MirrorCheckOutput(Output):
    """armsight calibrate mirrors --check."""

    alignment: Annotated[CheckedAlignment, Doc("How parallel the two views stand now.")]
    change: Annotated[PoseChange, Doc("What has changed since the calibration.")]
    change_std: Annotated[PoseChange, Doc("Standard deviations of the change.")]
    moved: Annotated[bool, Doc("Whether anything has moved beyond the views' noise.")]
    certain: Annotated[bool, Doc("Whether one mirror alone explains the change.")]
    suspects: Annotated[list[Suspect], Doc("Mirrors that may have moved, the likeliest first.")]
    turns: Annotated[
        list[MirrorTurn] | None, Doc("Against the design: turns of mirrors 2 and 4 that make the axes parallel.")
    ] = None
    advice: Annotated[list[str], Doc("Which mirror to turn, and how.")]
    n_views: Annotated[int, Doc("Images that the answer rests on.")]
    missed: Annotated[list[str], Doc("Images without the board in both views, and why.")]
