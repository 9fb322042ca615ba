"""The simulated arm and the servo that moves it: kinematics by plain products of matrices, inverse by Newton steps.

Nothing here is shared with the product's kinematics, which is tested against it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent

HAIR = 1e-6
"""Share of a step that is rounding."""

GRID_S = 0.004
"""Longest step of the motion's record: at 10 rad/s^2 a straight line in between is 20 urad off at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """How the joints follow their commands.

    cycle_s: between two commands that the controller takes. lag_s: time constant of the way to the command. max_speed
    (n,): rad/s or m/s. encoder_step (n,): what a reading is a multiple of, in rad or m. noise: a reading's deviation.
    """

    cycle_s: float
    lag_s: float
    max_speed: Array
    encoder_step: Array
    noise: float = 0.0

    def __post_init__(self) -> None:
        if not (self.cycle_s > 0.0 and self.lag_s >= 0.0):
            raise Inconsistent(f"a drive of cycle {self.cycle_s} s and lag {self.lag_s} s cannot be")
        if not ((self.max_speed > 0.0).all() and (self.encoder_step >= 0.0).all()):
            raise Inconsistent("speed limits must be positive and encoder steps not negative")


class Servo:
    """Joints under way. Time only runs forward; `advance` first, then ask for any moment up to then."""

    def __init__(self, drive: Drive, q: ArrayLike, t_s: float = 0.0, *, keep: int | None = None) -> None:
        """Rest at q (n,) from t_s on; keep: how many steps of the past to remember at least, None for all."""
        self.drive = drive
        self._keep = keep
        self._dt_s = drive.cycle_s / max(1, math.ceil(drive.cycle_s / GRID_S))
        self._start_s = t_s
        self._q = [np.array(q, dtype=float)]
        self._goal = self._q[0].copy()
        self._queue: deque[tuple[float, Array]] = deque()
        self._rng = np.random.default_rng(0)

    @property
    def t_s(self) -> float:
        """The moment up to which the motion is known."""
        return self._start_s + (len(self._q) - 1) * self._dt_s

    @property
    def goal(self) -> Array:
        """The last command (n,), taken or not yet."""
        return (self._queue[-1][1] if self._queue else self._goal).copy()

    def command(self, t_s: float, q: Array) -> None:
        """Have the joints go to q (n,) from time t_s on; commands come in the order of time."""
        self._queue.append((t_s, np.array(q, dtype=float)))

    def halt(self) -> None:
        """Forget all commands and stay where the joints are."""
        self._queue.clear()
        self._goal = self._q[-1].copy()

    def hold(self, held: ArrayLike) -> None:
        """Take torque from joints or give it back, held (n,): without weight they stay where they are."""

    def advance(self, t_s: float) -> None:
        """Let the joints move until t_s is covered."""
        while t_s - self.t_s > HAIR * self._dt_s:  # rounding of long sums must not make two steps of one
            while self._queue and self._queue[0][0] <= self.t_s + 1e-9:
                self._goal = self._queue.popleft()[1]
            self._q.append(self._moved())
        if self._keep is not None and len(self._q) > 2 * self._keep:
            forgotten = len(self._q) - self._keep
            self._start_s += forgotten * self._dt_s
            del self._q[:forgotten]

    def _moved(self) -> Array:
        """Return where the joints (n,) are one step after the last one known."""
        share = 1.0 - (math.exp(-self._dt_s / self.drive.lag_s) if self.drive.lag_s > 0.0 else 0.0)
        longest = self.drive.max_speed * self._dt_s
        return np.asarray(self._q[-1] + np.clip(share * (self._goal - self._q[-1]), -longest, longest))

    def at(self, t_s: ArrayLike) -> Array:
        """Return the true joint values (m, n) at times (m,) up to the moment known; before the start they rest."""
        sample = np.clip((np.atleast_1d(t_s) - self._start_s) / self._dt_s, 0.0, len(self._q) - 1.0)
        low = np.minimum(sample.astype(int), max(len(self._q) - 2, 0))
        share = (sample - low)[:, None]
        first = np.array([self._q[i] for i in low])
        second = np.array([self._q[min(i + 1, len(self._q) - 1)] for i in low])
        return np.asarray(first + share * (second - first))

    def read(self, t_s: ArrayLike) -> Array:
        """Return the encoders' readings (m, n) at times (m,)."""
        step = self.drive.encoder_step
        q = self.at(t_s)
        if self.drive.noise:
            q = q + self._rng.normal(0.0, self.drive.noise, q.shape)
        return np.where(step > 0.0, np.round(q / np.where(step > 0.0, step, 1.0)) * step, q)


IK_STEPS = 60
"""Newton steps before a pose counts as out of reach; from 30 degrees away 6 to 10 are needed."""

IK_TOLERANCE = (1e-9, 1e-9)
"""Largest error of position in m and of rotation in rad of a solution."""

