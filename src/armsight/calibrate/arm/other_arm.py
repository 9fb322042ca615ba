"""Whether the nominal arm is another one: measurements that want lengths no maker's tolerance allows.

The models that a calibration compares believe in the nominal arm to its tolerance. Where a length is off by ten times
that, errors begin so large that it is not even offered, and turns and scales take its place: a gain, and a wrong arm.
So the whole geometry is fitted once more with hardly any belief in the nominal arm, and what it comes to is held
against the tolerance.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm.fit import ArmFit, Tolerance, fit_arm, start
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.model_selection import Level, left_out, plain_level, significant_gain
from armsight.calibrate.arm.points import ArmPoints
from armsight.errors import ArmsightError, NotConverged
from armsight.fields import Doc
from armsight.kinematics import PRESETS, Arm, in_convention, preset
from armsight.records.output import Output, output
from armsight.units import DEG, MM

OPEN = Tolerance(length_m=0.03, angle_rad=0.05, scale=0.01)
"""Belief in the nominal arm here: 20 rows overrule it by 190 mm; with none at all directions would be left open."""
BEYOND = 3.0
"""A correction of so many standard deviations of what the nominal arm is believed to is of another arm."""
MOST_SCALE = 0.005
"""A joint that turns so much more, or less, than it says has other gears: a ratio of teeth has no tolerance, and what
bends and runs out of true stays below 0.1 %."""
SURE = 2.0
"""Standard deviations that a correction may be wrong by."""
QUIET = 0.25
"""Errors of the nominal arm below this share of the largest length allowed come of no wrong length: it shows in the
position of the tool by a half of itself and more."""
SETTLED = 0.1
"""A model that predicts rows left out to this share of the largest length allowed has not put turns and scales in the
place of a length: those leave millimetres. Nothing more is asked then."""
ROUNDS = 3
"""Fits from the fit before: each begins with its noise, which falls from the wrong arm's to the measurement's."""
ENOUGH_ROWS = 400
"""Rows that the question is asked with."""
TOLD = 4
"""Parameters named; what follows from the first is of no use to a reader."""
FITS = 0.5
"""An arm known by name is the one measured where its errors are below this share of the nominal arm's."""
FITS_DOUBTED = 0.75
"""The same where a length is beyond what one may be off by, but not beyond what the lengths that add up in it may."""
KNOWN_FITS = 0.05
"""... and below this share of how far the tool moved: the least bad of arms that all miss is not the one measured."""
SHORT_LIST = 3
"""Arms known by name that are looked at closely."""
AS_GOOD = 1.2
"""A fit predicts as well as another where rows left out miss by no more than so many times as far."""
EXPLAINS = 0.1
"""What is found explains measurements that are not of the nominal arm where it takes their error below this share."""
HOME_MADE_M = 0.02
"""Further off than this no arm is built, not even at home."""
LEAST_DIFFERENCE_M = 1e-3
"""Lengths of two arms that differ by less are not told."""


