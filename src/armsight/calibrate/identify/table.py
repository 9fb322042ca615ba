"""From axes to a Denavit-Hartenberg table (MATH 4.5), with standard deviations, and what of it means nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.identify.chain import Axis
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, Joint, JointType, link_to_line
from armsight.records import NamedCovariance

KEYS = ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
STEP = 1e-7
"""Of the differences by which standard deviations are carried over, in the axes' own parameters (m, rad)."""
VAGUE = 0.05
"""Share of the arm's size beyond which a standard deviation leaves open how axes lie to each other."""
INTERSECT = 2.0
"""Axes closer than this many standard deviations meet, as far as anyone can tell; the same for angles of parallel
ones."""


def assign_frames(
    axes: Sequence[Axis], beacon_m: Array, base: Array, slide_at_beacon: bool = True
) -> tuple[Array, Array, Array]:
    """Return rows (n, 5) by KEYS, T_world_base (4, 4) and T_flange_tool (4, 4) of axes with all joints at zero.

    base (4, 4): its origin's foot on the first axis becomes the first frame's origin, its x the side of x. A slide's
    position is free: the last joint's goes through the beacon, as in the paper, any other through the frame before it.
    """
    T = _first(axes[0], base)
    first = T.copy()
    rows = np.zeros((len(axes), len(KEYS)))
    for i in range(1, len(axes) + 1):
        if i < len(axes):
            axis = axes[i]
            last_slide = not axis.revolute and i == len(axes) - 1
            point = beacon_m if last_slide and slide_at_beacon else axis.point_m
            # from frame i - 1 to the line of axis i: theta, d along z, a along the common normal, alpha; Hayati's beta
            # where the two are nearly parallel and d would run away (MATH 4.5)
            link = link_to_line(T, point, axis.direction, prismatic=not axis.revolute and not last_slide)
            rows[i - 1] = link.theta_rad, link.d_m, link.a_m, link.alpha_rad, link.beta_rad
            T = T @ link.matrix()
    tool = np.eye(4)
    tool[:3, 3] = T[:3, :3].T @ (beacon_m - T[:3, 3])
    if not axes[-1].revolute or len(axes) == 1:
        rows[-1, 1], tool[2, 3] = tool[2, 3], 0.0  # along a slide the beacon's position is its offset
    return rows, first, tool


def _first(axis: Axis, base: Array) -> Array:
    z = axis.direction
    x = base[:3, 0] - (base[:3, 0] @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = base[:3, 1] - (base[:3, 1] @ z) * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, skew(z) @ x, z], axis=1)
    # the foot of the base's origin: along axis 1 nothing measured says where a frame begins
    T[:3, 3] = axis.point_m + ((base[:3, 3] - axis.point_m) @ z) * z
    return T


def arm_of(name: str, axes: Sequence[Axis], rows: Array, T_world_base: Array, tool: Array, limits: Array) -> Arm:
    """Return the arm of a table; limits (n, 2) are the travel seen."""
    joints = tuple(
        Joint(
            name=f"j{i}",
            type=JointType.REVOLUTE if axis.revolute else JointType.PRISMATIC,
            lower=float(low),
            upper=float(high),
            **dict(zip(KEYS, row.tolist(), strict=True)),
        )
        for i, (axis, row, (low, high)) in enumerate(zip(axes, rows, limits, strict=True), 1)
    )
    return Arm(
        name=name,
        joints=joints,
        T_world_base=RigidTransform.from_matrix(T_world_base),
        T_flange_tool=RigidTransform.from_matrix(tool),
    )


def placed_by(T_parent_rig: RigidTransform, arm: Arm, *, on_base: bool) -> Arm:
    """Return an arm that was found in a rig's axes in those of its parent: of the world, or on_base of the arm's base.

    The base is then the one that the rig was calibrated to, and where the table's first frame lies in it was found.
    """
    T = T_parent_rig * arm.T_world_base
    return (
        replace(arm, T_world_base=RigidTransform.identity(), T_base_frame0=T)
        if on_base
        else replace(arm, T_world_base=T)
    )


def propagate_covariance(make: Callable[[Array], Array], p: Array, covariance: Array) -> Array:
    """Return the covariance (5 n, 5 n) of make(p)'s table entries, by differences, angles unwrapped."""
    here = make(p)
    A = np.empty((here.size, len(p)))
    for i in range(len(p)):
        step = np.zeros(len(p))
        step[i] = STEP
        change = (make(p + step) - here).reshape(-1, len(KEYS))
        for k in (0, 3, 4):
            change[:, k] = np.mod(change[:, k] + np.pi, 2.0 * np.pi) - np.pi
        A[:, i] = change.ravel() / STEP
    return np.asarray(A @ covariance @ A.T)


def deviations(covariance: Array) -> Array:
    """Return the standard deviations (n, 5) of table entries."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(-1, len(KEYS)))


def measured_entries(covariance: Array, known: Array) -> NamedCovariance | None:
    """Return the covariance of the entries that were measured: known (n, 5) is NaN, or 0, where one is chosen."""
    there = np.flatnonzero((np.isfinite(known) & (known > 0.0)).ravel())
    names = tuple(f"j{1 + i // len(KEYS)}.{KEYS[i % len(KEYS)]}" for i in there.tolist())
    return NamedCovariance(names=names, matrix=covariance[np.ix_(there, there)]) if names else None


def degeneracy_notes(axes: Sequence[Axis], rows: Array, std: Array) -> tuple[list[str], Array]:
    """Return notes on degenerate pairs of axes, and std with NaN where an entry is chosen, not measured (MATH 4.5)."""
    notes, known = [], std.copy()
    known[-1, [0, 2, 3, 4]] = np.nan  # behind the last joint there is only the beacon
    size = float(np.abs(rows[:, 1:3]).sum())
    if not axes[0].revolute and len(axes) > 1:
        notes.append("joint 1 slides: only its direction is seen, its place is chosen")
    if axes[-1].revolute:
        known[-1, 1] = np.nan
    for i in range(len(axes) - 1):
        pair = f"axes {i + 1} and {i + 2}"
        sine, sine_std = abs(np.sin(rows[i, 3])), std[i, 3]
        if not axes[i + 1].revolute:
            notes.append(f"joint {i + 2} slides: only its direction is seen, its place is chosen")
            if i + 2 < len(axes):
                known[i, 1:3] = np.nan
        elif rows[i, 4] != 0.0 or sine <= INTERSECT * sine_std:
            apart = "coincide" if abs(rows[i, 2]) <= INTERSECT * std[i, 2] else "are parallel"
            notes.append(f"{pair} {apart} as far as can be told: d of joint {i + 1} is chosen")
            known[i, 1] = np.nan
            if apart == "coincide":
                known[i, 0] = np.nan
        elif abs(rows[i, 2]) <= INTERSECT * std[i, 2]:
            told = (
                "it cannot be told whether {} meet"
                if std[i, 2] > VAGUE * size
                else "{} intersect as far as can be told"
            )
            notes.append(f"{told.format(pair)}: a is {1e3 * rows[i, 2]:.3g} +- {1e3 * std[i, 2]:.2g} mm")
    known[known == 0.0] = np.nan  # what nothing measured moves is chosen
    return notes, known
