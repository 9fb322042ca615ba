"""Pose pairs out of two time-stamped streams that nobody has paired."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Slerp

from armsight.calibrate.handeye.pairs import MIN_PAIRS, Array, PosePairs
from armsight.calibrate.handeye.timing import TimeOffset, time_offset
from armsight.errors import NotEnoughData
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
    place = np.stack([np.interp(at, tr, column) for column in robot.translation.T], axis=1)
    flange = RigidTransform.from_components(place, turn)
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
