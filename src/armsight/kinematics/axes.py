"""An arm from its joints' frames in space, as URDF gives them, and back; exact both ways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import atan2, cos, hypot, inf, pi, sin

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.kinematics.arm import Arm
from armsight.kinematics.forward_kinematics import in_convention, link_frames
from armsight.kinematics.joints import Convention, Joint, JointType, link_matrix

SAME = 1e-12
"""Frames that agree to this (m, rad) are the same to rounding."""


ROUNDING = 1e-14
"""Parameters (m, rad) below this are the rounding of products of rotations."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisJoint:
    """A joint as URDF has it: T_parent_joint (4, 4) to the link before, axis (3,) in its own frame, limits.

    mass_kg, com_m: of what it carries up to the next joint, its centre of mass (3,) in the joint's frame.
    """

    name: str
    type: JointType
    T_parent_joint: Array
    axis: Array
    lower: float = -inf
    upper: float = inf
    max_speed: float | None = None
    stall_effort: float | None = None
    mass_kg: float = 0.0
    com_m: Array = field(default_factory=lambda: np.zeros(3))

    def started_at(self, value: float) -> AxisJoint:
        """Return the joint with its zero where its value is now this, in rad or m."""
        step = np.eye(4)
        if self.type is JointType.REVOLUTE:
            step[:3, :3] = Rotation.from_rotvec(value * self.axis).as_matrix()
        else:
            step[:3, 3] = value * self.axis
        return replace(
            self, T_parent_joint=self.T_parent_joint @ step, lower=self.lower - value, upper=self.upper - value
        )


def arm_from_axes(
    name: str, T_world_base: Array, joints: Sequence[AxisJoint], T_last_flange: Array, T_flange_tool: Array
) -> Arm:
    """Return the arm in standard Denavit-Hartenberg form whose poses are those of the axes, to rounding.

    All (4, 4): T_world_base of the model's root, which the first joint's frame is given in, T_last_flange of the flange
    in the last joint's frame. base stays the root; frame 0 of the table is put on the first joint's axis.
    Joint values keep their zero and their sense. Where a frame is already one of Denavit and Hartenberg's its
    parameters come back as they are; nearly parallel axes get a beta. Raises Inconsistent for an axis that is not of
    unit length.
    """
    lines = []
    at = np.eye(4)
    for joint in joints:
        at = at @ joint.T_parent_joint
        lines.append((at, *_direction(joint)))
    frame0 = frame = _first_frame(lines[0][0], lines[0][1])
    rows: list[Joint] = []
    for k, joint in enumerate(joints):
        here, _, sign = lines[k]
        if k + 1 < len(joints):
            there, direction, _ = lines[k + 1]
            link = link_to_line(frame, there[:3, 3], there[:3, :3] @ direction, x_hint=here[:3, 0])
            theta, d, a, alpha, beta = link.theta_rad, link.d_m, link.a_m, link.alpha_rad, link.beta_rad
            frame = frame @ link.matrix()
        else:
            theta, d, a, alpha, T_flange_tool = _last_link(frame, here @ T_last_flange, T_flange_tool)
            beta = 0.0
        rows.append(_row(joint, sign, a, alpha, d, theta, beta))
    arm = Arm(
        name=name,
        joints=tuple(rows),
        T_world_base=RigidTransform.from_matrix(T_world_base),
        T_base_frame0=RigidTransform.from_matrix(frame0),
        T_flange_tool=RigidTransform.from_matrix(T_flange_tool),
    )
    return _loaded(arm, joints, [T_world_base @ here for here, _, _ in lines])


def in_short_rows(arm: Arm) -> Arm:
    """Return the same arm with beta on nearly parallel axes (Hayati), where d of a plain table runs to hundreds of m.

    In standard convention; joint values keep zero and sense, covariance is dropped. Raises Inconsistent for scales.
    """
    T_world_base, joints, last, tool = axes_of(arm)
    short = arm_from_axes(arm.name, T_world_base, joints, last, tool)
    before, after = (
        link_frames(one, np.zeros(arm.n))[1:-1] for one in (in_convention(arm, Convention.STANDARD), short)
    )
    rows = [
        replace(
            row,
            compliance=joint.compliance,
            driven=joint.driven,
            mass_kg=joint.mass_kg,
            com_m=tuple((np.linalg.solve(new, old) @ [*joint.com_m, 1.0])[:3].tolist()),
        )
        for row, joint, old, new in zip(short.joints, arm.joints, before, after, strict=True)
    ]
    T = short.T_flange_tool * arm.T_flange_tool.inv()  # of the flange, as the whole behind the last joint is the same
    return replace(
        arm,
        joints=tuple(rows),
        convention=Convention.STANDARD,
        T_base_frame0=short.T_base_frame0,
        T_flange_tool=short.T_flange_tool,
        covariance=None,
        tool_points=tuple(point.seen_from(T) for point in arm.tool_points),
    )


