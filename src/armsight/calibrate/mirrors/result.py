"""What calibrations and checks of mirror rigs return."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from armsight.calibrate.cameras import StereoCalibration
from armsight.calibrate.cameras.preconditions import GOOD_RMS_PX
from armsight.calibrate.mirrors.calibration import MirrorCalibration
from armsight.calibrate.mirrors.diagnosis import GOOD_LIT, VAGUE, Adjustment, Alignment, MirrorTurn, Suspect
from armsight.fields import Doc
from armsight.optics import Rig
from armsight.optics.mirrors import FormError, Mirrors, form_errors
from armsight.optics.parallelism import Parallelism, parallelism
from armsight.records import NotSeen
from armsight.records.output import Output, extended, figure, keys, output
from armsight.records.result_parts import RejectedFile
from armsight.shown import REJECTED_SHOWN, WRITTEN, Shown, Table, digits
from armsight.units import MM

MRAD = 1e-3
DEPTHS_M = (0.4, 0.5, 0.6, 0.7, 0.8)


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
    """armsight calibrate mirrors: as of a pair, in axes of the left view.

    rig: that of the one camera and its mirrors; fitted: two virtual cameras. lit: from the lit target, not a board.
    """

    plate: PlateOutput
    one_lens: Annotated[bool, Doc("Whether one lens explains both views.")]
    forms: Annotated[list[FormError], Doc("How far the paper's equations are off; empty without a plate.")]
    fitted: Rig
    lit: bool = False

    def pair_rig(self) -> Rig:
        """Return the two virtual cameras as the fit has them."""
        return self.fitted

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
        return extended(parallelism(self.fitted), MirrorAlignment, plate=self.plate)

    def plate_words(self) -> list[tuple[str, str]]:
        """Return the plate and how far the paper's equations are off, as the report has them."""
        plate = self.plate
        if plate.seen_thickness_m is not None and plate.seen_thickness_std_m is not None:
            seen = f"{plate.seen_thickness_m / MM:.2f} +- {plate.seen_thickness_std_m / MM:.2f} mm"
            lines = [("glass plate, as the views show it", seen)]
        else:
            given = "none" if plate.index is None else f"{plate.thickness_m / MM:g} mm"
            lines = [("glass plate, as given", given)]
        lines.append(("its shift of the left view, m and l", f"{plate.m_m / MM:.4f} mm"))
        return lines + [
            (f"triangulation off by, {one.name}", f"{one.z_m / MM:.3g} mm in depth, {one.epipolar_px:.2g} px across")
            for one in self.forms
        ]

    def summary(self) -> Iterator[Shown]:
        """Yield the rig, how its views stand to each other, its plate, and what would make it surer."""
        yield from self._shown_lights() if self.lit else self.shown_fit()
        plate = self.alignment.plate
        rows = [["plate, mm", digits(plate.thickness_m / MM)], ["its shift m = l, mm", digits(plate.m_m / MM)]]
        yield Table("Alignment", ["", ""], [*_alignment_rows(self.alignment), *rows])
        yield from (f"- {text}" for text in self.advice)
        yield f"{WRITTEN}; open {{report}}"

    def _shown_lights(self) -> Iterator[Shown]:
        rows = [
            ["baseline, mm", digits(self.baseline_m / MM, 6)],
            ["baseline +-, mm", digits(self.baseline_std_m / MM, 2)],
            ["reprojection, px RMS", digits(self.rms_px)],
            ["epipolar, px RMS", digits(self.epipolar_rms_px)],
        ]
        yield Table(f"Rig, {self.n_used} of {self.n_pairs} images", ["", ""], rows)
        for seen, count in reasons([NotSeen(one.why) for one in self.rejected])[:REJECTED_SHOWN]:
            yield f"  {count} left out: {seen.why}"


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

    def summary(self) -> Iterator[Shown]:
        """Yield how the virtual cameras stand to each other now, and which mirror to turn."""
        yield Table("Alignment", ["", ""], _alignment_rows(self.alignment))
        header = ["", "about the vertical, mrad", "across, mrad"]
        rows = [
            [f"mirror {one.mirror}", *(digits(x / MRAD) for x in (one.turn_rad, one.tilt_rad))]
            for one in self.turns or ()
        ]
        if rows:
            yield Table("Turns that make the axes parallel", header, rows)
        rows = [
            [f"mirror {one.mirror}", *(digits(x / MRAD) for x in (one.turn_rad, one.tilt_rad)), digits(one.chi2)]
            for one in self.suspects
        ]
        if rows:
            yield Table("Which mirror has moved", [*header, "chi-square left"], rows)
        yield from (f"- {text}" for text in self.advice)


