"""How LinuxCNC runs a path on a serial arm (kinematics genserkins), worked out before it does, and its G-code.

In world mode its planner keeps the limits of the axes X Y Z A B C and not those of the joints: what the joints will do
is worked out here. Between two points it moves all six axes in proportion, A B C being roll, pitch and yaw in degrees,
R = Rz(C) Ry(B) Rx(A). Its time law is a trapezoid of speed per line; in continuous mode (G64) each line takes half the
acceleration, and the next one begins while it slows down (LinuxCNC 2.9, src/emc/tp/tp.c: tpGetScaledAccel,
tpComputeBlendVelocity).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from armsight.arrays import Array
from armsight.control.guard.limits import JointBounds
from armsight.control.paths.program import ProgramMove
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm, JointType, in_convention, track_path
from armsight.kinematics.closed_form import singularity_distance
from armsight.units import DEG

FINE_M, FINE_RAD = 2e-3, np.deg2rad(1.0)
"""Steps in which a path is looked at between its rows."""
OFF_M, OFF_RAD = 5e-5, 1e-3
"""How far a line of the program may be from the path: few lines run faster, since each has to be able to stop."""
SAMPLE_S = 4e-3
STOP_S = 0.02
"""A stop between lines that go over into each other otherwise: a change of mode there would let the last line run with
all of the acceleration while the one before slows down with half of it (seen: 39 mm/s of 30)."""
TURNED = 3.0
"""A B C together may turn so many times as far as the tool: near B = 90 degrees A and C turn against each other."""
NEVER = 1e-9
MARGINS = 1.03, 1.2
"""What LinuxCNC may do beyond what is worked out: seen up to 1.01 times the speed and 1.10 times the acceleration."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axes:
    """What LinuxCNC's axes may do, [AXIS_X] to [AXIS_C]: accelerations of X Y Z (m/s^2) and A B C (rad/s^2)."""

    acceleration_m_s2: float
    acceleration_rad_s2: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """One G1: to xyz_m (3,) and abc_rad (3,), unwrapped, at speed, m/s of X Y Z, or where these stand rad/s of A B C.

    blend_m: how far it may pass its end, 0: it stops there. tag: what happens there.
    """

    xyz_m: Array
    abc_rad: Array
    speed: float
    blend_m: float
    tag: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinuxcncPlan:
    """A path as LinuxCNC will run it: lines, the first to where it begins; the joints' readings q (m, n) at t_s (m,).

    speed, acceleration (n,): the largest of each joint, rad/s and rad/s^2. off_m: how far the tip is from the path at
    most. singular: the smallest distance from a singularity on the way.
    """

    lines: tuple[Line, ...]
    t_s: Array
    q: Array
    speed: Array
    acceleration: Array
    off_m: float
    singular: float


def require_genserkins(arm: Arm) -> Arm:
    """Return an arm in Craig's convention, as genserkins takes it. Raises UsageError for one that it cannot be."""
    turning = arm.n == 6 and all(joint.type is JointType.REVOLUTE for joint in arm.joints)
    if not turning or arm.couplings or arm.compliant or any(joint.beta_rad for joint in arm.joints):
        raise UsageError(
            f"{arm.name} is no arm of LinuxCNC's genserkins: six turning joints in Craig's convention, each by itself",
            consequence="No program is written: its inverse would not be this arm's",
            cure="Name the arm that genserkins is set to with --controller, beside the calibrated one",
        )
    return in_convention(arm, "craig")