def in_plain_rows(arm: Arm, like: Arm) -> Arm:
    """Return the same arm in rows without beta from its frame 0, the last one that of `like` in a and alpha.

    What that last row does not say goes into the tool; x axes point as those of `like`. d of nearly parallel axes runs
    to hundreds of m. Joints turn forwards in both. Raises Inconsistent for a joint with a scale.
    """
    _, joints, last, tool = axes_of(arm)
    at, rows = np.eye(4), []
    lines = [at := at @ joint.T_parent_joint for joint in joints]
    frame = frame0 = in_convention(arm, Convention.STANDARD).T_base_frame0.as_matrix()
    nominal = link_frames(like.based(), np.zeros(like.n))[1:-1]
    for k, joint in enumerate(joints[:-1]):
        there, hint = lines[k + 1], frame0[:3, :3] @ nominal[k][:3, 0]
        link = link_to_line(frame, there[:3, 3], there[:3, :3] @ joints[k + 1].axis, x_hint=hint, plain=True)
        frame = frame @ link.matrix()
        rows.append(_row(joint, 1.0, link.a_m, link.alpha_rad, link.d_m, link.theta_rad, 0.0))
    end = like.joints[-1]
    rows.append(_row(joints[-1], 1.0, end.a_m, end.alpha_rad, end.d_m, end.theta_rad, 0.0))
    bottom = link_matrix(end.a_m, end.alpha_rad, 0.0)
    bottom[2, 3] += end.d_m
    flange = frame @ _turn_z(end.theta_rad) @ bottom
    return replace(
        arm,
        joints=tuple(rows),
        convention=Convention.STANDARD,
        T_world_base=arm.T_world_base * RigidTransform.from_matrix(frame0),
        T_base_frame0=RigidTransform.identity(),
        T_flange_tool=RigidTransform.from_matrix(np.linalg.solve(flange, lines[-1] @ last @ tool)),
        covariance=None,
        tool_points=(),
    )


def _loaded(arm: Arm, joints: Sequence[AxisJoint], T_world_joint: Sequence[Array]) -> Arm:
    if not any(joint.mass_kg for joint in joints):
        return arm
    behind = np.linalg.inv(link_frames(arm, np.zeros(arm.n))[1:-1])
    centres = [
        (T @ here)[:3] @ [*joint.com_m, 1.0] for T, here, joint in zip(behind, T_world_joint, joints, strict=True)
    ]
    rows = [
        replace(row, mass_kg=joint.mass_kg, com_m=tuple(com_m.tolist()))
        for row, joint, com_m in zip(arm.joints, joints, centres, strict=True)
    ]
    return replace(arm, joints=tuple(rows))


def _row(joint: AxisJoint, sign: float, a: float, alpha: float, d: float, theta: float, beta: float) -> Joint:
    """Return a joint with its parameters (m, rad) in the table, zero where they are zero but for rounding."""
    return Joint(
        name=joint.name,
        type=joint.type,
        a_m=_clean(a),
        alpha_rad=_clean(alpha),
        d_m=_clean(d),
        theta_rad=_clean(theta),
        beta_rad=_clean(beta),
        lower=joint.lower,
        upper=joint.upper,
        sign=sign,
        max_speed=joint.max_speed,
        stall_effort=joint.stall_effort,
    )


def axes_of(arm: Arm) -> tuple[Array, list[AxisJoint], Array, Array]:
    """Return what `arm_from_axes` takes after the name, axes along z. Raises Inconsistent for a joint with a scale."""
    standard = in_convention(arm, Convention.STANDARD)
    before = standard.T_base_frame0.as_matrix()
    out = []
    for joint in standard.joints:
        if abs(joint.sign) != 1.0:
            raise Inconsistent(
                f"joint {joint.name} has the scale {abs(joint.sign):g}",
                consequence="URDF has no place for it",
                cure="Keep this arm as arm.yaml",
            )
        out.append(
            AxisJoint(
                name=joint.name,
                type=joint.type,
                T_parent_joint=before @ _turn_z(joint.theta_rad),
                axis=np.array([0.0, 0.0, joint.sign]),
                lower=joint.lower,
                upper=joint.upper,
                max_speed=joint.max_speed,
                stall_effort=joint.stall_effort,
            )
        )
        before = link_matrix(joint.a_m, joint.alpha_rad, joint.beta_rad)
        before[2, 3] += joint.d_m
    return standard.T_world_base.as_matrix(), out, before, standard.T_flange_tool.as_matrix()


