"""What most pairs agree on, and whether they would agree better if the table were read differently."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.handeye.kernels import closed_forms as starts
from armsight.calibrate.handeye.pairs import Arrays, Poses, Setup
from armsight.errors import Inconsistent
from armsight.units import DEG

SAMPLE = 4
"""Pairs per sample: three would do, four are better conditioned."""

N_SAMPLES = 80
"""With 20 % gross errors no sample of four is clean once in 10^18 draws, with 40 % once in 10^5."""

CONSENSUS_SEED = 20051
"""Samples are drawn the same way every time."""

CLEARLY_RIGHT = 0.01
"""Residuals below this share of the motion: no other reading of the table can do as well (inverted poses differ in the
second order of the turn, at least 2 % of it), except the neighbouring row of a slow, dense recording."""

MUCH_BETTER = 0.1
"""Another reading is believed where its residuals, orientation times position, are smaller by this factor; of chance
alone none of 10,000 good sets comes below 0.8."""

RIGHT = 0.15
"""... and where they are a small share of the motion."""

UNRELATED = 0.25
"""Residuals above this share of the motion mean that the poses do not belong together: shuffled tables leave 0.4 and
more, real ones below 0.1."""

LEAST_SHARE = 0.6
"""At least this share of the pairs must agree."""

NEAR = 0.1
"""... within the noise of most, or within this share of the motion: a few noisy pairs have no tails to judge by, and a
pair that does not belong is off by the motion itself."""

SCALE_WRONG = 1.5
"""A target's size that is off by more than this factor is a wrong unit, not a badly printed sheet."""

SCALE_WINS = 0.3
"""The scale is freed in the consensus where that lowers the residual to this share."""

UNITS = {
    1000.0: "millimetres for metres",
    100.0: "centimetres for metres",
    1000.0 / 25.4: "inches for metres",
    25.4: "inches for millimetres",
    10.0: "millimetres for centimetres",
}

