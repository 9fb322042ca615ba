"""What an identification comes to: its joints, arm and verdict; and a plan of sweeps with the accuracy to expect."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.identify.chain import Axis, ChainModel
from armsight.calibrate.identify.sweeps import Sweeps
from armsight.columns import DH_ROW
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.records.output import Output, Row, TitledOutput, figure, output, with_std
from armsight.records.result_parts import MEANING, RejectedRow, Verdict
from armsight.shown import Bars, Shown, Table, digits
from armsight.units import DEG, MM, displayed_name

Vector = tuple[float, float, float]
ENTRIES = tuple((name, displayed_name(name)[2]) for name in DH_ROW[:4])
"""a, alpha, d and theta, each with the unit that people read: millimetres and degrees."""
TITLES = tuple(name.rpartition("_")[0] for name in DH_ROW[:4])


@output
class JointStd(Output):
    """Standard deviations of a joint's entries in the table; null where an entry is chosen, not measured."""

    theta_rad: Annotated[float | None, Doc("Of theta, rad.")]
    d_m: Annotated[float | None, Doc("Of d, m.")]
    a_m: Annotated[float | None, Doc("Of a, m.")]
    alpha_rad: Annotated[float | None, Doc("Of alpha, rad.")]
    beta_rad: Annotated[float | None, Doc("Of beta, rad.")]

    @classmethod
    def of(cls, std: Mapping[str, float]) -> JointStd:
        """Return the standard deviations of a joint's entries; one that means nothing is None."""
        return cls(**{name: value if math.isfinite(value) else None for name, value in std.items()})


@output
class JointAxis(Output):
    """The axis of a joint with all joints at zero, in rig axes (or those of the positions)."""

    point_m: Annotated[Vector, Doc("A point of it, m.")]
    direction: Annotated[Vector, Doc("Its direction, a unit vector.")]


@output
class JointFound(Output):
    """A joint that was found (Denavit-Hartenberg, standard; beta after Hayati for parallel axes).

    axis: with all joints at zero, in rig axes. measured: as its sweep saw it, with centre or a point of the line. std:
    of the table's entries, NaN where an entry is chosen and not measured. travel: its smallest and largest reading, rad
    or m. rows: of its sweep, kept; discarded: (row, why).
    """

    index: Annotated[int, Doc("Which joint, from 1.")]
    type: Annotated[str, Doc("revolute or prismatic.")]
    a_m: Annotated[float, Doc("a, m.")]
    alpha_rad: Annotated[float, Doc("alpha, rad.")]
    d_m: Annotated[float, Doc("d, m; the zero of a prismatic joint.")]
    theta_rad: Annotated[float, Doc("theta, rad; the zero of a revolute joint.")]
    beta_rad: Annotated[float, Doc("beta, rad.")]
    sign: Annotated[float, Doc("Sense of the readings: 1 or -1, times the joint's scale where one was found.")]
    residual_rms_m: Annotated[float, Doc("Residual of the beacon's positions, RMS, m.")]
    residual_rms_px: Annotated[float | None, Doc("Residual of the beacon's pixels, RMS, px; null without a rig.")]
    p_line: Annotated[float, Doc("Probability that a straight path leaves as large residuals.")]
    decided: Annotated[bool, Doc("Whether the type is beyond doubt.")]
    radius_m: Annotated[float, Doc("Radius of the beacon's circle, m; 0 of a line.")]
    axis: Axis
    measured: Axis
    std: dict[str, float]
    travel: tuple[float, float]
    rows: NDArray[np.intp]
    discarded: tuple[tuple[int, str], ...]

    @figure("Smallest reading of its sweep, rad or m.")
    def lower(self) -> float:
        return self.travel[0]

    @figure("Largest reading of its sweep, rad or m.")
    def upper(self) -> float:
        return self.travel[1]

    @figure("Standard deviations of the entries.", key="std")
    def measured_std(self) -> JointStd:
        return JointStd.of(self.std)

    @figure("Readings of its sweep.")
    def n(self) -> int:
        return len(self.rows) + len(self.discarded)

    @figure("Readings left out.", key="discarded")
    def discarded_rows(self) -> list[RejectedRow]:
        return [RejectedRow(row=row + 1, why=why) for row, why in self.discarded]

    @figure("The joint's axis.", key="axis")
    def axis_at_zero(self) -> JointAxis:
        x, y, z = self.axis.point_m.tolist()
        u, v, w = self.axis.direction.tolist()
        return JointAxis(point_m=(x, y, z), direction=(u, v, w))


