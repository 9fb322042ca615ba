"""What a run's check may find: a cause with its numbers, cameras that are left out, and the verdict over the whole."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from armsight.arrays import Array
from armsight.measure.consistency.causes import TURNS, Cause

QUOTABLE = 3.0
"""Standard deviations from zero below which no number is told, nor a cause that has no other."""

PLAIN = 5.0
"""... and from which the length of a vector is told, else the number of it that stands out most."""

FELT = 0.1
"""Effect on the poses, in claimed standard deviations, from which a camera that is proven wrong is left out: noise
averages out and this does not, so that it is the larger part of a mean of a hundred poses. It keeps off no false alarm:
of 1,000 good runs none proves a cause at all."""

AS_CALIBRATED = 1.25
"""Residuals of a board over those of the rig's calibration up to which they are the same: 1.00 on a calibration's own
pictures (opencv_stereo), 1.07 and 1.14 where one half of them was calibrated with and the other measured."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finding:
    """A cause with the estimate (k,) of its numbers, their covariance (k, k), and what it does to the poses (RMS).

    gain: fall of chi-square. evidence: ln odds against a setup without fault. since_s: of a change. second_moment
    (q, q): of the parameters' error under this cause.
    """

    cause: Cause
    estimate: Array
    covariance: Array
    gain: float
    evidence: float
    effect_m: float
    effect_rad: float
    significant: bool
    second_moment: Array
    since_s: float | None = None

    @property
    def size(self) -> float:
        """The number that the finding rests on: itself, the length of a vector, or that of it which stands out most."""
        return self._quoted[0]

    @property
    def std(self) -> float:
        """Standard deviation of size."""
        return self._quoted[1]

    @property
    def label(self) -> str:
        """Which of the cause's numbers size is; empty for the only one, and for a vector's length."""
        return self._quoted[2]

    @property
    def unit(self) -> str:
        """SI unit of size."""
        return self.cause.unit if not self.cause.of_two_kinds or self._quoted[3] < TURNS else "m"

    @property
    def quotable(self) -> bool:
        """Whether size is told from zero."""
        return abs(self.size) >= QUOTABLE * self.std

    @property
    def _quoted(self) -> tuple[float, float, str, int]:
        """Return size, standard deviation, label and the first number's place."""
        if len(self.estimate) == 1:
            return float(self.estimate[0]), float(np.sqrt(self.covariance[0, 0])), "", 0
        starts = (0, TURNS) if self.cause.of_two_kinds else (0,)
        lengths = [self._length(slice(a, b)) for a, b in zip(starts, (*starts[1:], None), strict=True)]
        i = int(np.argmax([length / std for length, std in lengths]))
        if lengths[i][0] >= PLAIN * lengths[i][1]:
            return *lengths[i], "", starts[i]
        deviations = np.sqrt(np.diag(self.covariance))
        j = int(np.argmax(np.abs(self.estimate) / deviations))
        return float(self.estimate[j]), float(deviations[j]), self.cause.labels[j], j

    def _length(self, part: slice) -> tuple[float, float]:
        along = self.estimate[part]
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.0 else np.ones(len(along)) / sqrt(len(along))
        return length, float(np.sqrt(along @ self.covariance[part, part] @ along))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOut:
    """Cameras whose sights do not count, what is wrong with them, and what to do."""

    names: tuple[str, ...]
    words: str
    cure: str

    @property
    def contradiction(self) -> str:
        """What is wrong and what to do, for whoever must not go on."""
        return f"{self.words}. {self.cure}."

    @property
    def told(self) -> str:
        """What is wrong, and what is done about it."""
        return f"{self.words}: the run goes on without {'it' if len(self.names) == 1 else 'them'}."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Consistency:
    """The verdict over a run: 'ok', 'doubtful', 'inconsistent', or 'unchecked' where there was nothing to judge by.

    findings: significant causes, likeliest first; equal: how many of them explain the residuals equally well.
    noise_scale: the residuals' noise over the claimed one (standard deviations). chi2_per_dof: of all residuals against
    the claimed noise. claimed_m: RMS of the claimed standard deviation of a position (3-D). undetected: by cause, the
    largest
    effect (m, 3-D RMS) on the poses that the run could not have told. refused: share of the frames with enough lights
    whose residuals cannot be noise, so that they gave no pose. residual_px: RMS of a board's points (2-D), beside that
    which its rig was calibrated with; NaN of lights and where not known. instead, remedy: of a run that does not fit,
    what is wrong with rig or target by the setup that does fit (other_setups.py), and what to change. left_out: cameras
    that the others have left behind: all else is of these others.
    """

    verdict: str
    frames: int
    refused: float = 0.0
    chi2_per_dof: float = float("nan")
    noise_scale: float = 1.0
    noise_dof: float = 0.0
    claimed_m: float = float("nan")
    claimed_rad: float = float("nan")
    findings: tuple[Finding, ...] = ()
    equal: int = 0
    undetected: dict[str, float] = field(default_factory=dict)
    residual_px: float = float("nan")
    calibration_px: float = float("nan")
    instead: str = ""
    remedy: str = ""
    left_out: tuple[LeftOut, ...] = ()

    @property
    def accused(self) -> tuple[str, ...]:
        """The cameras that each of the likeliest causes names; none where these do not agree, or poses stay as good."""
        named = self._named
        return tuple(name for name in named[0] if all(name in other for other in named)) if named else ()

    @property
    def open_which(self) -> bool:
        """Whether each of the likeliest causes is some camera's, which not all of them name, and poses are worse."""
        return bool(self._named) and all(self._named) and not self.accused

    @property
    def final(self) -> Consistency:
        """What is said at the end of a run: where it is open which camera is wrong, it is inconsistent."""
        return replace(self, verdict="inconsistent") if self.open_which else self

    @property
    def _named(self) -> list[tuple[str, ...]]:
        """The cameras that each of the likeliest causes names; nothing where poses stay as good."""
        equal = self.findings[: self.equal]
        felt = [max(f.effect_m / self.claimed_m, f.effect_rad / self.claimed_rad) for f in equal]
        return [f.cause.cameras for f in equal] if equal and max(felt) >= FELT else []

    @property
    def second_moment(self) -> Array | None:
        """Expected square (q, q) of the parameters' error, over the significant causes by their odds; None if none."""
        if not self.findings or self.verdict == "ok":
            return None
        odds = np.exp(np.array([f.evidence for f in self.findings]) - self.findings[0].evidence)
        return np.asarray(sum(p * f.second_moment for p, f in zip(odds / odds.sum(), self.findings, strict=True)))

    @property
    def as_calibrated(self) -> bool:
        """Whether a board fits no worse than in the rig's calibration: what is left is print, flatness or lens."""
        return self.residual_px <= AS_CALIBRATED * self.calibration_px

    @property
    def noise_factor(self) -> float:
        """Factor on the spots' variance: above 1 only where the residuals prove it."""
        surely = 1.0 + 4.0 * sqrt(2.0 / max(self.noise_dof, 1.0))
        return self.noise_scale**2 if self.noise_scale**2 > surely else 1.0
