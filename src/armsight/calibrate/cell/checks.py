"""Whether one model explains the whole recording: what may have changed on the way, or was left out of the model.

Each suspicion is a few parameters more (a camera that stands otherwise from a moment on, a target that slipped, a clock
that jumped, a joint that gives way). How much they would take off the sum of squares is a score test (Rao 1948): it
needs the normal equations of the stretches alone, at the fit as it is, with the arm's straying eliminated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cell.fit import CellFit
from armsight.calibrate.cell.model import CLOCK_AT, PER_CAMERA, POSE_AT, BlockNormals, CellModel
from armsight.calibrate.cell.observations import BLOCK_S
from armsight.calibrate.cell.wander import JointDrift, half_solved
from armsight.errors import Inconsistent
from armsight.fitting.quantiles import chi2_isf
from armsight.geometry.poses import skew

FALSE_ALARM = 1e-7
"""Chance by which pure noise raises one of the alarms of a recording, over all moments tried."""
RIVAL = 0.5
"""Another cause with so much of the first one's evidence is told too."""
EDGE_S = 3.0
"""Time from either end at which nothing is held to have changed."""
ALARM = 2.0
"""Times beyond chance: an arm strays in more ways than any model of it."""
VISIBLE = 0.15
"""What changed must move the spots by so much of their noise (RMS): less is of no consequence, no model is exact."""


class Cause(StrEnum):
    """What may be behind residuals that one model does not explain."""

    CAMERA_MOVED = "camera moved"
    TARGET_SLIPPED = "target slipped"
    CLOCK_JUMPED = "clock jumped"
    JOINT_JUMPED = "joint reading jumped"
    ELASTIC = "joints give way"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Suspicion:
    """A change and when: gain of chi-square by k parameters, their values, and how far spots move by it in deviations.

    part: which joint or camera. t_s: when by the robot's clock, None for what holds all along.
    """

    cause: Cause
    part: str
    t_s: float | None
    gain: float
    k: int
    size: Array
    visible: float

    @property
    def told(self) -> str:
        """It in words."""
        what = f"{self.cause.value} ({self.part})" if self.cause is Cause.JOINT_JUMPED else self.cause.value
        if self.cause in OF_CAMERAS:
            what = f"{self.part} {what}"
        return what if self.t_s is None else f"{what} at {self.t_s:.1f} s of the robot's log"

    @property
    def evidence(self) -> float:
        """The gain over what k parameters take off by chance at the most."""
        return self.gain / float(chi2_isf(FALSE_ALARM, self.k))


def suspicions(model: CellModel, found: CellFit) -> list[Suspicion]:
    """Return what speaks against one model for all of the recording, the best explanation first."""
    system = _System.of(model, found)
    t = model.times_s(found.x, found.spots)
    edges = np.searchsorted(found.block, np.arange(int(found.block[-1]) + 1))
    out: list[Suspicion] = []
    edge = round(EDGE_S / BLOCK_S)
    for cause, part, U in _changes(model, found.x):
        # near the ends a change has too little behind it to be told from the rest
        begins = np.arange(edge, len(edges) - edge)
        if len(begins):
            out.append(system.likeliest(cause, part, U, begins, t[edges]))
    # what gives way does so all along; all joints that carry something are one suspicion
    soft = model.arm.sags
    if soft and not set(soft) & set(found.free):
        U = np.zeros((len(found.x), len(soft)))
        for k, name in enumerate(soft):
            U[model.names.index(name), k] = 1.0
        out.append(system.likeliest(Cause.ELASTIC, "", U, np.zeros(1, np.intp), None))
    return sorted(out, key=lambda each: -each.evidence)


def alarming(each: Suspicion) -> bool:
    """Tell whether a suspicion is beyond chance and of consequence."""
    return each.evidence > ALARM and each.visible > VISIBLE


def gives_way(doubts: Sequence[Suspicion]) -> bool:
    """Tell whether joints that give way are beyond chance: less than an alarm, as it is taken into the model."""
    return any(each.cause is Cause.ELASTIC and each.evidence > 1.0 for each in doubts)


CURES = {
    Cause.CAMERA_MOVED: "Fasten the {part} camera, and record again without touching it",
    Cause.TARGET_SLIPPED: "Clamp the target to the flange, and record again",
    Cause.CLOCK_JUMPED: "Record again with the {part} camera's own stamps, or close other programs that use it; where "
    "all cameras are named it was the robot's clock",
    Cause.JOINT_JUMPED: "Look at that joint's encoder and coupling (a slipped belt, a lost reference); record again",
    Cause.ELASTIC: "Give the links' masses in the arm's file and --compliance on",
}
OF_CAMERAS = (Cause.CAMERA_MOVED, Cause.CLOCK_JUMPED)