LARGEST_STEP = 0.3
"""Longest Newton step in rad (or m): keeps to the branch it began on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimJoint:
    """One joint and the link behind it, standard Denavit-Hartenberg; prismatic: along z instead of turning about it.

    lower, upper, max_speed: of the joint value, in rad or m and per s. mass_kg, com_m: of the link, its centre of mass
    in the frame behind the joint; 0 where it is not known.
    """

    name: str
    prismatic: bool = False
    a_m: float = 0.0
    alpha_rad: float = 0.0
    d_m: float = 0.0
    theta_rad: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    max_speed: float = math.inf
    mass_kg: float = 0.0
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def matrix(self, q: float) -> Array:
        """Return Rz(theta) Tz(d) Tx(a) Rx(alpha) (4, 4): the frame behind the joint in the one before it."""
        theta = self.theta_rad + (0.0 if self.prismatic else q)
        c, s = math.cos(theta), math.sin(theta)
        ca, sa = math.cos(self.alpha_rad), math.sin(self.alpha_rad)
        d = self.d_m + (q if self.prismatic else 0.0)
        return np.array(
            [
                [c, -s * ca, s * sa, self.a_m * c],
                [s, c * ca, -c * sa, self.a_m * s],
                [0.0, sa, ca, d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimArm:
    """A chain of joints on T_world_base. T_base_frame0 (4, 4): where in base axes the first joint's table begins."""

    joints: tuple[SimJoint, ...]
    T_world_base: RigidTransform = field(default_factory=RigidTransform.identity)
    T_base_frame0: Array = field(default_factory=lambda: np.eye(4))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def frames(self, q: ArrayLike) -> Array:
        """Return the poses (n + 1, 4, 4) of the table's first frame and of that behind each joint, in base axes."""
        frames = [self.T_base_frame0]
        for joint, value in zip(self.joints, np.asarray(q, dtype=float), strict=True):
            frames.append(frames[-1] @ joint.matrix(float(value)))
        return np.array(frames)

    def flange(self, q: ArrayLike) -> RigidTransform:
        """Return T_base_flange at joint values q (n,)."""
        return RigidTransform.from_matrix(self.frames(q)[-1])

    def flanges(self, q: ArrayLike) -> Array:
        """Return T_base_flange (m, 4, 4) at joint values q (m, n), all at once."""
        values = np.atleast_2d(np.asarray(q, dtype=float))
        pose = np.broadcast_to(self.T_base_frame0, (len(values), 4, 4))
        for joint, column in zip(self.joints, values.T, strict=True):
            pose = pose @ np.array([joint.matrix(float(value)) for value in column])
        return np.asarray(pose)

    def jacobian(self, frames: Array) -> Array:
        """Return velocity and turning rate (6, n) of the flange in base axes for unit joint rates, given its frames."""
        z, p = frames[:-1, :3, 2], frames[:-1, :3, 3]
        arm = frames[-1, :3, 3] - p
        turning = z[:, [1, 2, 0]] * arm[:, [2, 0, 1]] - z[:, [2, 0, 1]] * arm[:, [1, 2, 0]]  # z x arm, (n, 3)
        prismatic = np.array([[joint.prismatic] for joint in self.joints])
        return np.vstack([np.where(prismatic, z, turning).T, np.where(prismatic, 0.0, z).T])

    def reach(self, T_base_flange: Array, near: ArrayLike) -> Array:
        """Return joint values (n,) that bring the flange to a pose (4, 4), on the branch of near (n,).

        Raises Inconsistent where damped Newton steps from there do not arrive.
        """
        q = np.array(near, dtype=float)
        goal = T_base_flange
        damping = 1e-9
        for _ in range(IK_STEPS):
            frames = self.frames(q)
            turn = _turn(goal[:3, :3] @ frames[-1, :3, :3].T)
            error = np.concatenate([goal[:3, 3] - frames[-1, :3, 3], turn])
            if np.linalg.norm(error[:3]) < IK_TOLERANCE[0] and np.linalg.norm(turn) < IK_TOLERANCE[1]:
                return q
            J = self.jacobian(frames)
            step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
            q = q + step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        raise Inconsistent(
            f"the arm does not reach the flange pose at {np.round(goal[:3, 3], 3).tolist()} m",
            consequence="It cannot be sent there",
            cure="Keep the path within the arm's reach, and away from where its axes line up",
        )

    def with_errors(self, rng: np.random.Generator, length_m: float, angle_rad: float) -> SimArm:
        """Return an arm whose lengths and angles differ from these by normal errors: the one that was really built.

        The first joint's zero and height stay: they cannot be told from where the base stands.
        """
        joints = []
        for i, joint in enumerate(self.joints):
            a, alpha, d, theta = rng.normal(size=4)
            joints.append(
                replace(
                    joint,
                    a_m=joint.a_m + length_m * a,
                    alpha_rad=joint.alpha_rad + angle_rad * alpha,
                    d_m=joint.d_m + (length_m * d if i else 0.0),
                    theta_rad=joint.theta_rad + (angle_rad * theta if i and not joint.prismatic else 0.0),
                )
            )
        return replace(self, joints=tuple(joints))

    def mapping(self, T_flange_tool: RigidTransform) -> dict[str, object]:
        """Return it as arm.yaml has it under convention, T_world_base, T_flange_tool and joints."""
        return {
            "convention": "standard",
            "T_world_base": pose_mapping(self.T_world_base),
            "T_base_frame0": pose_mapping(RigidTransform.from_matrix(self.T_base_frame0)),
            "T_flange_tool": pose_mapping(T_flange_tool),
            "joints": [
                {
                    "name": joint.name,
                    "type": "prismatic" if joint.prismatic else "revolute",
                    "a_m": joint.a_m,
                    "alpha_rad": joint.alpha_rad,
                    "d_m": joint.d_m,
                    "theta_rad": joint.theta_rad,
                    "lower": joint.lower if math.isfinite(joint.lower) else None,
                    "upper": joint.upper if math.isfinite(joint.upper) else None,
                }
                for joint in self.joints
            ],
        }


