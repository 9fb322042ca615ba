"""A path by its length: sampled anew, corners, offset along the tool, tilted, reversed, joined; a scene's points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation, Slerp

from armsight.arrays import Array
from armsight.defaults import PATH_GAP_M, PATH_GAP_RAD
from armsight.errors import Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.records import WELD_OFF, WELD_ON, TaughtPath
from armsight.units import DEG

CORNER_RAD = 40.0 * DEG
"""A path that turns by more than this within twice the window has a corner there."""
WINDOW_M = 0.01
"""Length before and after a row over which its directions are taken; noise of 0.1 mm turns them by half a degree."""
OWN_WAY = 0.25
"""Share of the window that a corner's neighbours are away where two corners share a window."""
MOST_ROWS = 200_000


def positive(name: str, value: float) -> float:
    """Return a value that must be a finite number above zero; raises UsageError otherwise."""
    if not (math.isfinite(value) and value > 0.0):
        raise UsageError(f"{name} is {value:g}, which is no length above zero", cure="Give it in m")
    return value


def moving(path: TaughtPath) -> Array:
    """Return the length (n,) up to each row of a path that always moves. Raises NotEnoughData, Inconsistent."""
    if len(path) < 2:
        raise NotEnoughData(f"a path of {len(path)} poses has no length", cure="Give at least two poses")
    still = np.diff(path.length_m) <= 0.0
    if still.any():
        row = int(np.argmax(still))
        raise Inconsistent(
            f"rows {row} and {row + 1} of the path are at one place",
            consequence="It has no direction there",
            cure="Leave one of them out",
        )
    return path.length_m


def positions_at(path: TaughtPath, s_m: Array) -> Array:
    """Return the positions (k, 3) at lengths s_m (k,) along the straight stretches of a path."""
    return np.stack([np.interp(s_m, path.length_m, path.xyz_m[:, k]) for k in range(3)], axis=1)


def poses_at(path: TaughtPath, s_m: Array) -> Array:
    """Return the poses (k, 4, 4) at lengths s_m (k,): positions linear, rotations by slerp (Shoemake 1985)."""
    length = moving(path)
    s = np.clip(s_m, 0.0, length[-1])
    turns = Slerp(length, Rotation.from_matrix(path.T_world_tip[:, :3, :3]))(s)
    return np.asarray(RigidTransform.from_components(positions_at(path, s), turns).as_matrix())


def turning(path: TaughtPath, *, window_m: float = WINDOW_M) -> Array:
    """Return the angle (n,) in rad between the chords over window_m before and after each row; 0 at both ends."""
    s = moving(path)
    back = positions_at(path, np.maximum(s - positive("window_m", window_m), 0.0))
    ahead = positions_at(path, np.minimum(s + window_m, s[-1]))
    before, after = (path.xyz_m - back)[1:-1], (ahead - path.xyz_m)[1:-1]
    angle = np.zeros(len(s))
    sine = np.linalg.norm(np.cross(before, after), axis=1)
    angle[1:-1] = np.arctan2(sine, np.sum(before * after, axis=1))
    return angle


def corners(path: TaughtPath, *, angle_rad: float = CORNER_RAD, window_m: float = WINDOW_M) -> tuple[int, ...]:
    """Return the rows at which the path turns by more than angle_rad, the sharpest of each window_m; ends are none.

    Within a window a second row is a corner where both its neighbours are a quarter of the window away, as in paths
    of few rows: there it is its own turn and not the first corner's, or noise.
    """
    s, angle = moving(path), turning(path, window_m=window_m)
    found: list[int] = []
    for row in np.argsort(-angle, kind="stable"):
        if angle[row] <= angle_rad:
            break
        if all(
            abs(s[row] - s[other]) > window_m or _corner_of_its_own(path, row, other, angle_rad, OWN_WAY * window_m)
            for other in found
        ):
            found.append(int(row))
    return tuple(sorted(found))


def _corner_of_its_own(path: TaughtPath, row: int, other: int, angle_rad: float, least_m: float) -> bool:
    """Tell whether a row near another corner is one too: it turns by itself, between ways too long for noise."""
    before, after = np.diff(path.xyz_m[row - 1 : row + 2], axis=0)
    if min(np.linalg.norm(before), np.linalg.norm(after)) < least_m:
        return False
    own = math.atan2(float(np.linalg.norm(np.cross(before, after))), float(before @ after))
    return row != other and own > angle_rad


