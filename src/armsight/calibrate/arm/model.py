"""The arm as a function of its parameters: links, zeros, scales, couplings, sag, base and the tool's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.points import ArmPoints
from armsight.columns import DH_ROW, POSE6
from armsight.fitting import Evaluation
from armsight.kinematics import Arm, Convention, Coupling, fk, parameter_jacobian, parameter_names

THETA, D = DH_ROW.index("theta_rad"), DH_ROW.index("d_m")
PARALLEL_RAD = 0.1
"""Axes nearer to parallel are nearly parallel: a direction known to 1e-3 rad leaves d to 1 % of a link (MATH 4.5)."""

STAND_IN_KG = 1.0
"""At the flange, for the links of an arm whose masses are not known: the lever of the flange about each joint stands
for that of what it carries. The joints' compliance is then that against this mass."""
LEAST_WEIGHT_N = 1e-6
"""A joint that carries less carries nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmModel:
    """A nominal arm, and what of its tool is seen.

    Parameters: changes of the links ('j1.a_m' ..), of the joints' scales ('j1.scale'), couplings ('j3.by_j2': the share
    of j2's reading that is added to j3's), of how joints give way ('j2.sag': rad per metre of lever of the weight that
    the joint carries, its compliance times that weight), then base and tool poses as position and rotation vector
    ('base.x_m' .., 'tool.x_m' ..; of several points 'tool:NAME.x_m'). turned: rotations were measured too.
    """

    arm: Arm
    labels: tuple[str, ...]
    turned: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        found = self.arm.found
        if "names" not in found:
            joints = [joint.name for joint in self.arm.joints]
            links = parameter_names(self.arm)[: 5 * self.arm.n]
            scales = tuple(f"{name}.scale" for name in joints)
            couplings = tuple(f"{b}.by_{a}" for a, b in pairwise(joints))
            found["names"] = (*links, *scales, *couplings, *(f"{name}.sag" for name in joints))
        return (*cast(tuple[str, ...], found["names"]), *self.mounts)

    @property
    def loaded(self) -> Arm:
        """The nominal arm with masses, or with the one of STAND_IN_KG at its flange where it has none."""
        found = self.arm.found
        if "loaded" not in found:
            found["loaded"] = stand_in(self.arm)
        return cast(Arm, found["loaded"])

    @property
    def carried(self) -> Array:
        """The weight (n,) in N that each joint carries: of its link and of all behind it."""
        found = self.arm.found
        if "carried" not in found:
            found["carried"] = np.cumsum(self.loaded.weight[::-1, 0])[::-1]
        return np.asarray(found["carried"])

    @property
    def sags(self) -> tuple[str, ...]:
        """Names of the sags that can be found: of turning joints that carry something."""
        able = zip(self.arm.joints, self.arm.revolute, self.carried, strict=True)
        return tuple(f"{joint.name}.sag" for joint, turns, weight in able if turns and weight > 0.0)

    @property
    def parallel(self) -> tuple[tuple[int, str], ...]:
        """Pairs of consecutive joints with nearly parallel axes: the first one's index, and the name of their beta."""
        craig = self.arm.convention is Convention.CRAIG  # there a joint's a, alpha, beta are those of the link before
        links = [(k, self.arm.joints[k + craig]) for k in range(self.arm.n - 1)]
        return tuple(
            (k, f"{joint.name}.beta_rad")
            for k, joint in links
            if abs(np.cos(joint.alpha_rad) * np.cos(joint.beta_rad)) > np.cos(PARALLEL_RAD)
        )

    @property
    def replaced(self) -> tuple[str, ...]:
        """Names of the d that beta takes the place of: of the first of two turning or sliding joints on parallel axes.

        A slide's d is its zero and stays; the second joint's d then says the same and is left to the pivoting.
        """
        return tuple(f"{self.arm.joints[k].name}.d_m" for k, _ in self.parallel if self.arm.revolute[k])

    @property
    def geometry(self) -> tuple[str, ...]:
        """Names of the links' parameters that can be corrected: Denavit-Hartenberg's, Hayati's on parallel axes.

        Beside the other four, beta at axes that are not parallel does what joint zeros do (MATH 4.5), and is not among
        them.
        """
        betas = {name for _, name in self.parallel}
        links = parameter_names(self.arm)[: 5 * self.arm.n]
        return tuple(
            name for name in links if (name in betas or not name.endswith(".beta_rad")) and name not in self.replaced
        )

    @property
    def mounts(self) -> tuple[str, ...]:
        """Names of the parameters of base and tools."""
        tools = ["tool" if not label else f"tool:{label}" for label in self.labels]
        return tuple(f"{part}.{key}" for part in ("base", *tools) for key in POSE6)

    @property
    def n_geometry(self) -> int:
        """How many parameters come before those of base and tools."""
        return 8 * self.arm.n - 1

    def vector(self, base: RigidTransform, tools: Sequence[RigidTransform]) -> Array:
        """Return the parameters of the nominal geometry with these mounts."""
        mounts = [np.concatenate([T.translation, T.rotation.as_rotvec()]) for T in (base, *tools)]
        return np.concatenate([np.zeros(self.n_geometry), *mounts])

    def pose(self, p: Array, k: int) -> RigidTransform:
        """Return the base (k = 0) or the tool k - 1 of parameters p."""
        v = np.array(p[self.n_geometry + 6 * k :][:6])
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(v[3:]).as_matrix(), v[:3]
        return RigidTransform(T, normalize=False)  # a third of the time of from_components; a fit makes thousands

    def arm_at(self, p: Array, tool: int | None = 0) -> Arm:
        """Return the arm of parameters p; its couplings are p's on top of the nominal arm's. tool: None for none."""
        known, made = cast(tuple[object, dict[int | None, Arm]], self.arm.found.get("at", (None, {})))
        if known != p.tobytes():  # errors, levers and derivatives of one p are asked for in a row, with the tool or not
            self.arm.found["at"] = (p.tobytes(), made := {})
        if tool not in made:
            mount = RigidTransform.identity() if tool is None else self.pose(p, tool + 1)
            other = next(iter(made.values()), None)
            made[tool] = self._arm_at(p, mount) if other is None else replace(other, T_flange_tool=mount)
        return made[tool]

    def _arm_at(self, p: Array, T_flange_tool: RigidTransform) -> Arm:
        n = self.arm.n
        links, scales, sag = p[: 5 * n].reshape(n, 5), p[5 * n : 6 * n], p[7 * n - 1 : 8 * n - 1]
        soft = sag / np.maximum(self.carried, LEAST_WEIGHT_N) if sag.any() else sag
        given = self.loaded if sag.any() else self.arm
        joints = tuple(
            replace(
                joint,
                **{key: getattr(joint, key) + change for key, change in zip(DH_ROW, row.tolist(), strict=True)},
                sign=joint.sign * (1.0 + float(scale)),
                compliance=max(joint.compliance + give, 0.0),
            )
            for joint, row, scale, give in zip(given.joints, links, scales, soft.tolist(), strict=True)
        )
        return replace(
            given,
            joints=joints,
            T_world_base=self.pose(p, 0),
            down_in_base=given.base_down,
            T_flange_tool=T_flange_tool,
            covariance=None,
            couplings=self._couplings(p),
        )

    def _couplings(self, p: Array) -> tuple[Coupling, ...]:
        """Return how the arm of parameters p follows the controller's readings."""
        if not self.arm.couplings and not p[6 * self.arm.n : 7 * self.arm.n - 1].any():
            return ()
        gearing = self.values(p, np.eye(self.arm.n)).T @ self.arm.gearing
        names = [joint.name for joint in self.arm.joints]
        return tuple(
            Coupling(joint=names[i], by=names[k], share=float(gearing[i, k]))
            for i in range(self.arm.n)
            for k in np.flatnonzero(gearing[i, :i])
        )

    def values(self, p: Array, q: Array) -> Array:
        """Return the joints' own values (m, n) at rows q."""
        out = q.copy()
        out[:, 1:] += p[6 * self.arm.n : 7 * self.arm.n - 1] * q[:, :-1]
        return out

    def give(self, p: Array) -> Array:
        """Return (n,) by how much each joint gives way, rad per metre of lever of the weight it carries."""
        nominal = np.array([joint.compliance for joint in self.arm.joints])
        return np.asarray(p[7 * self.arm.n - 1 : self.n_geometry] + nominal * self.carried)

    def lever_m(self, p: Array, points: ArmPoints) -> Array:
        """Return (m, n) the lever in m by which what each joint carries turns it, where the arm rests."""
        return self.levers_m(p, self.values(p, points.q))

    def levers_m(self, p: Array, driven: Array) -> Array:
        """Return the same where the joints are driven to (m, n)."""
        arm = self.arm_at(p, None)
        torque = stand_in(arm).gravity_torque(arm.sagged(driven))
        return np.asarray(torque / np.maximum(self.carried, LEAST_WEIGHT_N))

    def predict(self, p: Array, points: ArmPoints, lever_m: Array | None = None) -> tuple[Array, Array]:
        """Return the tool's poses (m, 4, 4) and their derivative (m, 6, P), (dt, dw) in world axes.

        lever_m: (m, n) to hold the levers at; the derivative is then exact, and a fit settles.
        """
        lever = self.lever_m(p, points) if lever_m is None else lever_m
        # where the joints come to rest: the readings with couplings, and what gives way under the load
        rest = self.values(p, points.q) + self.give(p) * lever
        n, g = self.arm.n, self.n_geometry
        T = np.empty((len(points), 4, 4))
        J = np.zeros((len(points), 6, len(p)))
        which = self._which(points)
        sign = np.array([joint.sign for joint in self.arm.joints])
        scaled = sign * (1.0 + p[5 * n : 6 * n])
        drive = 5 * np.arange(n) + np.where(self.arm.revolute, THETA, D)
        for k in range(len(self.labels)):
            rows = np.flatnonzero(which == k)
            q = rest[rows]
            T[rows], own = parameter_jacobian(self.arm_at(p, k), q)
            J[rows, :, : 5 * n] = own[:, :, : 5 * n]
            # by each joint's own variable, theta or d, through which scale, coupling and sag act: the chain rule's
            # inner part
            turn = own[:, :, drive]  # (m, 6, n)
            J[rows, :, 5 * n : 6 * n] = turn * (sign * q)[:, None, :]
            J[rows, :, 6 * n : 7 * n - 1] = turn[:, :, 1:] * (scaled[1:] * points.q[rows][:, :-1])[:, None, :]
            J[rows, :, 7 * n - 1 : g] = turn * (scaled * lever[rows])[:, None, :]
            J[rows, :, g : g + 6] = own[:, :, 5 * n : 5 * n + 6]
            J[rows, :, g + 6 * (k + 1) : g + 6 * (k + 2)] = own[:, :, 5 * n + 6 :]
        return T, J

    def _which(self, points: ArmPoints) -> NDArray[np.intp]:
        """Return (m,) which of the tool's points each row is of."""
        number = {label: k for k, label in enumerate(self.labels)}
        return np.array([number[label] for label in points.point], dtype=np.intp)

    def errors(self, p: Array, points: ArmPoints) -> tuple[Array, Array]:
        """Return the errors of position (m, 3) and, where measured, of rotation (m, 3), model minus measurement."""
        arm = self.arm_at(p, None)
        T = fk(arm, arm.sagged(self.values(p, points.q)))
        n = len(self.labels)
        mounts = np.array(p[self.n_geometry + 6 :]).reshape(n, 6)  # scipy takes no read-only array
        tools = np.tile(np.eye(4), (n, 1, 1))
        tools[:, :3, :3], tools[:, :3, 3] = Rotation.from_rotvec(mounts[:, 3:]).as_matrix(), mounts[:, :3]
        return _errors(T @ tools[self._which(points)], points)

    def evaluate(
        self, p: Array, points: ArmPoints, sigma_m: float, sigma_rad: float, lever_m: Array | None = None
    ) -> Evaluation:
        """Return whitened residuals and Jacobian; one block of three or six rows a measurement; lever_m as predict.

        sigma_m: noise of position, or what is added to the rows' covariances where they have some.
        """
        T, J = self.predict(p, points, lever_m)
        position, turn = _errors(T, points)
        r = points.whiten(position, sigma_m)
        slopes = points.whiten(J[:, :3], sigma_m)
        if self.turned:
            r = np.concatenate([r, turn / sigma_rad], axis=1)
            slopes = np.concatenate([slopes, J[:, 3:] / sigma_rad], axis=1)
        return Evaluation.of_one(r, slopes)

    def retract(self, p: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
        """Move by a step: poses as t + dt, Exp(dw) R, all else by addition."""
        out = p + step
        by, old, new = (v[self.n_geometry :].reshape(-1, 6)[:, 3:] for v in (step, p, out))
        new[:] = (Rotation.from_rotvec(np.array(by)) * Rotation.from_rotvec(np.array(old))).as_rotvec()
        return out, local + step_local


def stand_in(arm: Arm) -> Arm:
    """Return the arm with its masses; one that has none with STAND_IN_KG at its flange."""
    if any(joint.mass_kg for joint in arm.joints):
        return arm
    return replace(arm, joints=(*arm.joints[:-1], replace(arm.joints[-1], mass_kg=STAND_IN_KG)))


def _errors(T: Array, points: ArmPoints) -> tuple[Array, Array]:
    position = T[:, :3, 3] - points.xyz_m
    if points.rotation is None:
        return position, np.zeros((len(points), 3))
    turn = Rotation.from_matrix(T[:, :3, :3] @ points.rotation.transpose(0, 2, 1)).as_rotvec()
    return position, np.asarray(turn)