def plan_lines(
    moves: Sequence[ProgramMove], arm: Arm, controller: Arm, axes: Axes, q_first: Array, turn_rad_s: float
) -> LinuxcncPlan:
    """Return how LinuxCNC will run moves of the tip in base, from readings q_first (6,) of the arm on.

    controller: the arm that genserkins is set to, whose poses are written. Raises Inconsistent where the way between
    rows leaves the arm's branch, or A B C are not those of a steady turn.
    """
    rows, T_tip = _fine(moves)
    q = _tracked(arm, arm.T_world_base.as_matrix() @ T_tip, arm.values(q_first))
    model = require_genserkins(controller)
    # poses (m, 4, 4) of the last frame in LinuxCNC's world
    X = np.asarray(np.linalg.inv(_world(model)) @ model.fk(q) @ model.T_flange_tool.inv().as_matrix())
    xyz, abc = X[:, :3, 3], np.unwrap(Rotation.from_matrix(X[:, :3, :3]).as_euler("xyz"), axis=0)
    _require_steady(X, abc)
    tool = (in_convention(arm, "craig").T_flange_tool if arm.n == 6 else arm.T_flange_tool).as_matrix()
    ends = _thinned(rows, xyz, abc, X @ tool, tool, moves)
    lines = [Line(xyz_m=xyz[0], abc_rad=abc[0], speed=moves[0].speed_m_s, blend_m=0.0, tag=moves[0].tag)]
    for begin, end in pairwise(ends):
        lines.append(_line(moves, rows, T_tip, xyz, abc, begin, end, turn_rad_s))
    t_s, way = time_law(lines, axes)
    driven = _tracked(model, _world(model) @ _matrices(way) @ model.T_flange_tool.as_matrix(), q[0], "as LinuxCNC goes")
    rate = np.gradient(driven, t_s, axis=0)
    singular = np.atleast_1d(singularity_distance(model, driven))
    off = _distances((_matrices(way) @ tool)[:, :3, 3], (X @ tool)[:, :3, 3])
    return LinuxcncPlan(
        lines=tuple(lines),
        t_s=t_s,
        q=np.asarray(model.readings(driven)),
        speed=np.abs(rate).max(axis=0),
        acceleration=np.abs(np.diff(driven, 2, axis=0) / SAMPLE_S**2).max(axis=0, initial=0.0),
        off_m=float(off.max()),
        singular=float(singular.min()),
    )


def require_kept(plan: LinuxcncPlan, arm: Arm, bounds: JointBounds, nearest: float) -> None:
    """Raise Inconsistent where a joint would leave its range, go too fast or pick up speed too fast, or near a
    singularity, nearer than nearest."""
    said: list[str] = []
    for j, joint in enumerate(arm.joints):
        low, high = float(plan.q[:, j].min()), float(plan.q[:, j].max())
        if low < bounds.lower[j] or high > bounds.upper[j]:
            said.append(
                f"{joint.name} would go from {low / DEG:.1f} to {high / DEG:.1f} deg, its range is "
                f"{bounds.lower[j] / DEG:.1f} to {bounds.upper[j] / DEG:.1f}"
            )
        for what, value, most, unit in (
            ("run at", MARGINS[0] * plan.speed[j], bounds.speed[j], "deg/s"),
            ("accelerate at", MARGINS[1] * plan.acceleration[j], bounds.acceleration[j], "deg/s^2"),
        ):
            if value > most:
                said.append(f"{joint.name} would {what} {value / DEG:.1f} {unit}, {most / DEG:.1f} are allowed")
    if plan.singular < nearest:
        said.append(f"it would pass {plan.singular:.3g} from a singularity, {nearest:.3g} is kept")
    if said:
        raise Inconsistent(
            f"in world mode LinuxCNC keeps no joint's limits: {'; '.join(said)}",
            consequence="No program is written",
            cure="Lower the path's speed (--speed-m-s), the axes' accelerations in the INI and here "
            "(--acceleration-m-s2), or place the path elsewhere; --limits says what the joints may",
        )


def _fine(moves: Sequence[ProgramMove]) -> tuple[Array, Array]:
    """Return at which row (m,), in parts, and the poses T_base_tip (m, 4, 4), straight between rows."""
    T = np.array([move.T_base_tip for move in moves])
    far = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    R = Rotation.from_matrix(T[:, :3, :3])
    turn = (R[1:] * R[:-1].inv()).magnitude()
    parts = np.ceil(np.maximum(far / FINE_M, turn / FINE_RAD)).astype(int).clip(1)
    rows = np.concatenate([*(i + np.arange(n) / n for i, n in enumerate(parts.tolist())), [len(moves) - 1.0]])
    made = np.tile(np.eye(4), (len(rows), 1, 1))
    made[:, :3, :3] = Slerp(np.arange(len(moves)), R)(rows).as_matrix()
    made[:, :3, 3] = np.array([np.interp(rows, np.arange(len(moves)), column) for column in T[:, :3, 3].T]).T
    return rows, made