MIN_SHIFTED = 6
"""Fewer rows than this can fit a wrong neighbour by chance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Consensus:
    """start: RX, tX, RZ, tZ, and gamma of most pairs; keep (n,): which agree within the noise.

    sigma_rad, sigma_m: robust standard deviations of one component (camera's unit), share_turn, share_move: their
    shares of the motion. agree: the share of the pairs that share it within the noise or NEAR.
    """

    start: Poses
    gamma: float
    keep: NDArray[np.bool_]
    sigma_rad: float
    sigma_m: float
    share_turn: float
    share_move: float
    agree: float

    @property
    def score(self) -> float:
        """Size of the residuals, orientation times position; the smaller, the better the reading."""
        return max(self.sigma_rad, 1e-9) * max(self.sigma_m, 1e-9)

    @property
    def share(self) -> float:
        """The larger share of the motion left unexplained."""
        return max(self.share_turn, self.share_move)


def consensus(arrays: Arrays) -> Consensus:
    """Return what most pairs of F X B = Z agree on (least median of squares), with the scale free where it must be.

    Where most turned about one axis alone they agree on an answer that the others contradict; then what all pairs say
    together is taken, if it explains them.
    """
    found = _of_most(arrays)
    if found.agree < LEAST_SHARE or found.share > UNRELATED:
        of_all = _of_all(arrays)
        if of_all is not None and of_all.agree >= LEAST_SHARE and of_all.share <= NEAR:
            return of_all
    return found


def _of_most(arrays: Arrays) -> Consensus:
    RF, tF, RB, tB = arrays
    n = len(RF)
    drawn = samples(n)
    keep = np.ones(n, bool)
    errors = np.empty(n)
    RX, RZ, sigma_rad = starts.rotation_consensus(RF, RB, drawn, keep, errors)
    outcomes = []
    # a free scale fits the noise of few pairs too, and is taken only where it explains most of what is left
    for free in (False, True):
        mask = keep.copy()
        ok, tX, tZ, gamma, sigma_m = starts.translation_consensus(RX, RF, tF, tB, drawn, free, mask, errors)
        outcomes.append((sigma_m if ok and gamma > 0.0 else np.inf, tX, tZ, float(gamma), mask))
    sigma_m, tX, tZ, gamma, mask = outcomes[1] if outcomes[1][0] < SCALE_WINS * outcomes[0][0] else outcomes[0]
    return _judged(arrays, (RX, tX, RZ, tZ), gamma, mask, (float(sigma_rad), float(sigma_m)))


def _of_all(arrays: Arrays) -> Consensus | None:
    """Return the closed forms of all pairs, None where their translations leave something open."""
    RF, tF, RB, tB = arrays
    every = np.ones(len(RF), bool)
    RX, RZ = starts.shah_rotations(RF, RB, every)
    ok, tX, tZ, gamma = starts.translations(RX, RF, tF, tB, every, False)
    if not ok:
        return None
    start = (RX, tX, RZ, tZ)
    turned, moved = _left(arrays, start, gamma)
    # the median length of three unit normals is MEDIAN_NORM: from lengths to one component
    sigmas = (float(np.median(turned)) / starts.MEDIAN_NORM, float(np.median(moved)) / starts.MEDIAN_NORM)
    return _judged(arrays, start, float(gamma), None, sigmas)


def _judged(
    arrays: Arrays, start: Poses, gamma: float, mask: NDArray[np.bool_] | None, sigmas: tuple[float, float]
) -> Consensus:
    """mask (n,): which agree within the noise; None for those that are near."""
    RF, tF, RB, tB = arrays
    # how much there was to explain, in the camera's unit: the target's way in the camera, and beside it the way of the
    # base's (or flange's) origin seen from the other side, which a hand that only turned makes too
    turn = max(_spread(_turns(RB)), 1e-12)
    move = max(float(np.hypot(_spread(tB), abs(gamma) * _deviation(-np.einsum("nji,nj->ni", RF, tF)))), 1e-12)
    turned, moved = _left(arrays, start, gamma)
    near = np.asarray((turned <= NEAR * turn) & (moved <= NEAR * move))
    keep = near if mask is None else mask
    return Consensus(
        start=start,
        gamma=gamma,
        keep=keep,
        sigma_rad=sigmas[0],
        sigma_m=sigmas[1],
        share_turn=sigmas[0] / turn,
        share_move=sigmas[1] / move,
        agree=float((keep | near).mean()),
    )


def _left(arrays: Arrays, start: Poses, gamma: float) -> tuple[Array, Array]:
    """Return the angle and the distance (n,) that each pair leaves open, the latter in the camera's unit."""
    RF, tF, RB, tB = arrays
    RX, tX, RZ, tZ = start
    turned = Rotation.from_matrix(RF @ RX @ RB @ RZ.T).magnitude()
    seen = gamma * (np.einsum("nji,nj->ni", RF, tZ - tF) - tX) @ RX
    return np.asarray(turned), np.linalg.norm(tB - seen, axis=1)


def check_reading(arrays: Arrays, setup: Setup, given: Consensus, in_order: Arrays) -> None:
    """Raise Inconsistent where the table fits far better, or only, when it is read differently.

    arrays: as the fit takes them. in_order: the same pairs in the order of the file, for the shifted readings.
    """
    readings = dict(_shifted(in_order))
    if given.share > CLEARLY_RIGHT:
        readings |= _other_readings(arrays, setup)
    better = []
    for text, other in readings.items():
        found = consensus(other)
        if found.score < MUCH_BETTER * given.score and found.share < RIGHT:
            better.append((found.score, text, found))
    if better:
        _, text, found = min(better, key=lambda entry: entry[0])
        raise Inconsistent(
            f"the poses contradict each other as given (typically {_size(given)}), but agree ({_size(found)}) "
            f"if {text}",
            consequence="A calibration from the table as it is would be wrong by as much",
            cure="Correct the table and run again",
        )
    require_metric(given)
    require_agreement(given)


def require_metric(given: Consensus) -> None:
    """Raise Inconsistent where the camera's distances and the robot's are in different units."""
    factor = given.gamma
    if 1.0 / SCALE_WRONG < factor < SCALE_WRONG or given.share > RIGHT:
        return
    size = max(factor, 1.0 / factor)
    names = [name for unit, name in UNITS.items() if abs(np.log(size / unit)) < 0.1]
    which, other = ("camera's", "robot's") if factor > 1.0 else ("robot's", "camera's")
    raise Inconsistent(
        f"the {which} distances are {size:.4g} times those of the {other} motion"
        + (f": {names[0]}?" if names else ", so one of them is not in metres"),
        consequence="No rigid setup explains both",
        cure="Give both tables in metres, and check the pitch of the target",
    )


def require_agreement(given: Consensus) -> None:
    """Raise Inconsistent where the poses of robot and camera do not belong together."""
    if given.share <= UNRELATED and given.agree >= LEAST_SHARE:
        return
    n = len(given.keep)
    raise Inconsistent(
        "the camera's poses do not follow the robot's: the best explanation leaves "
        f"{100.0 * given.share_turn:.3g} % of the turns and {100.0 * given.share_move:.3g} % of the moves open"
        + (f", and only {given.agree * n:.0f} of {n} pairs share it" if given.agree < LEAST_SHARE else ""),
        consequence="No place of the camera explains them; no calibration is given",
        cure="Check which robot pose belongs to which image, that the target stood still (eye-to-hand: moved with the "
        "hand), and the order of the quaternion's columns (x, y, z, w)",
    )


def _size(found: Consensus) -> str:
    return f"{found.sigma_rad / DEG:.2g} degrees and {1e3 * found.sigma_m:.2g} mm apart"


def samples(n: int) -> NDArray[np.int64]:
    """Return (S, 4) samples, all of them where they are few."""
    if comb(n, SAMPLE) <= N_SAMPLES:
        return np.array(list(combinations(range(n), SAMPLE)))
    rng = np.random.default_rng(CONSENSUS_SEED)
    return np.argsort(rng.random((N_SAMPLES, n)), axis=1)[:, :SAMPLE].astype(np.int64)


def _shifted(arrays: Arrays) -> list[tuple[str, Arrays]]:
    """Return the readings in which the camera's rows are one up or down."""
    RF, tF, RB, tB = arrays
    if len(RF) - 1 < MIN_SHIFTED:
        return []
    return [
        ("each camera pose belongs to the robot pose one row further down", (RF[1:], tF[1:], RB[:-1], tB[:-1])),
        ("each camera pose belongs to the robot pose one row further up", (RF[:-1], tF[:-1], RB[1:], tB[1:])),
    ]


def _other_readings(arrays: Arrays, setup: Setup) -> dict[str, Arrays]:
    """Return the usual mistakes of exporting poses, undone."""
    RF, tF, RB, tB = arrays
    # both tables inverted satisfy the same equation with X and Z exchanged: no residual can tell that
    other = Setup.EYE_TO_HAND if setup is Setup.EYE_IN_HAND else Setup.EYE_IN_HAND
    return {
        f"the setup is {other}, or the robot's poses are T_flange_base": (*_inverse(RF, tF), RB, tB),
        "the camera's poses are T_target_camera": (RF, tF, *_inverse(RB, tB)),
        "the robot's quaternions are written w, x, y, z": (*_scalar_first(RF, tF, setup), RB, tB),
        "the camera's quaternions are written w, x, y, z": (RF, tF, rolled(RB), tB),
        # a mirror in both frames of a pose is a half turn of both, and the position's other sign
        "one table's axes are left-handed, as with y up (undone by the other sign of y, qx and qz)": (RF, tF, RB, -tB),
    }


def _inverse(R: Array, t: Array) -> tuple[Array, Array]:
    back = np.ascontiguousarray(R.transpose(0, 2, 1))
    return back, -np.einsum("nij,nj->ni", back, t)


def _scalar_first(R: Array, t: Array, setup: Setup) -> tuple[Array, Array]:
    if setup is Setup.EYE_IN_HAND:
        return rolled(R), t
    R, t = _inverse(R, t)
    return _inverse(rolled(R), t)


def rolled(R: Array) -> Array:
    """Return the rotations whose quaternion (x, y, z, w) was really written as (w, x, y, z)."""
    q = Rotation.from_matrix(R).as_quat()
    return np.ascontiguousarray(Rotation.from_quat(np.roll(q, -1, axis=1)).as_matrix())


def _turns(R: Array) -> Array:
    """Return (n, 3) rotation vectors about the first orientation, enough to see how much there is."""
    U, _, Vt = np.linalg.svd(R.mean(axis=0))
    middle = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    turns: Array = starts.rotvecs(R @ middle.T)
    return turns


def _spread(values: Array) -> float:
    """Return the robust standard deviation of one component of vectors (n, 3) about their median."""
    return float(np.median(np.linalg.norm(values - np.median(values, axis=0), axis=1)) / starts.MEDIAN_NORM)


def _deviation(values: Array) -> float:
    """Return the standard deviation of one component of vectors (n, 3): also of a hand that mostly only turned."""
    return float(np.sqrt(((values - values.mean(axis=0)) ** 2).mean()))
