"""A path offset along the tool, tilted, reversed, or joined to another."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.control.paths.along import WINDOW_M, moving, positions_at
from armsight.errors import Degenerate, Inconsistent, UsageError
from armsight.records import WELD_OFF, WELD_ON, TaughtPath
from armsight.units import DEG

GAP_M = 1e-3
GAP_RAD = 5.0 * DEG
LEAST_RAD = 5.0 * DEG
"""Between the tool's axis and the path's direction; below it the plane of both is not known."""
MOST_TILT_RAD = 80.0 * DEG
MOST_OFFSET_M = 2.0
"""No tool stands further off its work; millimetres taken for metres go beyond."""


def offset_along_tool(path: TaughtPath, by_m: float) -> TaughtPath:
    """Return the path with every pose moved by by_m along its own tool axis z; negative: back from the work.

    Raises UsageError where by_m is not finite, or beyond MOST_OFFSET_M.
    """
    if not math.isfinite(by_m):
        raise UsageError(f"an offset of {by_m:g} m is none", consequence="The path is left as it is")
    if abs(by_m) > MOST_OFFSET_M:
        raise UsageError(
            f"an offset of {by_m:g} m is beyond {MOST_OFFSET_M:g} m",
            consequence="The path is left as it is",
            cure="Give it in m; 10 mm are 0.01",
        )
    T = path.T_world_tip.copy()
    T[:, :3, 3] += by_m * T[:, :3, 2]
    return replace(path, T_world_tip=T)


def tilted(
    path: TaughtPath, *, travel_rad: float = 0.0, work_rad: float = 0.0, window_m: float = WINDOW_M
) -> TaughtPath:
    """Return the path with the tool tilted about its tip, which stays where it is.

    travel_rad turns the tool axis z toward the path's direction t, about z x t: positive points ahead (pushes),
    negative back (drags). work_rad then turns it about t, right-handed. t is the chord over window_m on both sides.
    Raises UsageError for a tilt beyond MOST_TILT_RAD, Degenerate where the tool lies along the path, or where the
    path turns back so that it has no direction.
    """
    for angle in (travel_rad, work_rad):
        if not abs(angle) <= MOST_TILT_RAD:
            raise UsageError(
                f"a tilt of {angle / DEG:g} deg is beyond {MOST_TILT_RAD / DEG:g} deg",
                consequence="The path is left as it is",
                cure="Give the angle in the unit asked for, and a smaller one",
            )
    s = moving(path)
    chord = positions_at(path, np.minimum(s + window_m, s[-1])) - positions_at(path, np.maximum(s - window_m, 0.0))
    length = np.linalg.norm(chord, axis=1)
    z = path.T_world_tip[:, :3, 2]
    axis = np.cross(z, chord / np.maximum(length, 1e-12)[:, None])
    sine = np.linalg.norm(axis, axis=1)
    lost = (length < 1e-9) | (sine < math.sin(LEAST_RAD))
    if lost.any():
        row = int(np.argmax(lost))
        raise Degenerate(
            f"row {row}: the tool lies along the path, or the path turns back there",
            consequence="Nobody can tell which way to tilt",
            cure="Split the path there, or turn the tool first",
        )
    ahead = Rotation.from_rotvec(travel_rad * axis / sine[:, None])
    aside = Rotation.from_rotvec(work_rad * chord / length[:, None])
    T = path.T_world_tip.copy()
    T[:, :3, :3] = (aside * ahead * Rotation.from_matrix(T[:, :3, :3])).as_matrix()
    return replace(path, T_world_tip=T)


def reversed_path(path: TaughtPath) -> TaughtPath:
    """Return the path from its end to its start, without times.

    weld_on and weld_off change places, so that the same stretches are welded. A row's speed is that of the way behind
    it, so that each stretch keeps its own.
    """
    swap = {WELD_ON: WELD_OFF, WELD_OFF: WELD_ON}
    speed = path.speed_m_s[::-1]
    return replace(
        path,
        T_world_tip=path.T_world_tip[::-1],
        t_s=np.full(len(path), np.nan),
        speed_m_s=np.concatenate([speed[1:], speed[:1]]),
        tags=tuple(swap.get(tag, tag) for tag in reversed(path.tags)),
    )


def joined(first: TaughtPath, second: TaughtPath, *, gap_m: float = GAP_M, gap_rad: float = GAP_RAD) -> TaughtPath:
    """Return both paths one after the other, without times.

    Where the ends are at one position the second's first row is left out, and its tag and speed go to the row before
    it. Raises Inconsistent where the ends are further apart than gap_m and gap_rad, the frames differ, a path is empty,
    or both rows that become one have a tag.
    """
    if not len(first) or not len(second) or first.parent != second.parent:
        raise Inconsistent(
            f"paths of {len(first)} rows in {first.parent} and {len(second)} rows in {second.parent} make no path",
            consequence="They are not joined",
        )
    way = float(np.linalg.norm(second.xyz_m[0] - first.xyz_m[-1]))
    turn = float((first.poses[-1].rotation.inv() * second.poses[0].rotation).magnitude())
    if not (way <= gap_m and turn <= gap_rad):
        raise Inconsistent(
            f"the second path begins {way:.4g} m and {turn / DEG:.3g} deg from the first one's end",
            consequence="They are not joined: the tool would cross the gap untaught",
            cure="Teach the way between them, reverse one of them, or allow a wider gap",
        )
    tags, speed, cut = list(first.tags), first.speed_m_s.copy(), 0
    if way < 1e-9:
        if tags[-1] and second.tags[0] and tags[-1] != second.tags[0]:
            raise Inconsistent(
                f"the ends are at one place with the tags {tags[-1]} and {second.tags[0]}",
                consequence="They are not joined",
                cure="Take one of the tags away",
            )
        tags[-1], speed[-1], cut = tags[-1] or second.tags[0], second.speed_m_s[0], 1
    T = np.concatenate([first.T_world_tip, second.T_world_tip[cut:]])
    return replace(
        first,
        T_world_tip=T,
        t_s=np.full(len(T), np.nan),
        speed_m_s=np.concatenate([speed, second.speed_m_s[cut:]]),
        tags=(*tags, *second.tags[cut:]),
    )
