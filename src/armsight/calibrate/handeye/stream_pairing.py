"""Pose pairs out of two time-stamped streams that nobody has paired, and the time offset between the two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from armsight.arrays import Array
from armsight.calibrate.handeye.pairs import MIN_PAIRS, PosePairs
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.units import DEG

MAX_PAIRS = 60
"""Neighbouring frames share their noise; beyond this many well spread poses little is gained."""

LEVER_M = 0.5
"""Metres that count as much as a radian where poses are spread."""

LEAST_APART_RAD = 1.0 * DEG


def pairs_of_streams(
    robot_t_s: ArrayLike,
    robot: RigidTransform,
    camera_t_s: ArrayLike,
    camera: RigidTransform,
    *,
    most: int = MAX_PAIRS,
    within_s: float | None = None,
    camera_covariance: Array | None = None,
) -> tuple[PosePairs, TimeOffset]:
    """Return pairs of the camera's poses with the robot's at the same moment, and the offset between their clocks.

    robot: T_base_flange (n) at robot_t_s, camera: T_camera_target (m) at camera_t_s, both increasing; within_s: by how
    much the clocks differ at most, where that is known. Among the slower
    half of the camera's poses, where a wrong time matters least, those are chosen that lie furthest from each other.
    Raises as time_offset, and NotEnoughData where too few poses differ.
    """
    tr, tc = np.asarray(robot_t_s, float), np.asarray(camera_t_s, float)
    found = time_offset(tr, robot.rotation, tc, camera.rotation, within_s=within_s)
    at = tc + found.offset_s
    inside = np.flatnonzero((at >= tr[0]) & (at <= tr[-1]))
    at = at[inside]
    turn = Slerp(tr, robot.rotation)(at)
    xyz_m = np.stack([np.interp(at, tr, column) for column in robot.translation.T], axis=1)
    flange = RigidTransform.from_components(xyz_m, turn)
    chosen = _spread(flange, _slow(flange, at), most)
    if len(chosen) < MIN_PAIRS:
        raise NotEnoughData(
            f"only {len(chosen)} poses of the streams differ",
            consequence="No calibration is given",
            cure="Move the hand through more and wider turns while recording",
        )
    names = tuple(f"t = {tc[inside[i]]:.3f} s" for i in chosen)
    pairs = PosePairs(
        T_base_flange=flange[chosen],
        T_camera_target=camera[inside[chosen]],
        names=names,
        t_s=at[chosen],
        camera_covariance=None if camera_covariance is None else camera_covariance[inside[chosen]],
    )
    return pairs, found


def _slow(flange: RigidTransform, t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the positions of the slower half, the ends left out."""
    if len(t) < 3:
        return np.arange(len(t))
    turn = (flange.rotation[2:] * flange.rotation[:-2].inv()).magnitude()
    move = np.linalg.norm(flange.translation[2:] - flange.translation[:-2], axis=1)
    speed = (np.asarray(turn) + move / LEVER_M) / (t[2:] - t[:-2])
    return np.flatnonzero(speed <= np.median(speed)) + 1