@output
class PlannedSweepOutput(Output):
    """A sweep of one joint."""

    joint: Annotated[int, Doc("Which joint moves, from 1.")]
    start: Annotated[float, Doc("Its first reading, rad or m.", key="from")]
    end: Annotated[float, Doc("Its last reading, rad or m.", key="to")]
    readings: Annotated[int, Doc("How many readings.")]
    rest: Annotated[list[float], Doc("Readings of all joints at the sweep's start, rad or m.")]
    way: Annotated[list[list[float]], Doc("Readings of all joints on the way there, rad or m.")]
    radius_m: Annotated[float, Doc("The beacon's distance from a turning joint's axis, m; 0 of a slide.")]
    ended_by: Annotated[tuple[str, str], Doc("What ends the range at both ends: limit or view.")]


@output
class PlanOutput(Output):
    """The sweeps that are planned, and the accuracy to expect of them."""

    sweeps: Annotated[list[PlannedSweepOutput], Doc("The sweeps in the order of moving.")]
    expected_std: Annotated[list[JointStd], Doc("Standard deviations to expect, by joint.")]
    noise_px: Annotated[float, Doc("Noise of a pixel coordinate that this rests on, px.")]
    notes: Annotated[list[str], Doc("What to know about the plan.")]

    def summary(self) -> Iterator[Shown]:
        """Yield the sweeps, the accuracy to expect, and what to know."""
        slides = {sweep.joint for sweep in self.sweeps if sweep.radius_m == 0.0}
        rows = []
        for sweep in self.sweeps:
            rest = ", ".join(_shown(value, k in slides) for k, value in enumerate(sweep.rest, 1) if k != sweep.joint)
            ends = [_shown(value, sweep.joint in slides) for value in (sweep.start, sweep.end)]
            rows.append([f"{sweep.joint}", *ends, f"{sweep.readings}", rest])
        yield Table("Sweeps", ["joint", "from", "to", "readings", "others rest at"], rows)
        rows = []
        for number, std in enumerate(self.expected_std, 1):
            entries = [(getattr(std, name), unit) for name, unit in ENTRIES]
            shown = ["" if value is None else f"+- {digits(value / unit, 2)}" for value, unit in entries]
            rows.append([f"{number}", *shown])
        yield Table("Accuracy to expect, mm and degrees", ["joint", *TITLES], rows)
        yield from (f"- {note}" for note in self.notes)


@output
class LeftOutJoint(Output):
    """A joint that was not swept: nothing of it is identified."""

    joint: Annotated[int, Doc("Number, from 1.")]
    held_at: Annotated[float, Doc("Where it stood during the sweeps, rad or m.")]


@output
class ProposedPlanOutput(Output):
    """armsight identify --live --propose."""

    plan: Annotated[PlanOutput, Doc("The sweeps that would be made.")]
    notes: Annotated[list[str], Doc("What to know about the plan.")]

    def write(self, path: object) -> None:
        """Write nothing: an arm that was found has a file, a plan has none."""


USELESS = 5.0
"""Misfit in standard deviations of the noise from which an arm does not explain its readings."""
USELESS_SHARE = 2e-3
"""And its share of how far the beacon moved: below, readings almost without noise would be refused for nothing."""
LEANS = 2.0
"""Deviation along the viewing direction over that across it, from which on two thirds of the variance lie along it."""
NOTHING = 1e-11
"""Eigenvalues of the scaled information below this mean that the readings say nothing of a combination."""
FELT = 1e-4
"""A position that hangs on such a combination by more than this share is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterUncertainty:
    """What the readings say of the arm's parameters: the model, their values p (P,), the information (P, P)."""

    model: ChainModel
    p: Array
    information: Array

    def positions(self, q: Array) -> tuple[Array, Array]:
        """Return the beacon (m, 3) in rig axes at joint values q (m, n) and its covariance (m, 3, 3) in m^2.

        Infinite where the position hangs on something that the readings leave open.
        """
        X, J = self.model.predict(self.p, np.asarray(q, float))
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        values, vectors = np.linalg.eigh(self.information * np.outer(scale, scale))
        known = values > NOTHING * values[-1]
        G = J @ (scale[:, None] * vectors)
        C = np.einsum("mik,k,mjk->mij", G[:, :, known], 1.0 / values[known], G[:, :, known])
        lost = np.linalg.norm(G[:, :, ~known], axis=(1, 2)) > FELT * np.linalg.norm(G, axis=(1, 2))
        C[lost] = np.diag([np.inf] * 3)
        return X, C