@output
class Misfit(Output):
    """A figure of the nominal arm that the measurements contradict.

    excess: correction over what is allowed for one length. beside: parameters that the measurements cannot tell from
    it, and whose errors add up in it.
    """

    name: Annotated[str, Doc("Its name: a joint's a_m, d_m, alpha_rad, beta_rad or scale.")]
    nominal: Annotated[float, Doc("As the nominal arm has it, unit in the name.")]
    wanted: Annotated[float, Doc("As the measurements want it.")]
    std: Annotated[float, Doc("Standard deviation of what they want.")]
    excess: float
    beside: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        """Whether it is too much even for all that add up in it, each within tolerance."""
        return bool(self.excess > np.sqrt(1.0 + len(self.beside)))

    def text(self) -> str:
        """Return the sentence's part: what it would have to be."""
        other = f" (or {', '.join(self.beside)}, on parallel axes)" if self.beside else ""
        by = self.wanted - self.nominal
        if self.name.endswith("_m"):
            longer = abs(self.wanted) - abs(self.nominal)
            word = "longer" if longer > 0.0 else "shorter"
            return (
                f"{self.name}{other} would have to be {abs(longer) / MM:.1f} mm {word}, {self.wanted / MM:.1f} +- "
                f"{self.std / MM:.2g} mm in place of {self.nominal / MM:.1f}"
            )
        if self.name.endswith("_rad"):
            return (
                f"{self.name}{other} would have to be {abs(by) / DEG:.1f} deg {'more' if by > 0.0 else 'less'}, "
                f"{self.wanted / DEG:.1f} +- {self.std / DEG:.2g} deg in place of {self.nominal / DEG:.1f}"
            )
        joint = self.name.rsplit(".", 1)[0]
        word = "more" if self.wanted > self.nominal else "less"
        return f"{joint} would have to move {100.0 * abs(by):.2f} +- {100.0 * self.std:.1g} % {word} than its reading"


class KnownArm(NamedTuple):
    """An arm known by name that fits the measurements as it is."""

    name: Annotated[str, Doc("Its name.")]
    error_m: Annotated[float, Doc("Median error of a place, base and tool fitted, m.")]


@output
class OtherArm(Output):
    """Why the nominal arm is that of another one.

    differences: where the figures of the known arm are not the nominal ones, in words. left_m: mean error of rows left
    out with what was found, None where it explains too little.
    """

    found: Annotated[
        tuple[Misfit, ...], Doc("Figures that the measurements contradict, the worst first.", key="misfits")
    ]
    known: Annotated[KnownArm | None, Doc("The arm known by name that fits far better; null for none.")]
    differences: tuple[str, ...]
    nominal_error_m: Annotated[float, Doc("Median error of a place with the nominal arm, m.")]
    left_m: float | None

    def text(self) -> str:
        """Return what is wrong and what to do, for a verdict."""
        why = []
        if self.found:
            then = "" if self.left_m is None else f"; rows left out would then miss by {self.left_m / MM:.2g} mm"
            why.append("; ".join(item.text() for item in self.found[:TOLD]) + then)
        if self.known is not None:
            name, error_m = self.known
            lengths = f" ({'; '.join(self.differences[:TOLD])})" if self.differences else ""
            why.append(
                f"the figures of {name} fit these measurements to {error_m / MM:.2g} mm as they are, the nominal ones "
                f"to {self.nominal_error_m / MM:.3g} mm{lengths}"
            )
        return (
            f"This is not the nominal geometry of this arm: {'. And '.join(why)}. That is more than nominal "
            "figures are believed to be off by, and nothing is corrected. Give the nominal figures of this very arm, "
            f"or look for one that was typed wrong.{self._built()}"
        )

    def _built(self) -> str:
        """Return how to say that an arm is really built so, where that could be."""
        lengths = [abs(item.wanted - item.nominal) for item in self.found if item.name.endswith("_m")]
        if self.known is not None or not lengths or max(lengths) > HOME_MADE_M:
            return ""
        believed = np.ceil(max(lengths) / MM / (BEYOND - 0.5))
        return f" If the arm is really built so, say it: --tolerance-mm {believed:.0f}."


