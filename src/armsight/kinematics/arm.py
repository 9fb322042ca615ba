"""The arm: a chain of revolute and prismatic joints with its base and its tool."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight import records
from armsight.arrays import Array, Mask
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics.joints import (
    Convention,
    Coupling,
    Joint,
    ToolPoint,
    chain_table,
    check_couplings,
    gearing,
    gearing_back,
    require_followed,
)
from armsight.kinematics.kernels.chain import one_pose
from armsight.kinematics.kernels.derivatives import many_torques, settle_under_weight

if TYPE_CHECKING:
    from armsight.kinematics.inverse_kinematics import Inverse
    from armsight.kinematics.path import JointPath


LARGEST_ANGLE_RAD = 1e4
"""Joint angles beyond this are not angles of an arm: degrees, encoder counts or a fault."""

FAR_TURNED_RAD = 4.0 * math.pi
"""A turning joint two turns beyond a limit is not where the arm can be, but in degrees (20 deg read as rad: three)."""

LIMIT_SLACK = 1e-9
"""Joint values this far (rad or m) beyond a limit are at it: rounding of a solution that ends there."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity; it differs by 0.3 % over the earth, which no compliance is known to."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm(records.Saveable):
    """A serial arm: joints from base to flange, T_world_base, T_base_frame0, T_flange_tool.

    base is the model's root: the base link of a URDF, the first frame of a DH table. T_base_frame0: where that table's
    frame 0, whose z axis is joint 1's, lies in it; the identity but for arms of a URDF or in axes of another base.
    base_link, tool_link: what a URDF calls the links of base and tool, empty where nothing does.

    All kinematics is in the joints' own values q, which are the controller's readings unless `couplings` say otherwise
    or joints give way under the arm's weight (`compliance`): `values` and `readings` turn one into the other.

    convention says how the joints' a, alpha, beta are read: standard (behind the joint) or craig (before it).
    source: where the numbers come from. covariance: of identified parameters, named as in `parameter_names`.
    tool_points: points of the tool that were measured by name, such as a beacon's lights. down_in_base: the unit vector
    (3,) in base axes along which things fall; None for an arm whose world's z axis points up.
    chain (n + 2, 12): the same arm as compiled code sees it (kernels.chain), always in standard convention. found: what
    other modules worked out once from the fields above (its closed form); never part of the arm's value.
    """

    name: str
    joints: tuple[Joint, ...]
    convention: Convention = Convention.STANDARD
    T_world_base: RigidTransform = field(default_factory=RigidTransform.identity)
    T_base_frame0: RigidTransform = field(default_factory=RigidTransform.identity)
    T_flange_tool: RigidTransform = field(default_factory=RigidTransform.identity)
    source: str = ""
    covariance: records.NamedCovariance | None = None
    couplings: tuple[Coupling, ...] = ()
    tool_points: tuple[ToolPoint, ...] = ()
    down_in_base: Array | None = None
    base_link: str = ""
    tool_link: str = ""
    chain: Array = field(init=False, repr=False)
    found: dict[str, object] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        for field_name in ("name", "source", "base_link", "tool_link"):
            records.require_kind(field_name, getattr(self, field_name), str)
        for field_name, kind in (("joints", Joint), ("couplings", Coupling), ("tool_points", ToolPoint)):
            entries = getattr(self, field_name)
            records.require_kind(field_name, entries, Sequence, cure=f"Give a tuple of {kind.__name__}")
            for entry in entries:
                records.require_kind(f"an entry of {field_name}", entry, kind)
            object.__setattr__(self, field_name, tuple(entries))
        for field_name in ("T_world_base", "T_base_frame0", "T_flange_tool"):
            records.require_kind(
                field_name, getattr(self, field_name), RigidTransform, cure="RigidTransform.from_matrix(T)"
            )
        records.require_kind("covariance", self.covariance, records.NamedCovariance, NoneType)
        object.__setattr__(self, "convention", records.one_of(Convention, "convention", self.convention))
        if not self.joints:
            raise Inconsistent("an arm needs at least one joint", consequence="There is nothing to move")
        names = [joint.name for joint in self.joints]
        if len(set(names)) != len(names):
            raise Inconsistent(f"joint names repeat: {', '.join(names)}", cure="Give each joint a name of its own")
        check_couplings(self.couplings, self.joints)
        points = [point.name for point in self.tool_points]
        if len(set(points)) != len(points):
            raise Inconsistent(f"names of tool points repeat: {', '.join(points)}", cure="Give each a name of its own")
        self.found["compliant"] = any(joint.compliance > 0.0 for joint in self.joints)
        if self.compliant and not any(joint.mass_kg for joint in self.joints):
            raise Inconsistent(
                f"joints of {self.name} have a compliance, and none of its links a mass_kg",
                consequence="How far they give way under its weight is not known",
                cure="Give the links' mass_kg and com_m, or leave compliance out",
            )
        if self.down_in_base is not None:
            object.__setattr__(self, "down_in_base", _unit(self.down_in_base))
        chain = chain_table(self)
        chain.setflags(write=False)
        object.__setattr__(self, "chain", chain)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def lower(self) -> Array:
        """Lower limits (n,) in rad or m."""
        return self.chain[1:-1, 9]

    @property
    def upper(self) -> Array:
        """Upper limits (n,) in rad or m."""
        return self.chain[1:-1, 10]

    @property
    def revolute(self) -> Mask:
        """Which joints turn (n,)."""
        return np.asarray(self.chain[1:-1, 0] == 0.0)

    @property
    def T_world_frame0(self) -> Array:
        """Where frame 0 of the table stands in world (4, 4)."""
        return self.T_world_base.as_matrix() @ self.T_base_frame0.as_matrix()

    @property
    def reach_m(self) -> float:
        """Upper bound of the distance of the tool's origin from frame 0's, in m; inf with an unlimited slide."""
        known = self.found.get("reach_m")
        if isinstance(known, float):
            return known
        rows = self.chain[1:-1]
        ends = np.where(self.revolute, 0.0, rows[:, 1]) * np.where(self.revolute, 0.0, rows[:, 9:11].T) + rows[:, 3]
        links = np.hypot(rows[:, 4], np.abs(ends).max(axis=0))
        self.found["reach_m"] = reach_m = float(links.sum() + np.linalg.norm(self.chain[-1, [3, 7, 11]]))
        return reach_m

    @property
    def length_m(self) -> float:
        """Characteristic length in m, by which metres are compared with radians: the mean length of a link."""
        known = self.found.get("length_m")
        if isinstance(known, float):
            return known
        rows = self.chain[1:-1]
        lengths = np.append(np.hypot(rows[:, 4], rows[:, 3]), np.linalg.norm(self.chain[-1, [3, 7, 11]]))
        used = lengths[lengths > 0.0]
        self.found["length_m"] = length_m = float(used.mean()) if len(used) else 1.0
        return length_m

    @property
    def gearing(self) -> Array:
        """Return (n, n): how the joints' values follow the readings; a joint without a drive has a column of zeros."""
        return gearing(self.joints, self.couplings)

    @property
    def gearing_back(self) -> Array:
        """Return (n, n): how readings follow the joints' values; a joint without a drive reads its own value."""
        return gearing_back(self.joints, self.couplings)

    @property
    def undriven(self) -> tuple[int, ...]:
        """Which joints, from 0, have no drive and follow others."""
        known = self.found.get("undriven")
        if isinstance(known, tuple):
            return known
        self.found["undriven"] = found = tuple(i for i, joint in enumerate(self.joints) if not joint.driven)
        return found

    @property
    def compliant(self) -> bool:
        """Whether a joint gives way under the arm's weight."""
        return bool(self.found["compliant"])

    @property
    def direct(self) -> bool:
        """Whether the joints' own values are what the controller shows."""
        return not (self.couplings or self.compliant)

    def values(self, readings: ArrayLike) -> Array:
        """Return the joints' own values (n,) or (m, n) of a controller's readings at rest; raises as `checked`."""
        readings = self.checked(readings)
        driven = readings @ self.gearing.T if self.couplings else readings
        if self.undriven:
            require_followed(self.joints, self.couplings, readings, driven)
        return self.sagged(driven) if self.compliant else driven

    def readings(self, q: ArrayLike) -> Array:
        """Return what the controller shows, (n,) or (m, n), where the joints' values are q and the arm rests."""
        q = self.checked(q)
        if self.compliant:
            q = q - np.array([joint.compliance for joint in self.joints]) * self.gravity_torque(q)
        return np.asarray(q @ self.gearing_back.T) if self.couplings else q

    @property
    def down(self) -> Array:
        """The unit vector (3,) in world axes along which things fall."""
        if self.down_in_base is None:
            return np.array([0.0, 0.0, -1.0])
        return np.asarray(self.T_world_base.as_matrix()[:3, :3] @ self.down_in_base)

    def based(self) -> Arm:
        """Return the arm with its base as the world; what falls still falls along the same line in it."""
        return replace(self, T_world_base=RigidTransform.identity(), down_in_base=self.base_down)

    @property
    def base_down(self) -> Array:
        """The unit vector (3,) in base axes along which things fall."""
        if "base_down" not in self.found:
            self.found["base_down"] = self.T_world_base.as_matrix()[:3, :3].T @ self.down
        return np.asarray(self.found["base_down"])

    @property
    def weight(self) -> Array:
        """Return (n, 4): of each link what it weighs in N, and its centre of mass in the frame behind its joint."""
        return np.array([(GRAVITY_M_S2 * joint.mass_kg, *joint.com_m) for joint in self.joints])

    def gravity_torque(self, q: ArrayLike) -> Array:
        """Return by how much the links' weight turns each joint forwards at the joints' values q, N m (slides: N),
        (n,) or (m, n); 0 without masses (Siciliano 2009, Robotics, 7.1: minus the slope of the potential energy)."""
        values = self.checked(q)
        tau = np.empty(np.atleast_2d(values).shape)
        many_torques(self.chain, self.weight, self.down, np.atleast_2d(values), tau)
        return tau.reshape(values.shape)

    def sagged(self, q: ArrayLike) -> Array:
        """Return where joints driven to q, (n,) or (m, n), rest under torque. Raises Inconsistent where they fall."""
        values = self.checked(q)
        if not self.compliant:
            return values
        rows, soft = np.atleast_2d(values), np.array([joint.compliance for joint in self.joints])
        rest = np.empty(rows.shape)
        if not settle_under_weight(self.chain, self.weight, self.down, soft, rows, rest):
            raise Inconsistent(
                f"the joints of {self.name} are so soft that its weight turns them without end",
                consequence="Where its tool is cannot be told",
                cure="Check compliance (rad per N m), mass_kg and com_m in its file",
            )
        return rest.reshape(values.shape)

    def checked(self, q: ArrayLike) -> Array:
        """Return joint values as float64 (n,) or (m, n); Inconsistent where their number or size cannot be."""
        array = records.real_array("q", q)
        if array.ndim not in (1, 2) or array.shape[-1] != len(self.joints):
            raise UsageError(
                f"{self.name} has {self.n} joints, but the joint values have shape {array.shape}",
                cure=f"Give {self.n} values per row: {', '.join(joint.name for joint in self.joints)}",
            )
        array = records.for_kernels(array)
        flat = array.ravel()
        if not (flat.dot(flat) <= FAR_TURNED_RAD**2 or np.abs(flat).max(initial=0.0) <= FAR_TURNED_RAD):  # NaN too
            self._require_sizes(array)
        return array

    def _require_sizes(self, q: Array) -> None:
        size = float(np.abs(q).max(initial=0.0))
        if not size <= LARGEST_ANGLE_RAD:  # also true for NaN
            raise Inconsistent(
                "a joint value is not finite" if not math.isfinite(size) else f"a joint value is {size:g}",
                consequence="No pose can be computed",
                cure="Give radians for turning and metres for sliding joints, and leave rows without a reading out",
            )
        limit = np.maximum(np.abs(self.lower), np.abs(self.upper)) + FAR_TURNED_RAD
        far = self.revolute & (np.abs(q) > limit) & np.isfinite(limit)
        if far.any():
            value = float(q[far if q.ndim == 2 else np.nonzero(far)][0])
            name = self.joints[int(np.argwhere(far)[0][-1])].name
            raise Inconsistent(
                f"joint {name} is at {value:g} rad, turns beyond its limits",
                consequence="No pose can be computed",
                cure="Give radians: the numbers look like degrees",
            )

    def fk(self, q: ArrayLike) -> Array:
        """Return T_world_tool (4, 4) of joint values q (n,), or (m, 4, 4) of q (m, n); see kinematics.fk."""
        values = self.checked(q)
        if values.ndim == 1:  # here, for an import and two calls on the way cost as much as the chain
            T = np.empty((4, 4))
            one_pose(self.chain, values, T)
            return T
        from armsight.kinematics.forward_kinematics import fk

        return fk(self, values)

    def jacobian(self, q: ArrayLike, *, axes: Literal["world", "base", "tool"] = "world") -> Array:
        """Return the geometric Jacobian (6, n) or (m, 6, n): linear, then angular velocity; see kinematics.jacobian."""
        from armsight.kinematics.forward_kinematics import jacobian

        return jacobian(self, q, axes=axes)

    def ik(
        self,
        T_world_tool: RigidTransform | ArrayLike,
        near: ArrayLike | None = None,
        *,
        task: Literal["pose", "position"] | None = None,
    ) -> Inverse:
        """Return every solution found for one pose, nearest to near (n,) first: `arm.ik(T, near)[0].q`.

        task: position: the tool's rotation is left free; None: as many as the arm's joints can hold. See kinematics.ik;
        where there is none, `status` and `why` say the reason.
        """
        from armsight.kinematics.inverse_kinematics import ik

        return ik(self, T_world_tool, near, task=task)

    def ik_many(
        self,
        T_world_tool: RigidTransform | ArrayLike,
        near: ArrayLike | None = None,
        *,
        task: Literal["pose", "position"] | None = None,
    ) -> tuple[Inverse, ...]:
        """Return the solutions of many poses (m, 4, 4), one entry a pose; raises as ik.

        near: (n,) for the first pose, each further one being solved near the one before; or (m, n), one row a pose.
        """
        from armsight.kinematics.inverse_kinematics import ik_each

        return ik_each(self, T_world_tool, near, task=task)

    def track(
        self,
        T_world_tool: RigidTransform | ArrayLike,
        *,
        t_s: ArrayLike | None = None,
        near: ArrayLike | None = None,
        task: Literal["pose", "position"] | None = None,
    ) -> JointPath:
        """Return one continuous joint track along poses (m, 4, 4), as far as it goes, with what is wrong where.

        t_s (m,): for the joints' speeds. near (n,): where the arm stands. See kinematics.track_path.
        """
        from armsight.kinematics.path import track_path

        return track_path(self, T_world_tool, t_s=t_s, start=near, task=task)

    def moved(self, changes: Mapping[str, float]) -> Arm:
        """Return the arm with parameters changed by so much: {"j3.theta_rad": 0.005}; see kinematics.moved."""
        from armsight.kinematics.forward_kinematics import moved

        records.require_kind("changes", changes, Mapping, cure='Give {"j3.theta_rad": 0.005}')
        for name, by in changes.items():
            records.require_number(name, by)
        return moved(self, changes)

    def within_limits(self, q: ArrayLike) -> Mask:
        """Tell for joint values (n,) or (m, n) whether all are within their limits, () or (m,); raises as `checked`."""
        values = self.checked(q)
        inside = (values >= self.lower - LIMIT_SLACK) & (values <= self.upper + LIMIT_SLACK)
        return np.asarray(inside.all(axis=-1))


def _unit(down: Array) -> Array:
    """Return the direction (3,) at unit length, read-only; Inconsistent where it is none."""
    down = np.array(records.frozen_array("down_in_base", down, (3,)))
    if not abs((size := float(np.linalg.norm(down))) - 1.0) < 1e-3:
        raise Inconsistent(
            f"down_in_base {down.tolist()} is not of unit length",
            consequence="Which way the arm's weight pulls is not known",
            cure="Give the direction in which things fall, in base axes: [0, 0, -1] for an arm that stands upright",
        )
    down /= size
    down.setflags(write=False)
    return down