def _turn(R: Array) -> Array:
    """Return a rotation vector (3,) along that of R (3, 3): exact beyond 60 degrees, to first order below."""
    if np.trace(R) < 2.0:
        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    return 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def pose_mapping(pose: RigidTransform) -> dict[str, list[float]]:
    """Return a pose as files have it."""
    quat = pose.rotation.as_quat(canonical=True)
    return {"xyz_m": np.asarray(pose.translation).tolist(), "quat_xyzw": np.asarray(quat).tolist()}


@dataclass(frozen=True, slots=True, kw_only=True)
class FlangeLimits:
    """Largest speed of the flange that the controller passes on, in m/s and rad/s."""

    speed_m_s: float = math.inf
    speed_rad_s: float = math.inf

    def cut(self, here: Array, goal: Array, time_s: float) -> tuple[Array, tuple[str, ...]]:
        """Return how far one gets from pose here (4, 4) to goal in time_s, along a straight line; and what cut it."""
        way, D = goal[:3, 3] - here[:3, 3], goal[:3, :3] @ here[:3, :3].T
        far = math.sqrt(float(way @ way))
        wide = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(D)) - 1.0))))
        longest = self.speed_m_s * time_s / max(far, 1e-15)
        widest = self.speed_rad_s * time_s / max(wide, 1e-15)
        limited = []
        if longest < 1.0:
            limited.append(f"speed of the flange ({self.speed_m_s:g} m/s)")
        if widest < 1.0:
            limited.append(f"turning of the flange ({self.speed_rad_s:g} rad/s)")
        if not limited:
            return goal, ()
        share = min(longest, widest)
        end = here.copy()
        end[:3, 3] += share * way
        end[:3, :3] = Rotation.from_rotvec(share * Rotation.from_matrix(D).as_rotvec()).as_matrix() @ here[:3, :3]
        return end, tuple(limited)


SAME = 1e-12
"""Segments whose directions' sine squared is less are parallel."""


def covering(frames: Array, radii_m: Sequence[float], eye_m: Array, light_m: Array) -> int | None:
    """Return the link, from 0, that stands between eye (3,) and light (3,), all in base axes; None where none does.

    Its links are capsules of radii_m (n,) between its frames (n + 1, 4, 4). A capsule that holds the light itself
    carries it and covers nothing.
    """
    for link, (start, end, radius) in enumerate(zip(frames[:-1, :3, 3], frames[1:, :3, 3], radii_m, strict=True)):
        half = 0.5 * float(np.linalg.norm(end - start))
        middle = 0.5 * (start + end)
        if radius <= 0.0 or _distance(eye_m, light_m, middle, middle) > half + radius:
            continue  # far off, as nearly always
        if _distance(start, end, light_m, light_m) <= radius:
            continue
        if _distance(start, end, eye_m, light_m) <= radius:
            return link
    return None


def _distance(a: Array, b: Array, c: Array, d: Array) -> float:
    """Return the distance of the segments a-b and c-d (Ericson, Real-Time Collision Detection, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = float(u @ u), float(v @ v), float(u @ v), float(u @ w), float(v @ w)
    apart = uu * vv - uv * uv
    s = min(1.0, max(0.0, (uv * vw - uw * vv) / apart)) if apart > SAME * uu * vv else 0.0
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if not 0.0 <= t <= 1.0 or vv == 0.0:  # beyond the second's ends: its end, and what of the first is nearest to it
        t = min(1.0, max(0.0, t))
        s = min(1.0, max(0.0, (uv * t - uw) / uu)) if uu > 0.0 else 0.0
    away = w + s * u - t * v
    return math.sqrt(float(away @ away))