def resampled(
    path: TaughtPath, step_m: float, *, spline: bool = False, keep: Sequence[int] | None = None
) -> TaughtPath:
    """Return the path with rows at most step_m apart, evenly spread between rows that are kept.

    Kept are both ends, rows with a tag, and the rows keep (its corners where None). Positions between the old rows lie
    on straight lines, or with spline on a cubic spline over chord length that is broken at kept rows; rotations are
    slerped. Speeds are those of the old row before; times are interpolated where every row has one. Raises
    UsageError for a step that is no length or gives more than MOST_ROWS rows, Inconsistent where the path stands.
    """
    s = moving(path)
    if step_m > s[-1]:
        raise UsageError(
            f"a step of {step_m:g} m is longer than the path, {s[-1]:.3g} m",
            consequence="Nothing but its ends and corners would be left",
            cure="Give a shorter step, in m",
        )
    if s[-1] / positive("step_m", step_m) > MOST_ROWS:
        raise UsageError(f"steps of {step_m:g} m give more than {MOST_ROWS} rows", cure="Take a longer step")
    chosen = corners(path) if keep is None else keep
    tagged = [row for row, tag in enumerate(path.tags) if tag]
    kept = sorted({0, len(path) - 1, *(range(len(path))[row] for row in chosen), *tagged})
    at, rows = [s[:1]], [0]
    for a, b in itertools.pairwise(kept):
        count = max(1, math.ceil((s[b] - s[a]) / step_m - 1e-9))
        at.append(np.linspace(s[a], s[b], count + 1)[1:])
        rows.append(rows[-1] + count)
    wanted = np.concatenate(at)
    T = poses_at(path, wanted)
    if spline:
        for (a, b), (i, j) in zip(itertools.pairwise(kept), itertools.pairwise(rows), strict=True):
            if b - a > 1:
                T[i : j + 1, :3, 3] = CubicSpline(s[a : b + 1], path.xyz_m[a : b + 1])(wanted[i : j + 1])
    for old, new in zip(kept, rows, strict=True):
        T[new] = path.T_world_tip[old]
    tags = [""] * len(wanted)
    for old, new in zip(kept, rows, strict=True):
        tags[new] = path.tags[old]
    return with_poses(path, T, wanted, tuple(tags))


def with_poses(path: TaughtPath, T: Array, s_m: Array, tags: tuple[str, ...]) -> TaughtPath:
    """Return a path of poses T (k, 4, 4) that belong to lengths s_m (k,) of path, with its times and speeds there."""
    s = path.length_m
    known = bool(np.isfinite(path.t_s).all())
    t_s = np.interp(s_m, s, path.t_s) if known else np.full(len(s_m), np.nan)
    row = np.clip(np.searchsorted(s, s_m + 1e-12, side="right") - 1, 0, len(s) - 1)
    return replace(path, T_world_tip=T, t_s=t_s, speed_m_s=path.speed_m_s[row], tags=tags)


def along_edges(uv_px: Array, edges: Sequence[str], step_px: float) -> tuple[Array, NDArray[np.intp]]:
    """Return pixels (m, 2) with more of them between neighbours of one edge, and of which pick (m,) each is.

    Neighbours are at most step_px apart then; a pixel between two picks is of the one before it. Raises UsageError for
    a step that is none.
    """
    positive("step_px", step_px)
    out, rows = [], []
    for i, here in enumerate(uv_px):
        out.append(here[None])
        rows.append(i)
        if i + 1 < len(uv_px) and edges[i] and edges[i] == edges[i + 1]:
            count = math.ceil(float(np.linalg.norm(uv_px[i + 1] - here)) / step_px - 1e-9)
            share = np.arange(1, count)[:, None] / max(count, 1)
            out.append(here + share * (uv_px[i + 1] - here))
            rows += [i] * len(share)
    return np.concatenate(out), np.array(rows, dtype=np.intp)


def path_through_points(xyz_m: Array, tool_axis: Array, *, parent: str) -> TaughtPath:
    """Return the path through points (n, 3) with the tool's z along tool_axis (3,), all in the frame parent.

    The tool's x is the frame's x, or its y where that lies along the tool, made square to z. Raises UsageError for an
    axis without a direction.
    """
    length = float(np.linalg.norm(tool_axis))
    if not (math.isfinite(length) and length > 1e-9):
        raise UsageError("the tool's axis has no direction", cure="Give three numbers, for instance 0,0,-1")
    z = tool_axis / length
    nearest = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = nearest - (nearest @ z) * z
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1)
    turns = Rotation.from_matrix(np.repeat(R[None], len(xyz_m), axis=0))
    return TaughtPath.of_poses(RigidTransform.from_components(xyz_m, turns), parent=parent)


LEAST_RAD = 5.0 * DEG
"""Between the tool's axis and the path's direction; below it the plane of both is not known."""
MOST_TILT_RAD = 80.0 * DEG
MOST_OFFSET_M = 2.0
"""No tool stands further off its work; millimetres taken for metres go beyond."""


def offset_along_tool(path: TaughtPath, by_m: float) -> TaughtPath:
    """Return the path moved by by_m along the tools' own z, negative: back. Raises UsageError beyond MOST_OFFSET_M."""
    if not math.isfinite(by_m):
        raise UsageError(f"an offset of {by_m:g} m is none")
    if abs(by_m) > MOST_OFFSET_M:
        raise UsageError(f"an offset of {by_m:g} m is beyond {MOST_OFFSET_M:g} m", cure="Give it in m; 10 mm are 0.01")
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


def joined(
    first: TaughtPath, second: TaughtPath, *, gap_m: float = PATH_GAP_M, gap_rad: float = PATH_GAP_RAD
) -> TaughtPath:
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