def _tracked(arm: Arm, T_world_tip: Array, start: Array, how: str = "between its rows") -> Array:
    """Return the joints' values (m, n) along poses. Raises Inconsistent for a jump, another branch, out of reach."""
    track = track_path(arm, T_world_tip, start=start)
    grave = [issue for issue in track.issues if issue.trouble.value in ("unreached", "jump", "branch")]
    if grave or len(track.q) < len(T_world_tip):
        why = "; ".join(issue.text for issue in grave[:2]) or "it is not reached to its end"
        raise Inconsistent(
            f"{how} the path leaves the branch of {arm.name}'s inverse that it begins on: {why}",
            consequence="LinuxCNC's inverse would jump there, and no program is written",
            cure="Place the path elsewhere, or begin from another posture (--start)",
        )
    return np.asarray(track.q)


def _world(model: Arm) -> Array:
    """Return T_world_frame0: LinuxCNC's world is the first frame of its table."""
    return np.asarray((model.T_world_base * model.T_base_frame0).as_matrix())


def _matrices(way: Array) -> Array:
    """Return poses (m, 4, 4) of axes (m, 6): X Y Z in m, A B C in rad."""
    T = np.tile(np.eye(4), (len(way), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_euler("xyz", way[:, 3:]).as_matrix(), way[:, :3]
    return T


def _require_steady(X: Array, abc: Array) -> None:
    R = Rotation.from_matrix(X[:, :3, :3])
    turn = np.atleast_1d((R[1:] * R[:-1].inv()).magnitude())
    axes = np.abs(np.diff(abc, axis=0)).max(axis=1)
    if len(turn) and (axes > TURNED * turn + 0.1 * FINE_RAD).any():
        k = int(np.argmax(axes - TURNED * turn))
        raise Inconsistent(
            f"the flange passes near B = 90 degrees (B = {abc[k, 1] / DEG:.1f}), where A and C turn against each other",
            consequence="LinuxCNC would turn the tool otherwise than the path does, and no program is written",
            cure="Place the arm's base or the flange otherwise in the world, or the path",
        )


def _thinned(rows: Array, xyz: Array, abc: Array, T_tip: Array, tool: Array, moves: Sequence[ProgramMove]) -> list[int]:
    """Return which of the fine poses (m,) lines of the program join, within OFF_M and OFF_RAD of the path."""
    whole = {round(row): k for k, row in enumerate(rows.tolist()) if row == round(row)}
    last = len(moves) - 1
    kept = [0]
    for row in range(1, last + 1):
        speeds = moves[row].speed_m_s != moves[min(row + 1, last)].speed_m_s
        if moves[row].tag or speeds or row in (1, last - 1, last):
            kept.append(whole[row])
    ends = [0]
    for end in kept[1:]:
        while ends[-1] != end:
            begin, reach = ends[-1], end
            while reach > begin + 1 and not _straight(begin, reach, xyz, abc, T_tip, tool):
                reach = begin + max((reach - begin) // 2, 1)
            step = (end - reach + 1) // 2
            while step and reach < end:  # back up to the farthest that does
                if reach + step <= end and _straight(begin, reach + step, xyz, abc, T_tip, tool):
                    reach += step
                else:
                    step //= 2
            ends.append(reach)
    return ends


def _straight(begin: int, end: int, xyz: Array, abc: Array, T_tip: Array, tool: Array) -> bool:
    """Tell whether LinuxCNC's straight way between two of the poses keeps near all in between."""
    part = slice(begin, end + 1)
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz[part], axis=0), axis=1))])
    if far[-1] < NEVER:
        far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(abc[part], axis=0), axis=1))])
    share = (far / max(far[-1], NEVER))[:, None]
    axes = np.concatenate([xyz, abc], axis=1)
    way = _matrices(axes[begin] + share * (axes[end] - axes[begin])) @ tool
    turn = (Rotation.from_matrix(way[:, :3, :3]) * Rotation.from_matrix(T_tip[part, :3, :3]).inv()).magnitude()
    off = np.linalg.norm(way[:, :3, 3] - T_tip[part, :3, 3], axis=1)
    return bool(off.max() <= OFF_M and turn.max() <= OFF_RAD)