def other_arm(model: ArmModel, points: ArmPoints, plain: Level, best: Level, tolerance: Tolerance) -> OtherArm | None:
    """Return why the nominal arm is another one than the measurements are of; None where nothing says so.

    plain: base and tool fitted alone; best: the model that would be kept. It is another arm where best corrects a
    length, twist or scale beyond tolerance; where the fit with hardly any belief in the nominal arm does, and predicts
    rows left out as well; and where an arm known by name fits far better as it is, and better than best. Of lengths
    that add up on parallel axes their sum must be beyond what all of them may be off by, or a known arm fit better.
    The last two questions are asked only where the nominal arm misses by what a wrong length makes, and best leaves
    millimetres too. Zeros of joints never say so: they are set, not built.
    """
    kept = beyond(model, best.fitted, tolerance)
    error_m = float(np.median(np.linalg.norm(model.errors(plain.fitted.p, points)[0], axis=1)))
    most_m = BEYOND * tolerance.length_m
    if not kept and (error_m < QUIET * most_m or np.median(best.left_m) < SETTLED * most_m):
        return None
    if len(points) > ENOUGH_ROWS:
        points, plain, best = _fewer(model, points, plain, best)
    left_m = float(best.left_m.mean()) if kept else None
    scales, sags = tuple(f"{joint.name}.scale" for joint in model.arm.joints), model.sags
    soft = bool(set(sags) & set(best.choice.free))
    # Of a soft arm only what rows say with hardly any belief, predicting as well, is evidence.
    certain = not soft and any(item.certain for item in kept)
    found = open_fit(model, points, plain.fitted, sags if soft else scales)
    if found is not None:
        left = left_out(model, points, found)
        if significant_gain(plain.left_m, left, points.group) and np.median(left) < AS_GOOD * np.median(best.left_m):
            wide = beyond(model, found, tolerance)
            # What tight belief has put into scales and lengths beside the wrong one is no evidence where the same rows,
            # asked with hardly any, are sure of none: a joint that sags under load is taken for one of another gear.
            certain = any(item.certain for item in wide) or (certain and bool(wide))
            wide = wide or (beyond(model, found, tolerance, sure=0.0) if kept else ())
            kept, left_m = (wide, float(left.mean())) if wide else (kept, left_m)
            if certain and all(item.name.endswith(".scale") for item in wide):
                sagging = open_fit(model, points, plain.fitted, sags)
                certain = sagging is None or bool(left_out(model, points, sagging).mean() > AS_GOOD * left.mean())
    known = None if best.couplings else known_arm(model, points, FITS_DOUBTED if kept else FITS)
    if known is not None and not kept and known[1] > np.median(best.left_m):
        known = None  # what would be kept fits better still, with corrections that are believed
    if not certain and known is None:
        return None
    differences = () if known is None else _differences(model.arm, preset(known[0]))
    return OtherArm(found=kept, known=known, differences=differences, nominal_error_m=error_m, left_m=left_m)


def explained(model: ArmModel, points: ArmPoints) -> str:
    """Return what makes the nominal arm another one, for measurements that are refused as not of it; '' for nothing."""
    try:
        plain = fit_arm(model, points, start(model, points), (), OPEN)
        level = plain_level(model, points, plain, "")
        found = other_arm(model, points, level, level, Tolerance())
    except ArmsightError:
        return ""
    few = found is not None and (found.known is not None or (found.left_m or np.inf) < EXPLAINS * found.nominal_error_m)
    return found.text() if found is not None and few else ""


def _fewer(model: ArmModel, points: ArmPoints, plain: Level, best: Level) -> tuple[ArmPoints, Level, Level]:
    """Return some of the rows, and the two levels with their left-out errors alone."""
    rows = np.linspace(0, len(points) - 1, ENOUGH_ROWS).astype(np.intp)
    some = points.take(rows)
    if some.labels != model.labels:
        return points, plain, best
    return some, replace(plain, left_m=plain.left_m[rows]), replace(best, left_m=best.left_m[rows])


def open_fit(model: ArmModel, points: ArmPoints, plain: ArmFit, beside: tuple[str, ...]) -> ArmFit | None:
    """Return the fit of geometry, and what is named beside it, with hardly any belief in the nominal arm; None where it
    has no minimum."""
    found = plain
    try:
        for _ in range(ROUNDS):
            found = fit_arm(model, points, found.p, (*model.geometry, *beside), OPEN)
    except NotConverged:
        return None
    return found