def refusal(doubts: Sequence[Suspicion]) -> Inconsistent:
    """Return the error for doubts of which the first is alarming."""
    first = doubts[0]
    others = [each for each in doubts[1:] if alarming(each) and each.evidence > RIVAL * first.evidence]
    also = "" if not others else "; less likely: " + ", ".join(each.told for each in others)
    return Inconsistent(
        f"{first.told}: the spots move by {first.visible:.2g} of their noise by it{also}",
        consequence="One calibration does not hold for all of the recording, and none is given",
        cure=CURES[first.cause].format(part=first.part),
    )


def _changes(model: CellModel, x: Array) -> Iterator[tuple[Cause, str, Array]]:
    """Yield what may change at a moment: its cause, which part, and its directions (P, k) among the parameters."""
    P = len(x)
    for side, name in enumerate(model.recording.names):
        first = side * len(PER_CAMERA)
        U = np.zeros((P, 6))
        U[first + POSE_AT : first + CLOCK_AT] = np.eye(6)
        yield Cause.CAMERA_MOVED, name, U
        U = np.zeros((P, 1))
        U[first + CLOCK_AT] = 1.0
        yield Cause.CLOCK_JUMPED, name, U
    lights = model.lights_m(x)
    U = np.zeros((P, 6))
    U[model.lights_at :] = np.concatenate([np.tile(np.eye(3), (len(lights), 1)), -skew(lights).reshape(-1, 3)], axis=1)
    yield Cause.TARGET_SLIPPED, "", U
    for joint, turns in zip(model.arm.arm.joints, model.arm.arm.revolute, strict=True):
        U = np.zeros((P, 1))
        U[model.names.index(f"{joint.name}.{'theta_rad' if turns else 'd_m'}")] = 1.0
        yield Cause.JOINT_JUMPED, joint.name, U


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _System:
    """The fit's normal equations with what is eliminated from them: the straying w and the fitted parameters."""

    normals: BlockNormals
    free: NDArray[np.intp]
    H: Array
    wander: JointDrift | None
    chol: Array
    followed: Array
    """(b, n, P + 1): how far w goes with each parameter, and by the residuals."""

    @classmethod
    def of(cls, model: CellModel, found: CellFit) -> _System:
        free, wander, normals = found.places, found.wander, found.normals
        H = found.information(model)[np.ix_(free, free)]
        chol, followed = np.zeros((0, 0)), np.zeros((len(normals.A), 0, len(found.x) + 1))
        if wander is not None:
            C, chol, right = wander.system(normals)
            both = np.column_stack([C, right])
            followed = scipy.linalg.cho_solve_banded((chol, True), both, check_finite=False)
            followed = followed.reshape(len(normals.A), -1, both.shape[1])
        return cls(normals=normals, free=free, H=H, wander=wander, chol=chol, followed=followed)

    def likeliest(self, cause: Cause, part: str, U: Array, begins: NDArray[np.intp], t_s: Array | None) -> Suspicion:
        """Return what directions U (P, k) would take off that apply from the best of some stretches on.

        t_s (b,): when the stretches begin, where a moment is told.
        """
        AU = self.normals.A @ U  # (b, P, k)
        at = slice(0, 0) if self.wander is None else self.wander.columns
        n = self.followed.shape[1]
        rows = AU[:, at]
        # the straying follows from its last stretch backwards: what it takes of a change sums up from the change on
        since = _summed(AU - np.einsum("bnk,bnp->bpk", rows, self.followed[..., :-1]), begins)
        pull = _summed(self.normals.g @ U - np.einsum("bnk,bn->bk", rows, self.followed[..., -1]), begins)
        own = U.T @ _summed(AU, begins)
        S = own.copy()
        for k, b in enumerate(begins if n else ()):
            # rows before the change are zero, and stay so through the triangular solve
            half = half_solved(self.chol[:, b * n :], rows[b:].reshape(-1, U.shape[1]))
            S[k] -= half.T @ half
        N = since[:, self.free]
        # all that was fitted may follow the change: only what is left of the directions counts
        S -= N.swapaxes(1, 2) @ np.linalg.solve(self.H, N)
        # in units of what each direction does by itself, or metres and radians would lose each other in rounding
        size = np.sqrt(np.maximum(np.diagonal(own, axis1=1, axis2=2), 1e-300))
        scaled = S / (size[:, :, None] * size[:, None]) + 1e-9 * np.eye(U.shape[1])
        step = -np.linalg.solve(scaled, (pull / size)[:, :, None])[:, :, 0]
        gain = -(step * pull / size).sum(axis=1)
        k = int(np.argmax(gain))
        value, begin = step[k] / size[k], int(begins[k])
        count = max(float(self.normals.count[begin:].sum()), 1.0)
        visible = float(np.sqrt(max(value @ own[k] @ value, 0.0) / count))
        told_s = None if t_s is None else float(t_s[begin])
        return Suspicion(
            cause=cause, part=part, t_s=told_s, gain=float(gain[k]), k=U.shape[1], size=value, visible=visible
        )


def _summed(each: Array, begins: NDArray[np.intp]) -> Array:
    """Return the sums of stretches (b, ...) from each of some on to the end."""
    return np.asarray(np.cumsum(each[::-1], axis=0)[::-1][begins])