def _line(
    moves: Sequence[ProgramMove], rows: Array, T_tip: Array, xyz: Array, abc: Array, begin: int, end: int, turn: float
) -> Line:
    """Return the line between two fine poses: as fast as takes the tip along its way at the path's speed."""
    move = moves[int(np.ceil(rows[end]))]
    tip_m = float(np.linalg.norm(np.diff(T_tip[begin : end + 1, :3, 3], axis=0), axis=1).sum())
    R = Rotation.from_matrix(T_tip[[begin, end], :3, :3])
    took_s = max(tip_m / move.speed_m_s, float((R[1] * R[0].inv()).magnitude()) / turn)
    far_m, wide_rad = (float(np.linalg.norm(axes[end] - axes[begin])) for axes in (xyz, abc))
    at_row = rows[end] == round(rows[end])
    last = end == len(rows) - 1 or (at_row and move.tag != "")
    return Line(
        xyz_m=xyz[end],
        abc_rad=abc[end],
        speed=(far_m if far_m > NEVER else wide_rad) / max(took_s, SAMPLE_S),
        blend_m=0.0 if last or (at_row and move.blend_m == 0.0) else max(each.blend_m for each in (move, *moves)),
        tag=move.tag if at_row else "",
    )


def time_law(lines: Sequence[Line], axes: Axes) -> tuple[Array, Array]:
    """Return times t_s (m,) and axes (m, 6), m and rad, as LinuxCNC's planner runs lines behind the first."""
    points = np.array([[*line.xyz_m, *line.abc_rad] for line in lines])
    steps = np.diff(points, axis=0)
    blends = np.array([line.blend_m for line in lines[1:]])
    far = np.linalg.norm(steps[:, :3], axis=1)
    long = np.where(far > NEVER, far, np.linalg.norm(steps[:, 3:], axis=1))
    most = np.repeat([axes.acceleration_m_s2, axes.acceleration_rad_s2], 3)
    acceleration = long / np.maximum((np.abs(steps) / most).max(axis=1), NEVER)
    if continuous := bool((blends > 0.0).any()):
        acceleration = 0.5 * acceleration
    speed = np.minimum([line.speed for line in lines[1:]], np.sqrt(acceleration * long))
    lasts = long / speed + speed / acceleration
    over = _overlaps(steps, long, speed, acceleration, blends) - (STOP_S if continuous else 0.0) * (blends[:-1] <= 0.0)
    starts = np.concatenate([[0.0], np.cumsum(lasts[:-1] - over)])
    t_s = np.asarray(SAMPLE_S * np.arange(int(np.ceil((starts + lasts).max() / SAMPLE_S)) + 2), dtype=np.float64)
    way = np.tile(points[0], (len(t_s), 1))
    for step, start, last, v, a, d in zip(steps, starts, lasts, speed, acceleration, long, strict=True):
        t = np.clip(t_s - start, 0.0, last)
        ramp = v / a
        begun, ended = np.minimum(t, ramp), np.maximum(t - (last - ramp), 0.0)
        way += ((0.5 * a * begun**2 + v * np.maximum(t - ramp, 0.0) - 0.5 * a * ended**2) / d)[:, None] * step
    return t_s, way


def _overlaps(steps: Array, long: Array, speed: Array, acceleration: Array, blends: Array) -> Array:
    """Return how long (m - 1,) before a line's end the next one begins."""
    found = np.zeros(max(len(steps) - 1, 0))
    for k in range(len(found)):
        if blends[k] <= 0.0:
            continue
        pair = slice(k, k + 2)
        reachable = float((long[pair] / speed[pair]).min())
        t_blend = min(reachable, float((speed[pair] / acceleration[pair]).max()))
        slow = min(float(speed[k]), t_blend * float(acceleration[k]))
        one, two = (steps[i, :3] / max(float(np.linalg.norm(steps[i, :3])), NEVER) for i in (k, k + 1))
        half = 0.5 * float(np.arccos(np.clip(one @ two, -1.0, 1.0)))
        if np.cos(0.5 * np.pi - half) > 1e-3:
            slow = min(slow, 2.0 * float(np.sqrt(acceleration[k] * blends[k] / np.sin(half))))
        found[k] = slow / acceleration[k]
    return found


def _distances(points: Array, path: Array) -> Array:
    """Return the distances (m,) of points (m, 3) from a path (k, 3) of straight pieces."""
    if len(path) < 2:
        return np.asarray(np.linalg.norm(points - path[0], axis=1))
    found = np.full(len(points), np.inf)
    for a, b in pairwise(path):
        way = b - a
        share = np.clip((points - a) @ way / max(float(way @ way), NEVER**2), 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(points - a - share[:, None] * way, axis=1))
    return found