@output
class Identification(TitledOutput):
    """armsight identify.

    arm: what was found, for kinematics and files, in rig axes, or those of the rig's parent where its place is known.
    predicted_m: (m, 3) where the result puts the beacon at each reading, in rig axes. beacon_m: with all joints at
    zero. sweeps: the readings. rig: that which saw them, None of positions alone. uncertainty: of the beacon's position
    anywhere, where the whole arm was fitted at once. lean: the readings' deviation along the viewing direction over
    that across it; None of readings that are not from images. nominal: an arm to put beside it. from_frames: whether
    the readings are of frames, and have no file yet.
    """

    arm: Arm
    joints: Annotated[tuple[JointFound, ...], Doc("The joints, from the base on.")]
    method: Annotated[str, Doc("ml or paper.")]
    notes: Annotated[tuple[str, ...], Doc("What to know about the result.")]
    sigma: Annotated[
        float, Doc("Noise found: px with a rig, else m, or a factor on covariances given.", key="noise", unit="")
    ]
    misfit: Annotated[float, Doc("RMS of the readings' distances from the arm, in standard deviations of the noise.")]
    predicted_m: Array
    beacon_m: Array
    sweeps: Sweeps
    plan: Annotated[PlanOutput | None, Doc("The sweeps that were made; with --live.")] = None
    left_out: Annotated[
        tuple[LeftOutJoint, ...] | None,
        Doc("Joints behind those of the result, held during the sweeps; --leave-out."),
    ] = None
    rig: Rig | None = None
    uncertainty: ParameterUncertainty | None = None
    lean: float | None = None
    nominal: Arm | None = None
    from_frames: bool = False

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        open_ = " and joint ".join(str(number) for number, joint in enumerate(self.joints, 1) if not joint.decided)
        worst_m, lost = self.worst_m, sum(len(joint.discarded) for joint in self.joints)
        said = f"One reading is off the arm found by {worst_m / MM:.3g} mm RMS on the worst joint"
        if self.lean is not None:
            deep = f", {self.lean:.2g} times as much along the viewing direction as across it"
            said += f" ({self.sigma:.2g} px in the images{deep if self.lean > LEANS else ''})"
        said += "; the table is of all readings, and closer"
        said += f"; {lost} reading{'s were' if lost > 1 else ' was'} discarded." if lost else "."
        todo = "Use the arm, after `armsight verify` on poses that were not swept."
        if open_:
            said += f" Whether joint {open_} turns or slides is not sure."
            todo = f"Sweep joint {open_} over a longer way, and identify again."
        if self.useless:
            todo = "Do not use this arm: it misses its own readings by far. See what to know below, and sweep again."
        level, headline = ("care", "A type is not decided") if open_ else ("good", "Types decided")
        return Verdict(level=level, headline=headline, reasons=[said], next=[todo])

    @property
    def worst_m(self) -> float:
        """What the readings of the worst joint are off the arm, RMS."""
        return max(joint.residual_rms_m for joint in self.joints)

    @property
    def useless(self) -> bool:
        """Whether the arm misses its own readings by far."""
        reach_m = float(np.linalg.norm(np.ptp(self.predicted_m, axis=0)))
        return self.misfit > USELESS and self.worst_m > USELESS_SHARE * reach_m

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Arm of {self.arm.n} joints, identified"

    def rows(self) -> list[Row]:
        """Return each joint's type and table, with standard deviations where they mean something."""
        rows = []
        for joint in self.joints:
            parts = [
                f"{stem} {with_std(getattr(joint, name), joint.std.get(name), unit, scale=1.0 / size)}"
                for name in DH_ROW[:4]
                for stem, unit, size in (displayed_name(name),)
            ]
            rows.append((f"joint {joint.index}", f"{joint.type}{'' if joint.decided else '?'}: {', '.join(parts)}"))
        return rows + [("note", note) for note in self.notes]

    def summary(self) -> Iterator[Shown]:
        """Yield the table with its standard deviations, and what to know."""
        rows = []
        for joint in self.joints:
            cells = [f"{joint.index}", joint.type]
            for name, unit in ENTRIES:
                shown, std = digits(getattr(joint, name) / unit, 5), joint.std[name]
                cells.append(f"{shown} +- {digits(std / unit, 2)}" if math.isfinite(std) else shown)
            rows.append([*cells, digits(joint.residual_rms_m / MM)])
        yield Table("Arm, mm and degrees", ["joint", "type", *TITLES, "residual"], rows)
        if any(math.isfinite(std) for joint in self.joints for std in joint.std.values()):
            yield "Entries without a standard deviation are chosen, not measured."
        yield from (f"- {note}" for note in self.notes)

    def bars(self) -> Bars:
        """Return the residual of each joint's readings, mm."""
        values = [joint.residual_rms_m / MM for joint in self.joints]
        return Bars(self.title, [str(joint.index) for joint in self.joints], values, "joint", "residual, mm RMS")


def _shown(value: float, slides: bool) -> str:
    return f"{value / MM:.1f} mm" if slides else f"{value / DEG:.1f} deg"
