"""The whole cell as a function of its parameters: pixels of the arm's lights in its cameras, with derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.model import THETA, ArmModel, D
from armsight.calibrate.cell.observations import CellRecording, Spots, robot_time
from armsight.columns import POSITION
from armsight.fitting.groups import taken
from armsight.geometry.poses import skew, stepped
from armsight.kinematics import fk, parameter_jacobian
from armsight.optics import INTRINSICS, Camera
from armsight.optics.kernels.light_image import see_points
from armsight.records.camera import PPM

CAMERA_POSE = ("tx", "ty", "tz", "rx", "ry", "rz")
"""T_base_camera: its position in m and its rotation vector, moved as t + dt, Exp(dw) R in base axes."""
CELL_CLOCK = ("delay_s", "drift_ppm", "readout_s")
"""Robot's time of a line: stamp + delay + drift (stamp - middle) + readout line, of line from -0.5 to 0.5."""
PER_CAMERA = (*INTRINSICS, *CAMERA_POSE, *CELL_CLOCK)
AT_ONCE = 3000
"""Spots whose derivatives are formed together."""
POSE_AT, CLOCK_AT = len(INTRINSICS), len(INTRINSICS) + len(CAMERA_POSE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockNormals:
    """Normal equations of stretches of motion, apart for each: A (b, P, P), g (b, P) = J' r, chi2 (b,), count (b,).

    residuals (m, 2): whitened, of all spots. What a parameter would do that changes half way, what a stretch says of
    itself and how alike the errors within one are, all follows from these.
    """

    A: Array
    g: Array
    chi2: Array
    count: Array
    residuals: Array

    def take(self, blocks: NDArray[np.intp]) -> BlockNormals:
        """Return those of some stretches, without the residuals of single spots."""
        return taken(self, blocks, "A", "g", "chi2", "count", residuals=np.empty((0, 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellModel:
    """A recording and the names of its lights; what is fitted are the parameters in `names`, in that order.

    '<camera>.<PER_CAMERA>' of each camera, the arm's as ArmModel has them ('j2.theta_rad', 'j3.scale', 'j2.sag' ..),
    and 'light:<name>.x_m' .. in the flange's axes.
    """

    recording: CellRecording
    lights: tuple[str, ...]
    arm: ArmModel = field(init=False)
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        arm = ArmModel(arm=self.recording.arm, labels=("",), turned=False)
        object.__setattr__(self, "arm", arm)
        cameras = [f"{side}.{name}" for side in self.recording.names for name in PER_CAMERA]
        lights = [f"light:{light}.{key}" for light in self.lights for key in POSITION]
        object.__setattr__(self, "names", (*cameras, *arm.names[: arm.n_geometry], *lights))

    @property
    def sides(self) -> range:
        """The cameras, by their places in the order."""
        return range(len(self.recording.names))

    @property
    def arm_at(self) -> int:
        """Where the arm's parameters begin."""
        return len(self.sides) * len(PER_CAMERA)

    @property
    def lights_at(self) -> int:
        """Where the lights' positions begin."""
        return self.arm_at + self.arm.n_geometry

    def camera_slice(self, side: int) -> slice:
        """Return which parameters are a camera's."""
        return slice(side * len(PER_CAMERA), (side + 1) * len(PER_CAMERA))

    def camera(self, x: Array, side: int) -> Camera:
        """Return a camera of parameters x."""
        width, height = self.recording.sizes[side]
        return Camera(width=width, height=height, intrinsics=x[self.camera_slice(side)][:POSE_AT])

    def T_base_camera(self, x: Array, side: int) -> RigidTransform:
        """Return where a camera of parameters x stands."""
        v = np.array(x[self.camera_slice(side)][POSE_AT:CLOCK_AT])  # scipy takes no read-only array
        return RigidTransform.from_components(v[:3], Rotation.from_rotvec(v[3:]))

    def lights_m(self, x: Array) -> Array:
        """Return the lights (n, 3) in the flange's axes."""
        return np.asarray(x[self.lights_at :].reshape(-1, 3))

    def arm_vector(self, x: Array) -> Array:
        """Return the arm's parameters as ArmModel takes them, without base and tool."""
        return np.concatenate([x[self.arm_at : self.lights_at], np.zeros(12)])

    def times_s(self, x: Array, spots: Spots) -> Array:
        """Return when each spot (m,) was exposed by the robot's clock."""
        t = np.empty(len(spots))
        for side in self.sides:
            rows = spots.side == side
            clock = x[self.camera_slice(side)][CLOCK_AT:]
            middle = self.recording.middle_s[side]
            t[rows] = robot_time(spots.stamp_s[rows], spots.line[rows], clock, middle)
        return t

    def flange(self, x: Array, q: Array) -> Array:
        """Return T_base_flange (m, 4, 4) at readings q (m, n) as the nominal arm's gearing drives them."""
        p = self.arm_vector(x)
        return fk(self.arm.arm_at(p, None), self._driven(p, q)[0])

    def pixels(self, x: Array, spots: Spots) -> Array:
        """Return where each spot's light would be seen (m, 2); NaN where it would not."""
        return np.asarray(self.pixels_of_all(x, spots)[np.arange(len(spots)), spots.light])

    def pixels_of_all(self, x: Array, spots: Spots) -> Array:
        """Return where each light would be seen (m, n, 2) by each spot's camera at its time; NaN where it would not."""
        T = self.flange(x, self.recording.log.at(self.times_s(x, spots))[0])
        X = T[:, None, :3, 3] + self.lights_m(x) @ T[:, :3, :3].transpose(0, 2, 1)  # (m, n, 3)
        out = np.empty((*X.shape[:2], 2))
        for side in self.sides:
            rows = spots.side == side
            out[rows] = self._view(x, side, X[rows].reshape(-1, 3))[0].reshape(-1, X.shape[1], 2)
        return out

    def normals(self, x: Array, spots: Spots, whitening: Array, block: NDArray[np.intp]) -> BlockNormals:
        """Return the normal equations of spots in blocks (m,), numbered from 0 and in order."""
        count, P = int(block[-1]) + 1, len(x)
        A, g, chi2 = np.zeros((count, P, P)), np.zeros((count, P)), np.zeros(count)
        residuals = np.empty((len(spots), 2))
        for k, (rows, r, J) in enumerate(self.stretches(x, spots, whitening, block)):
            flat, residuals[rows] = J.reshape(-1, P), r
            A[k], g[k], chi2[k] = flat.T @ flat, flat.T @ r.ravel(), r.ravel() @ r.ravel()
        edges = np.searchsorted(block, np.arange(count + 1))
        return BlockNormals(A=A, g=g, chi2=chi2, count=2.0 * np.diff(edges), residuals=residuals)

    def stretches(
        self, x: Array, spots: Spots, whitening: Array, block: NDArray[np.intp]
    ) -> Iterator[tuple[slice, Array, Array]]:
        """Yield of each block its rows, whitened residuals (m, 2) and their derivatives (m, 2, P); blocks in order."""
        edges = np.searchsorted(block, np.arange(int(block[-1]) + 2))
        b = 0
        while b < len(edges) - 1:
            # so many stretches at once as make the derivatives fit into a processor's cache
            end = max(int(np.searchsorted(edges, edges[b] + AT_ONCE, side="right")) - 1, b + 1)
            first, rows = edges[b], slice(edges[b], edges[end])
            part = spots.take(np.arange(edges[b], edges[end]))
            uv, J = self.columns(x, part)
            r, J = np.einsum("mij,mj->mi", whitening[rows], uv - part.uv_px), whitening[rows] @ J
            for k in range(b, end):
                own = slice(edges[k] - first, edges[k + 1] - first)
                yield slice(edges[k], edges[k + 1]), r[own], J[own]
            b = end

    def standing(self, x: Array, q: Array) -> tuple[Array, Array]:
        """Return pixels (k, V, n, 2) of all lights in all cameras where the arm stands at q (k, joints), and by x."""
        k, n, V = len(q), len(self.lights), len(self.sides)
        m = V * n * k
        side, light = np.tile(np.repeat(self.sides, n), k), np.tile(np.arange(n), V * k)
        middle = np.asarray(self.recording.middle_s)[side]
        spots = Spots(
            side=side,
            light=light,
            frame=np.zeros(m, np.intp),
            stamp_s=middle,
            line=np.zeros(m),
            uv_px=np.zeros((m, 2)),
            covariance_px2=np.tile(np.eye(2), (m, 1, 1)),
        )
        rows = np.repeat(q, V * n, axis=0)
        uv, J = self._seen_at(x, spots, rows, np.zeros_like(rows))
        return uv.reshape(k, V, n, 2), J.reshape(k, V, n, 2, -1)

    def retract(self, x: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
        """Move by a step: poses as t + dt, Exp(dw) R, all else by addition."""
        turns = (side * len(PER_CAMERA) + POSE_AT + 3 for side in self.sides)
        return stepped(x, step, turns), local + step_local

    def difference(self, x: Array, other: Array) -> Array:
        """Return the step (P,) that moves other to x."""
        out = x - other
        for side in self.sides:
            at = slice(side * len(PER_CAMERA) + POSE_AT + 3, side * len(PER_CAMERA) + CLOCK_AT)
            turn = Rotation.from_rotvec(np.array(x[at])) * Rotation.from_rotvec(np.array(other[at])).inv()
            out[at] = turn.as_rotvec()
        return out

    def flange_slopes(self, x: Array, q: Array) -> Array:
        """Return (k, 6, arm's parameters): how T_base_flange moves, (dt, dw), where the arm stands at q (k, n)."""
        p = self.arm_vector(x)
        _, own, values, lever, scaled, _ = self._flange(p, q, None)
        return self._by_arm(own[:, :, : 5 * self.arm.arm.n], q, values, lever, scaled)

    def _by_arm(self, links: Array, q: Array, values: Array, lever: Array, scaled: Array) -> Array:
        """Return (k, r, arm's parameters) from the derivatives (k, r, 5 n) by the links."""
        n = self.arm.arm.n
        sign = np.array([joint.sign for joint in self.arm.arm.joints])
        turn = links[:, :, 5 * np.arange(n) + np.where(self.arm.arm.revolute, THETA, D)]  # by the joints' variables
        return np.concatenate(
            [
                links,
                turn * (sign * values)[:, None, :],
                turn[:, :, 1:] * (scaled[1:] * q[:, :-1])[:, None, :],
                turn * (scaled * lever)[:, None, :],
            ],
            axis=2,
        )

    def _flange(self, p: Array, q: Array, speed: Array | None) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return T (m, 4, 4), its derivatives (m, 6, 5 n + 12), driven values, lever, scaled signs, and their speed."""
        n = self.arm.arm.n
        driven, values, lever = self._driven(p, q)
        T, own = parameter_jacobian(self.arm.arm_at(p, None), driven)
        scaled = np.array([joint.sign for joint in self.arm.arm.joints]) * (1.0 + p[5 * n : 6 * n])
        moving = np.zeros_like(values) if speed is None else scaled * self.arm.values(p, speed)
        return T, own, values, lever, scaled, moving

    def _driven(self, p: Array, q: Array) -> tuple[Array, Array, Array]:
        """Return the joints' values (m, n) with what they give way, those that they are driven to, and the lever."""
        values = self.arm.values(p, q)
        lever = self.arm.levers_m(p, values) if self.arm.sags else np.zeros_like(values)
        return values + self.arm.give(p) * lever, values, lever

    def _view(self, x: Array, side: int, X: Array) -> tuple[Array, Array, Array]:
        """Return pixels (m, 2) of points X (m, 3) in a camera, their slopes (m, 2, 3) by the point and by the lens."""
        T = self.T_base_camera(x, side).inv().as_matrix()
        out = np.empty((len(X), 2)), np.empty((len(X), 2, 3)), np.empty((len(X), 2, len(INTRINSICS)))
        R, away = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        see_points(self.camera(x, side).packed, R, away, X, *out)
        return out

    def columns(self, x: Array, spots: Spots) -> tuple[Array, Array]:
        """Return pixels (m, 2) and their derivatives (m, 2, P) by the parameters."""
        return self._seen_at(x, spots, *self.recording.log.at(self.times_s(x, spots)))

    def _seen_at(self, x: Array, spots: Spots, q: Array, speed: Array) -> tuple[Array, Array]:
        """Return the same where the joints stand at q (m, n) and move at speed (m, n)."""
        m, P, n = len(spots), len(x), self.arm.arm.n
        p = self.arm_vector(x)
        T, own, values, lever, scaled, moving = self._flange(p, q, speed)
        arms = T[:, :3, :3] @ self.lights_m(x)[spots.light][:, :, None]  # (m, 3, 1) from the flange to the light
        X = np.ascontiguousarray(T[:, :3, 3] + arms[:, :, 0])
        uv, slope, by_lens = np.empty((m, 2)), np.empty((m, 2, 3)), np.empty((m, 2, len(INTRINSICS)))
        J = np.zeros((m, 2, P))
        for side in self.sides:
            rows = np.flatnonzero(spots.side == side)
            uv[rows], slope[rows], by_lens[rows] = self._view(x, side, X[rows])
        # a point moves by dt + dw x arm where the flange does by (dt, dw)
        turned = own[:, 3:, : 5 * n]
        links = own[:, :3, : 5 * n] + np.cross(turned.transpose(0, 2, 1), arms.transpose(0, 2, 1)).transpose(0, 2, 1)
        by_links = slope @ links  # (m, 2, 5 n)
        J[:, :, self.arm_at : self.lights_at] = self._by_arm(by_links, q, values, lever, scaled)
        turn = by_links[:, :, 5 * np.arange(n) + np.where(self.arm.arm.revolute, THETA, D)]
        by_time = np.einsum("mkj,mj->mk", turn, moving)
        by_light = slope @ T[:, :3, :3]
        for k in range(len(self.lights)):
            rows = np.flatnonzero(spots.light == k)
            J[rows, :, self.lights_at + 3 * k : self.lights_at + 3 * k + 3] = by_light[rows]
        for side in self.sides:
            rows = np.flatnonzero(spots.side == side)
            first = side * len(PER_CAMERA)
            J[rows, :, first : first + POSE_AT] = by_lens[rows]
            J[rows, :, first + POSE_AT : first + POSE_AT + 3] = -slope[rows]
            centre = x[first + POSE_AT : first + POSE_AT + 3]
            J[rows, :, first + POSE_AT + 3 : first + CLOCK_AT] = slope[rows] @ skew(X[rows] - centre)
            since = PPM * (spots.stamp_s[rows] - self.recording.middle_s[side])
            clock = np.stack([np.ones(len(rows)), since, spots.line[rows]], axis=1)
            J[rows, :, first + CLOCK_AT : first + len(PER_CAMERA)] = by_time[rows][:, :, None] * clock[:, None, :]
        return uv, J


def start_vector(model: CellModel, cameras: Sequence[Array], lights_m: Array) -> Array:
    """Return parameters of the nominal arm with these cameras, (PER_CAMERA,) each, and lights (n, 3)."""
    return np.concatenate([*cameras, np.zeros(model.arm.n_geometry), np.asarray(lights_m).ravel()])
