"""A run's consistency in words: cause, consequence, cure."""

from __future__ import annotations

import math

from armsight.measure.consistency.causes import RECALIBRATE, REMEASURE
from armsight.measure.consistency.diagnosis import NOISY, VERY_NOISY, Consistency, Finding
from armsight.units import DEG, MM

SHOWN = {"1": (100.0, " %"), "m": (1.0 / MM, " mm"), "rad": (1.0 / DEG, "°"), "s": (1e3, " ms")}
"""How people read each unit: factor and sign."""

FLAT_BOARD = "For less, glue the board on a flat plate and measure its print with a calliper"

ONE_SIGNED = ("scale", "timing")
"""Causes of one number, whose sign means something."""


AXES = {f"about_{a}_rad": f"about its {a} axis" for a in "xyz"} | {f"{a}_m": f"along {a}" for a in "xyz"}
"""Which number of a vector is told, by its label."""


def sentence(found: Consistency) -> str:
    """Return what the check says in one or two sentences; empty where there is nothing to say."""
    if not found.findings and found.verdict == "inconsistent":
        return f"{100 * found.refused:.0f} % of the frames do not fit the target, and no one cause stands out."
    if not found.findings or found.verdict == "ok":
        return _noise(found)
    first, *others = found.findings[: found.equal]
    text = f"{_what(first)}: {_consequence(found, first)}"
    if others:
        text += f". The residuals agree as well with this: {'; or '.join(_what(other) for other in others)}"
    if found.refused > 0.0:
        text += f". {100 * found.refused:.0f} % of the frames do not fit at all and gave no pose"
    return f"{text[0].upper()}{text[1:]}."


def advice(found: Consistency) -> str:
    """Return what to do about it; empty where there is nothing to do."""
    if found.as_calibrated and found.noise_scale > VERY_NOISY and not found.findings:
        return f"{FLAT_BOARD}, then {RECALIBRATE}."
    if found.verdict in ("ok", "unchecked"):
        return ""
    if not found.findings:
        noisy = "Look at the spots in the report: blur, reflections, vibration"
        return (
            f"{noisy}."
            if found.verdict == "doubtful"
            else f"{RECALIBRATE[0].upper()}{RECALIBRATE[1:]}, then {REMEASURE}."
        )
    told: list[str] = []
    for f in found.findings[: found.equal]:
        told += [f.cause.advice] if f.cause.advice not in told else []
    return ". Or: ".join(told) + "."


def _what(f: Finding) -> str:
    """Return the cause with its size: 'the target's scale against the baseline is off by 1.02 +- 0.03 %'."""
    if not (f.cause.unit and f.quotable):
        return f.cause.words
    factor, sign = SHOWN[f.unit]
    if f.cause.key == "distortion":
        factor, sign = 1.0, " in k1"
    value = f.size if f.cause.key in ONE_SIGNED else abs(f.size)
    size = _figures(factor * value, factor * f.std, sign)
    size += f" {AXES[f.label]}" if f.label in AXES else ""
    if f.cause.key == "timing":
        later = "later" if f.size > 0.0 else "earlier"
        return (
            f"the right camera exposes {_figures(factor * abs(f.size), factor * f.std, sign)} {later} than the left one"
        )
    moment = "" if f.since_s is None else f" (from about {f.since_s:.1f} s on)"
    return f"{f.cause.words}, by {size}{moment}" if f.cause.key != "scale" else f"{f.cause.words} by {size}"


def _figures(value: float, std: float, sign: str) -> str:
    """Return value and standard deviation with as many digits as the standard deviation has two of."""
    places = max(0, 1 - math.floor(math.log10(std))) if std > 0.0 else 3
    return f"{value:.{min(places, 6)}f} ± {std:.{min(places, 6)}f}{sign}"


def _consequence(found: Consistency, f: Finding) -> str:
    """Return what it does to the poses, beside what they claim."""
    times = f.effect_m / found.claimed_m
    text = f"positions are wrong by about {_plain(f.effect_m / MM)} mm"
    turns = f.effect_rad / found.claimed_rad
    if turns > max(2.0, times):
        text, times = f"{text} and rotations by {_plain(f.effect_rad / DEG)}°", turns
    return f"{text}, {_plain(times)} times the claimed standard deviation"


def _plain(value: float) -> str:
    """Return two significant digits, without powers of ten."""
    return f"{value:.{max(0, 1 - math.floor(math.log10(value)))}f}" if value > 0.0 else "0"


def _noise(found: Consistency) -> str:
    if found.verdict == "unchecked" or found.noise_scale < NOISY:
        return ""
    if found.as_calibrated:
        return (
            f"The residuals, {found.residual_px:.3f} px, are those that the rig was calibrated with "
            f"({found.calibration_px:.3f} px) and {found.noise_scale:.1f} times the noise of the points found: "
            "the board's print and flatness or the lenses, not this recording; the poses' standard deviations are "
            "widened by it."
        )
    text = f"The residuals are {found.noise_scale:.1f} times the spots' noise, without a pattern"
    much = ": more than a camera's noise explains" if found.noise_scale > VERY_NOISY else ""
    return f"{text}{much}; the poses' standard deviations are widened by it."