def _alignment_rows(found: MirrorAlignment | CheckedAlignment) -> list[list[str]]:
    return [
        ["axes turn towards each other, mrad", digits(found.convergence_rad / MRAD)],
        ["right image lower, px", digits(found.vertical_px)],
        ["right image turned, mrad", digits(found.roll_rad / MRAD)],
    ]


def mirrors_output(done: MirrorCalibration, missed: Sequence[RejectedFile], *, lit: bool = False) -> MirrorsOutput:
    """Return a mirror rig's calibration; missed: what was not seen in both views; lit: of lights."""
    pair, plate = done.pair, done.rig.left.plate
    return extended(
        pair,
        MirrorsOutput,
        rig=done.rig,
        fitted=pair.rig,
        n_pairs=pair.n_pairs + len(missed),
        rejected=(*missed, *pair.rejected),
        metric=pair.metric or dict.fromkeys(("expected_m", "mean_m", "rms_m")),
        plate=PlateOutput(
            m_m=done.shift_m,
            l_m=done.shift_m,
            thickness_m=0.0 if plate is None else plate.thickness_m,
            index=None if plate is None else plate.index,
            seen_thickness_m=done.seen_m,
            seen_thickness_std_m=done.seen_std_m,
        ),
        one_lens=done.one_lens,
        forms=list(_forms(done)),
        lit=lit,
    )


def _forms(done: MirrorCalibration) -> tuple[FormError, ...]:
    """Return how far the paper's equations would be off with this rig, from 400 to 800 mm."""
    plate = done.rig.left.plate
    if plate is None:
        return ()
    side = np.linspace(-0.12, 0.12, 9)
    grid = np.stack(np.meshgrid(side, 0.75 * side, DEPTHS_M, indexing="ij"), axis=-1).reshape(-1, 3)
    lens = replace(done.rig.left, plate=None)
    return form_errors(lens, Mirrors(baseline_m=done.rig.baseline_m, plate=plate), grid)


def check_output(found: Alignment | Adjustment, missed: Sequence[str]) -> MirrorCheckOutput:
    """Return a check of the alignment as --json gives it."""
    names = [key.attribute for key in keys(PoseChange)]
    if isinstance(found, Adjustment):
        change, std = (np.concatenate([np.zeros(3), part]) for part in (found.rotation_rad, found.std_rad))
        moved, certain, suspects = not found.parallel, False, []
        turns = list(found.turns)
    else:
        change, std, moved, certain, turns = found.change, found.std, found.moved, found.certain, None
        suspects = list(found.suspects)
    return MirrorCheckOutput(
        alignment=CheckedAlignment(
            **{name: getattr(found.now, name) for name in (key.attribute for key in keys(CheckedAlignment))}
        ),
        change=PoseChange(**dict(zip(names, change.tolist(), strict=True))),
        change_std=PoseChange(**dict(zip(names, std.tolist(), strict=True))),
        moved=moved,
        certain=certain,
        suspects=suspects,
        turns=turns,
        advice=[found.advice()],
        n_views=found.n_views,
        missed=list(missed),
    )


def reasons(missed: Sequence[NotSeen]) -> list[tuple[NotSeen, int]]:
    """Return the reasons, the commonest first, with their counts; those that differ in numbers only are one."""
    kinds = [re.sub(r"\d+(\.\d+)?", "#", seen.why) for seen in missed]
    first = dict(reversed(list(zip(kinds, missed, strict=True))))
    return [(first[kind], count) for kind, count in Counter(kinds).most_common()]