def links_told(arm: Arm) -> tuple[str, ...]:
    """Return which links of a URDF base and tool are, as a sentence; nothing for an arm that has none by name."""
    if not (arm.base_link and arm.tool_link):
        return ()
    return (f"base is the link {arm.base_link}, the tool the link {arm.tool_link}",)


def _clean(value: float) -> float:
    """Return zero for what is zero but for rounding."""
    return 0.0 if abs(value) < ROUNDING else float(value)


def _turn_z(angle_rad: float) -> Array:
    T = np.eye(4)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    T[:2, :2] = [[c, -s], [s, c]]
    return T


def _direction(joint: AxisJoint) -> tuple[Array, float]:
    """Return the direction of the DH z axis in the joint's frame, and the sign with which the joint moves along it."""
    axis = unit_direction(joint.axis, f"the axis of joint {joint.name}")
    if np.array_equal(axis, [0.0, 0.0, -1.0]):
        return -axis, -1.0
    return axis, 1.0


def _first_frame(T_base_joint: Array, axis: Array) -> Array:
    """Return frame 0 in base: the base where its z axis is joint 1's, else the joint's frame turned to its axis."""
    z = T_base_joint[:3, :3] @ axis
    off = np.linalg.norm(np.cross(z, T_base_joint[:3, 3]))
    if np.linalg.norm(z - [0.0, 0.0, 1.0]) < SAME and off < SAME:
        return np.eye(4)
    frame = T_base_joint.copy()
    if np.linalg.norm(frame[:3, 2] - z) > 0.0:
        side = frame[:3, int(np.abs(frame[:3, :3].T @ z).argmin())]
        x = side - (side @ z) * z
        x /= np.linalg.norm(x)
        frame[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    return frame


def _last_link(frame: Array, T_world_flange: Array, T_flange_tool: Array) -> tuple[float, float, float, float, Array]:
    """Return theta, d, a, alpha of the last row, and the tool, which takes the flange where the row cannot."""
    X = np.linalg.inv(frame) @ T_world_flange
    theta = atan2(X[1, 0], X[0, 0])
    c, s = np.cos(theta), np.sin(theta)
    across = -s * X[0, 3] + c * X[1, 3]
    if abs(X[2, 0]) < SAME and abs(across) < SAME:
        a = float(c * X[0, 3] + s * X[1, 3])
        return theta, float(X[2, 3]), a, atan2(X[2, 1], X[2, 2]), T_flange_tool
    return 0.0, 0.0, 0.0, 0.0, X @ T_flange_tool


# From the joints' axes in space to Denavit-Hartenberg parameters (MATH 4.5, Hartenberg and Denavit, Hayati 1983).

PARALLEL_SINE = 1e-12
"""Axes that differ by less are parallel to rounding: their common normal would be noise, and 1e-12 rad is nothing."""

HAYATI_SINE = 0.02
"""Below this angle (about one degree) d of the common normal runs away, so a turn beta about y takes its place."""

SAME_LINE_M = 1e-12
"""Lines closer than this coincide: the direction of their normal is free."""

UNIT_TOLERANCE = 1e-6
"""An axis whose length differs from one by more is not a direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) from one axis to the next; case says which formulas gave it."""

    theta_rad: float
    d_m: float
    a_m: float
    alpha_rad: float
    beta_rad: float
    case: str

    def matrix(self) -> Array:
        """Return the step as a (4, 4) matrix."""
        c, s = cos(self.theta_rad), sin(self.theta_rad)
        ca, sa, cb, sb = cos(self.alpha_rad), sin(self.alpha_rad), cos(self.beta_rad), sin(self.beta_rad)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, self.d_m], [0, 0, 0, 1.0]])
        link = np.array([[cb, 0, sb, self.a_m], [sa * sb, ca, -sa * cb, 0], [-ca * sb, sa, ca * cb, 0], [0, 0, 0, 1.0]])
        return np.asarray(turn @ link)