def beyond(model: ArmModel, fitted: ArmFit, tolerance: Tolerance, *, sure: float = SURE) -> tuple[Misfit, ...]:
    """Return the corrections of lengths, twists and scales that are beyond tolerance, the worst first.

    sure: so many standard deviations of theirs beyond it.
    """
    std = fitted.fit.std()
    found = []
    for name in model.names[: 6 * model.arm.n]:
        if name not in fitted.free or _is_zero(model, name):
            continue
        change = float(fitted.p[model.names.index(name)])
        most = MOST_SCALE if name.endswith(".scale") else BEYOND * tolerance.of(name)
        excess = (abs(change) - sure * std.get(name, np.inf)) / most
        if excess > 1.0:
            found.append(_misfit(model, name, change, std[name], excess))
    return tuple(sorted(found, key=lambda item: -item.excess))


def _is_zero(model: ArmModel, name: str) -> bool:
    """Tell whether a parameter is a joint's zero, which is set and not built."""
    joint, _, key = name.rpartition(".")
    turns = next(r for j, r in zip(model.arm.joints, model.arm.revolute, strict=True) if j.name == joint)
    return key == ("theta_rad" if turns else "d_m")


def _misfit(model: ArmModel, name: str, change: float, std: float, excess: float) -> Misfit:
    joint, _, key = name.rpartition(".")
    k = next(i for i, j in enumerate(model.arm.joints) if j.name == joint)
    nominal = 1.0 if key == "scale" else float(getattr(model.arm.joints[k], key))
    beside: list[str] = []
    parallel = {first for first, _ in model.parallel}
    while key == "d_m" and k - 1 in parallel:
        k -= 1
        beside.insert(0, f"{model.arm.joints[k].name}.d_m")
    return Misfit(name=name, nominal=nominal, wanted=nominal + change, std=std, excess=excess, beside=tuple(beside))


def known_arm(model: ArmModel, points: ArmPoints, share: float = FITS) -> KnownArm | None:
    """Return the arm known by name that fits the rows far better than the nominal one, with its median error in m.

    share: of the nominal arm's error that its own may be. All are placed from one tool's point; the few that fit best
    then, from all the points that `start` begins at.
    """
    like = start(model, points)

    def error_m(other: ArmModel, like: Array | None = None) -> float:
        try:
            p = start(other, points, like=like)
        except ArmsightError:
            return np.inf
        return float(np.median(np.linalg.norm(other.errors(p, points)[0], axis=1)))

    arms = [arm for arm in map(preset, PRESETS) if arm.n == model.arm.n and (arm.revolute == model.arm.revolute).all()]
    others = sorted((replace(model, arm=arm) for arm in arms), key=lambda other: error_m(other, like))
    errors = [KnownArm(other.arm.name, error_m(other)) for other in others[:SHORT_LIST]]
    best = min(errors, key=lambda item: item.error_m, default=KnownArm("", np.inf))
    spread = float(np.median(np.linalg.norm(points.xyz_m - np.median(points.xyz_m, axis=0), axis=1)))
    return best if best.error_m < min(share * error_m(model), KNOWN_FITS * spread) else None


def _differences(arm: Arm, other: Arm) -> tuple[str, ...]:
    """Return where the lengths of another arm are not those of this one, in words, the largest first."""
    arm, other = in_convention(arm, "standard"), in_convention(other, "standard")
    found = [
        (abs(getattr(b, key) - getattr(a, key)), f"{a.name}.{key}", getattr(b, key), getattr(a, key))
        for k, (a, b) in enumerate(zip(arm.joints, other.joints, strict=True))
        for key in ("a_m", "d_m")
        if not (key == "d_m" and k in (0, arm.n - 1))  # the first and the last d go into base and tool
    ]
    return tuple(
        f"{name} {wanted / MM:.4g} mm in place of {given / MM:.4g}"
        for size, name, wanted, given in sorted(found, reverse=True)
        if size > LEAST_DIFFERENCE_M
    )