def _spread(flange: RigidTransform, among: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return up to `most` positions, each the furthest from those before it, in order of time."""
    if not len(among):
        return among
    chosen = [int(among[0])]
    nearest = np.full(len(among), np.inf)
    while len(chosen) < most:
        last = flange[chosen[-1]]
        turn = np.asarray((flange.rotation[among] * last.rotation.inv()).magnitude())
        move = np.linalg.norm(flange.translation[among] - last.translation, axis=1)
        nearest = np.minimum(nearest, turn + move / LEVER_M)
        best = int(np.argmax(nearest))
        if nearest[best] < LEAST_APART_RAD:
            break
        chosen.append(int(among[best]))
    return np.array(sorted(chosen), dtype=np.intp)


# The time offset between the robot's poses and the camera's, from how fast both turn.
#
# The angle between two poses of the flange equals that between the same two poses of the camera, wherever the camera
# is mounted, so the two speeds of turning can be laid over each other before anything is calibrated. From frame to
# frame noise drowns them; over windows of half a second they correlate. All offsets at which the records have enough in
# common are looked at, and at the best ones the turns themselves, of which short records are not alike by chance.


WINDOW_S = 0.5
"""Turns are taken over this long: at 30 frames a second and 0.05 degrees a frame the noise of a speed is then 0.14
degrees a second, between neighbouring frames 2."""

LEAST_CORRELATION = 0.8
"""The speeds of one motion correlate above 0.95 at the right offset. Those of unrelated ones of some seconds may by
chance, at one of many offsets."""
LEAST_ALIKE = 0.95
"""Turns of one motion are alike to 0.999 at the right offset, of 120 pairs of other motions to 0.90 at the best one."""
RIVAL, RIVAL_LEAST = 1.7, 1e-3
"""Another offset, more than a window away, whose turns differ less than so many times as much leaves the answer open:
the motion repeats itself. Below RIVAL_LEAST both are taken as exact."""
LEAST_OVERLAP, LEAST_OVERLAP_S, SHORT = 0.3, 4.0, 0.9
"""Share of the shorter record that both must have in common at an offset, and how long that must be: in less, other
motions are alike by chance. Of records that are not so long, nearly all."""
CANDIDATES = 12
"""Offsets whose turns are compared."""
MOST_TURNS = 4000
"""Windows that they are compared in; more share their frames."""
GRADIENT_S = 2e-3
"""Step of the derivative by the offset."""

LEAST_SPEED_RAD_S = 2.0 * DEG
STEP_S = 0.01
MIN_WINDOWS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeOffset:
    """What lies between the clocks of robot and camera.

    offset_s: add it to the camera's times to get the robot's. std_s: its standard deviation. correlation: at the best
    offset, before refining.
    """

    offset_s: float
    std_s: float
    correlation: float


def time_offset(
    robot_t_s: ArrayLike, robot: Rotation, camera_t_s: ArrayLike, camera: Rotation, *, within_s: float | None = None
) -> TimeOffset:
    """Return the offset between two time-stamped streams of orientations: of the flange in the base (n), and of the
    target in the camera (m). Eye-in-hand and eye-to-hand alike. within_s: no offset beyond it is looked at.

    Raises NotEnoughData for too short records, Degenerate where nothing turns, Inconsistent where the records agree at
    no offset, Ambiguous where they agree at several: the motion repeats itself.
    """
    a, b = _stream(robot_t_s, robot, "robot"), _stream(camera_t_s, camera, "camera")
    offsets, correlations = _correlate(a, b)
    if within_s is not None:
        correlations = np.where(np.abs(offsets) <= within_s, correlations, -1.0)
    top = float(correlations.max(initial=-1.0))
    if top < LEAST_CORRELATION:
        raise _unrelated(
            f"the speeds of their turns do not correlate at any offset (best {max(top, 0.0):.2f})", within_s
        )
    best = [k for k in _peaks(offsets, correlations) if correlations[k] >= LEAST_CORRELATION]
    found = [fit for k in best if (fit := _refined(a, b, float(offsets[k]), float(correlations[k]))) is not None]
    if not found:
        raise NotEnoughData("the two records overlap too little", cure="Record both streams over the same time")
    found.sort(key=lambda fit: fit[0])
    apart, answer = found[0]
    if apart > 1.0 - LEAST_ALIKE:
        raise _unrelated(f"the turns do not correlate at any offset (alike to {1.0 - apart:.2f} at best)", within_s)
    for other, rival in found[1:]:
        if abs(rival.offset_s - answer.offset_s) > WINDOW_S and other < max(RIVAL * apart, RIVAL_LEAST):
            raise Ambiguous(
                f"the motion repeats itself: two offsets fit alike ({answer.offset_s:.2f} and {rival.offset_s:.2f} s)",
                consequence="No offset can be given",
                cure="Move irregularly while recording; or say within what the clocks agree (--clocks-within)",
            )
    return answer


def _unrelated(told: str, within_s: float | None) -> Inconsistent:
    within = "" if within_s is None else f" within {within_s:g} s"
    return Inconsistent(
        f"the robot's and the camera's records do not belong together{within}: {told}",
        consequence="No offset can be given",
        cure="Check that both streams record the same motion" + (", and allow a larger offset" if within else ""),
    )


_Stream = tuple[Array, Slerp]


def _stream(t_s: ArrayLike, rotations: Rotation, what: str) -> _Stream:
    """Return times and an interpolation."""
    t = np.asarray(t_s, float)
    if t.shape != (len(rotations),) or not np.isfinite(t).all():
        raise Inconsistent(f"the {what}'s {len(rotations)} orientations need as many times")
    late = np.flatnonzero(np.diff(t) <= 0.0)
    if late.size:
        raise Inconsistent(
            f"the {what}'s times do not increase at row {late[0] + 1}: {t[late[0] + 1]:.9g} s after {t[late[0]]:.9g} s",
            consequence="Its record has no order, and no time offset can be given",
            cure="Give each time once, in order",
        )
    if len(t) < 2 or t[-1] - t[0] < 4.0 * WINDOW_S:
        raise NotEnoughData(
            f"the {what}'s record is shorter than {4.0 * WINDOW_S} s",
            consequence="No time offset can be given",
            cure="Record ten seconds of irregular turning",
        )
    return t, Slerp(t, rotations)


def _speeds(stream: _Stream, t: Array) -> Array:
    """Return the mean speed of turning (rad/s) over the window about each time; NaN outside the record."""
    times, at = stream
    inside = (t - 0.5 * WINDOW_S >= times[0]) & (t + 0.5 * WINDOW_S <= times[-1])
    out = np.full(len(t), np.nan)
    if inside.any():
        turn = at(t[inside] + 0.5 * WINDOW_S) * at(t[inside] - 0.5 * WINDOW_S).inv()
        out[inside] = turn.magnitude() / WINDOW_S
    return out


def _correlate(a: _Stream, b: _Stream) -> tuple[Array, Array]:
    """Return all offsets on a grid and the correlation of the speeds at each, -1 where too little is in common.

    Sums over what both know, for all offsets at once (Padfield 2012, masked normalised cross-correlation).
    """
    x, y = (_speeds(stream, np.arange(stream[0][0], stream[0][-1], STEP_S)) for stream in (a, b))
    if max(np.nanmax(x, initial=0.0), np.nanmax(y, initial=0.0)) < LEAST_SPEED_RAD_S:
        raise Degenerate(
            "nothing turns in these records",
            consequence="No time offset can be seen",
            cure="Turn the hand while both streams are recorded",
        )
    known_x, known_y = (np.isfinite(speed).astype(float) for speed in (x, y))
    x, y = (np.nan_to_num(speed - np.nanmean(speed)) for speed in (x, y))
    n = np.rint(_sliding(known_x, known_y))
    shorter = float(min(known_x.sum(), known_y.sum()))
    enough = n >= max(min(max(LEAST_OVERLAP * shorter, LEAST_OVERLAP_S / STEP_S), SHORT * shorter), MIN_WINDOWS)
    n = np.maximum(n, 1.0)
    sum_x, sum_y = _sliding(x, known_y), _sliding(known_x, y)
    variance_x = _sliding(x**2, known_y) - sum_x**2 / n
    variance_y = _sliding(known_x, y**2) - sum_y**2 / n
    still = 1e-9 * max(float((x**2).sum()), float((y**2).sum()))
    moving = enough & (variance_x > still) & (variance_y > still)
    product = np.sqrt(np.where(moving, variance_x * variance_y, 1.0))
    offsets = a[0][0] - b[0][0] + STEP_S * (np.arange(len(n)) - (len(y) - 1))
    return offsets, np.where(moving, (_sliding(x, y) - sum_x * sum_y / n) / product, -1.0)


def _sliding(x: Array, y: Array) -> Array:
    """Return the sums of x[k + s] y[k] for all shifts s from 1 - len(y) to len(x) - 1."""
    from scipy.signal import correlate  # imported here: it takes longer than most commands need to begin

    return np.asarray(correlate(x, y, mode="full", method="fft"))


def _peaks(offsets: Array, correlations: Array) -> list[int]:
    """Return the positions of the highest correlations, each more than half a window from those before it."""
    left = correlations.copy()
    out: list[int] = []
    while len(out) < CANDIDATES and (k := int(np.argmax(left))) >= 0 and left[k] > -1.0:
        out.append(k)
        left[np.abs(offsets - offsets[k]) <= 0.5 * WINDOW_S] = -1.0
    return out


def _refined(a: _Stream, b: _Stream, offset: float, correlation: float) -> tuple[float, TimeOffset] | None:
    """Return the offset near this one that lets the turns themselves, not only their size, agree best, behind the share
    of both that then differs; None where too little is in common."""
    reach, half = 2.0 * STEP_S, 0.5 * WINDOW_S
    margin = reach + GRADIENT_S + half
    t = b[0][(b[0] - half >= b[0][0]) & (b[0] + half <= b[0][-1])]
    t = t[(t + offset - margin >= a[0][0]) & (t + offset + margin <= a[0][-1])]
    if len(t) < MIN_WINDOWS:
        return None
    t = t[:: -(-len(t) // MOST_TURNS)]
    beta = (b[1](t - half) * b[1](t + half).inv()).as_rotvec()
    fits = []
    for to_hand in (False, True):

        def turns(d: float, to_hand: bool = to_hand) -> Array:
            before, after = a[1](t + offset + d - half), a[1](t + offset + d + half)
            return np.asarray((before * after.inv()).as_rotvec() if to_hand else (before.inv() * after).as_rotvec())

        def misfit(d: float, turns: Callable[[float], Array] = turns) -> float:
            alpha = turns(d)
            return float(((alpha - beta @ _aligning(alpha, beta).T) ** 2).sum())

        found = minimize_scalar(misfit, bounds=(-reach, reach), method="bounded", options={"xatol": 1e-7})
        fits.append((float(found.fun), float(found.x), turns))
    least, d, turns = min(fits, key=lambda fit: fit[0])
    both = float((turns(d) ** 2).sum() + (beta**2).sum())
    std = _deviation(turns, beta, d, t)
    return least / max(both, 1e-300), TimeOffset(offset_s=offset + d, std_s=std, correlation=correlation)


def _deviation(turns: Callable[[float], Array], beta: Array, d: float, t: Array) -> float:
    """Return the offset's standard deviation from the scatter of the gradient over blocks of time.

    Windows overlap and share their noise; blocks of two windows hardly do.
    """
    h = GRADIENT_S
    turned = beta @ _aligning(turns(d), beta).T
    low, middle, high = (((turns(x) - turned) ** 2).sum(axis=1) for x in (d - h, d, d + h))
    gradient, curvature = (high - low) / (2.0 * h), float((high - 2.0 * middle + low).sum()) / h**2
    block = ((t - t[0]) / (2.0 * WINDOW_S)).astype(int)
    sums = np.bincount(block, weights=gradient - gradient.mean())
    return float(np.sqrt((sums**2).sum() * len(sums) / max(len(sums) - 2, 1)) / max(curvature, 1e-300))


def _aligning(alpha: Array, beta: Array) -> Array:
    """Return the rotation (3, 3) that turns the vectors beta onto alpha (Kabsch)."""
    U, _, Vt = np.linalg.svd(alpha.T @ beta)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)