def link_to_line(
    T: ArrayLike,
    point_m: ArrayLike,
    direction: ArrayLike,
    *,
    x_hint: ArrayLike | None = None,
    prismatic: bool = False,
    plain: bool = False,
) -> Link:
    """Return the link whose far z axis is the line (point, direction), seen from the frame T (4, 4) at its near axis.

    point_m (3,), direction (3,) of unit length and T are in the same axes. x_hint (3,): the side to which the far x
    axis should point (its sign is free) and its direction where the lines coincide; default the x axis of T.
    prismatic: the far joint is, whose place is free; the line is then put through the origin of T (a = d = 0).
    plain: no beta on nearly parallel axes, whose d then runs away.
    For parallel axes d is free and taken as that of the point. Raises Inconsistent for a direction not of unit length.
    MATH 4.5 and C7.
    """
    frame = np.asarray(T, float)
    R, o = frame[:3, :3], frame[:3, 3]
    v = R.T @ unit_direction(direction)  # (3,) in the near frame
    p = np.zeros(3) if prismatic else R.T @ (np.asarray(point_m, float) - o)
    hint = np.array([1.0, 0.0, 0.0]) if x_hint is None else R.T @ np.asarray(x_hint, float)
    sine = hypot(v[0], v[1])
    if sine <= PARALLEL_SINE:
        return _parallel(p, v, hint)
    if sine < HAYATI_SINE and not (prismatic or plain):
        return _hayati(p, v, hint)
    n = np.array([-v[1], v[0], 0.0]) / sine  # z x v
    if n @ hint < 0.0:
        n = -n
    cz = v[2]
    d = (p[2] - (p @ v) * cz) / sine**2
    t = (p[2] * cz - p @ v) / sine**2
    a = float((p + t * v - np.array([0.0, 0.0, d])) @ n)
    alpha = atan2(v[0] * n[1] - v[1] * n[0], cz)  # (z x v) . x, z . v
    case = "prismatic" if prismatic else ("intersecting" if abs(a) < SAME_LINE_M else "skew")
    return Link(theta_rad=atan2(n[1], n[0]), d_m=float(d), a_m=a, alpha_rad=alpha, beta_rad=0.0, case=case)


def _parallel(p: Array, v: Array, hint: Array) -> Link:
    """Return the link to a parallel line: x along the common normal, d that of the point given."""
    a = hypot(p[0], p[1])
    if a > SAME_LINE_M:
        n, case = np.array([p[0], p[1]]) / a, "parallel"
        if n @ hint[:2] < 0.0:
            n, a = -n, -a
    else:
        side = hint[:2] if hypot(hint[0], hint[1]) > PARALLEL_SINE else np.array([1.0, 0.0])
        n, a, case = side / hypot(side[0], side[1]), 0.0, "coincident"
    alpha = 0.0 if v[2] > 0.0 else pi
    return Link(theta_rad=atan2(n[1], n[0]), d_m=float(p[2]), a_m=a, alpha_rad=alpha, beta_rad=0.0, case=case)


def _hayati(p: Array, v: Array, hint: Array) -> Link:
    """Return the link to a nearly parallel line with d = 0 and a turn beta."""
    foot = p - (p[2] / v[2]) * v  # where the line meets the near frame's x-y plane
    a = hypot(foot[0], foot[1])
    theta = atan2(foot[1], foot[0]) if a > SAME_LINE_M else atan2(hint[1], hint[0])
    a = a if a > SAME_LINE_M else 0.0
    if cos(theta) * hint[0] + sin(theta) * hint[1] < 0.0:
        theta, a = theta + pi if theta <= 0.0 else theta - pi, -a
    c, s = cos(theta), sin(theta)
    wx, wy = c * v[0] + s * v[1], -s * v[0] + c * v[1]
    # z of Rx(alpha) Ry(beta) is (sin beta, -sin alpha cos beta, cos alpha cos beta)
    alpha = atan2(-wy, v[2])
    beta = atan2(wx, hypot(wy, v[2]))
    return Link(theta_rad=theta, d_m=0.0, a_m=a, alpha_rad=alpha, beta_rad=beta, case="nearly parallel")


def unit_direction(direction: ArrayLike, what: str = "the axis") -> Array:
    """Return the direction (3,) at exactly unit length; Inconsistent where it is far from that."""
    v = np.asarray(direction, float)
    length = float(np.linalg.norm(v)) if v.shape == (3,) else float("nan")
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise Inconsistent(
            f"{what}, {v.tolist()}, has length {length:.6g}, not 1",
            consequence="Its direction, and the scale of what moves along it, cannot be trusted",
            cure="Give a unit vector",
        )
    return np.asarray(v / length)


def dh_arm(name: str, rows: Sequence[Sequence[float]], **fields: object) -> Arm:
    """Return an arm of revolute joints j1..jn from rows (a_m, alpha_rad, d_m, theta_rad), standard convention."""
    joints = tuple(
        Joint(name=f"j{i}", a_m=a, alpha_rad=alpha, d_m=d, theta_rad=theta)
        for i, (a, alpha, d, theta) in enumerate(rows, start=1)
    )
    return Arm(name=name, joints=joints, **fields)  # type: ignore[arg-type]  # passed on as they are
