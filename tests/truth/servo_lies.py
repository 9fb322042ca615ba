"""A small servo cell, lies that its cameras may tell from a moment on, and a judge who looks at the true arm alone.

The arm is a UR10 with a lag, encoders in steps, joints and a hand-eye calibration that are a little off; servo and
guard are the product's. Poses are made, not measured: the true one with the noise that their covariance claims. The
judge knows nothing of the servo: it holds the true tool against that of the same run without the lie.
"""

from __future__ import annotations

import copy
import copyreg
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Guard, GuardState, Inputs, Limits
from armsight.control.guard.motion import Course, Planner
from armsight.control.servo import Mount, ServoSettings, ServoSource, Turning, chosen_gain, on_axis
from armsight.kinematics import presets
from armsight.optics import Camera, parallel_rig
from armsight.records import JointReading, PoseStatus, TargetPose, spot_target
from armsight.units import DEG, MM

for shared in (Course, Planner):  # nothing changes them, and what they hold of ruckig cannot be copied
    copyreg.pickle(shared, lambda _: "shared")  # type: ignore[arg-type, return-value]

Array = Any
ARM = presets.ur10()
RIG = parallel_rig(Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0), 0.1)
TARGET = spot_target({"A": (-0.05, 0.0, 0.0), "B": (0.05, 0.04, 0.0), "C": (0.03, -0.04, 0.0)})
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
CYCLE_S, FRAME_S, LATENCY_S, LAG_S = 0.024, 1.0 / 30.0, 0.04, 0.05
NOISE = np.array([1.2e-5, 1.2e-5, 1.3e-4, 3e-3, 3e-3, 6e-4])  # of a pose, m and rad, as in benchmarks/servo.py
HANDEYE = (3e-4, 0.03 * DEG)
JOINT_RAD, ENCODER_RAD = 2e-4, 1e-5
FOCAL_PX, BASELINE_M = 500.0, 0.1
T_FLANGE_CAMERA = RigidTransform.from_components([0.05, 0.0, 0.06], Rotation.from_rotvec([0.0, 0.1, 0.4]))
ROWS_PX, DISTANCES = 1.0, 0.02
"""Both views of a light, and the lights among each other: measuring refuses beyond 4 sigma, which is less than this."""
CAMERA_M, TOOL_M, STANDING_M = 0.5, 0.15, 0.8
VIEW = 0.6
"""Tangent of the half angle that the cameras see."""


class Reaches:
    """A hand that leads a target from place to place: reaches of least jerk, rests and reversals, with a tremor."""

    def __init__(self, rng: np.random.Generator, T_start: Array, speed_m_s: float, *, reach_m: float = 0.12) -> None:
        """speed_m_s: the fastest moment of a reach; zero for a hand that rests. T_start (4, 4): in base axes."""
        self.T_start, self._t_s, self._xyz = T_start, [0.0], [np.zeros(3)]
        while speed_m_s and self._t_s[-1] < 60.0:
            to = rng.uniform(-reach_m, reach_m, 3)
            way = float(np.linalg.norm(to - self._xyz[-1]))
            fastest = speed_m_s * rng.uniform(0.5, 1.0)
            self._t_s += [self._t_s[-1] + max(1.875 * way / fastest, 0.25)]
            self._xyz += [to]
            if rng.random() < 0.4:  # else the hand turns back at once
                self._t_s += [self._t_s[-1] + rng.uniform(0.05, 1.0)]
                self._xyz += [to]
        self._hz, self._phase = rng.uniform(7.0, 11.0, 6), rng.uniform(0.0, 2.0 * np.pi, 6)
        self._slow_hz, self._slow = rng.uniform(0.05, 0.3, 3), rng.uniform(0.0, 0.06, 3) * bool(speed_m_s)
        self._tremor = np.repeat([7e-5, 4e-4], 3)

    def __call__(self, t_s: float) -> Array:
        """Return the pose (4, 4) in base axes."""
        k = min(int(np.searchsorted(self._t_s, t_s, side="right")), len(self._t_s) - 1)
        way = np.zeros(3)
        if k:
            s = min((t_s - self._t_s[k - 1]) / (self._t_s[k] - self._t_s[k - 1]), 1.0)
            way = self._xyz[k - 1] + (self._xyz[k] - self._xyz[k - 1]) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        shake = self._tremor * np.sin(2.0 * np.pi * self._hz * t_s + self._phase)
        turn = self._slow * np.sin(2.0 * np.pi * self._slow_hz * t_s) + shake[3:]
        T = np.array(self.T_start)
        T[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3]
        T[:3, 3] += way + shake[:3]
        return T


@dataclass
class Log:
    """Where the tool truly was, (4, 4), cycle by cycle; what the guard did and why; how far the target truly was."""

    t_s: list[float] = field(default_factory=list)
    tool: list[Array] = field(default_factory=list)
    states: list[GuardState] = field(default_factory=list)
    why: list[str] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)


class Cell:
    """One run: `go` until a moment; a copy by `branch` goes on from there by itself."""

    def __init__(
        self,
        seed: int,
        mount: Mount,
        hand_m_s: float,
        *,
        limit_m_s: float = 0.1,
        reach_m: float = 0.12,
        frame_s: float = FRAME_S,
    ):
        rng = np.random.default_rng([seed, 7])
        self.seed, self.mount, self.frame_s = seed, mount, frame_s
        carried = mount is Mount.EYE_IN_HAND
        off = RigidTransform.from_components(
            HANDEYE[0] * rng.normal(size=3), Rotation.from_rotvec(HANDEYE[1] * rng.normal(size=3))
        )
        tilt = Rotation.from_rotvec([*(rng.uniform(10.0, 25.0) * DEG * np.array(_direction(rng))), rng.uniform(-1, 1)])
        tilted = RigidTransform.from_rotation(tilt)
        desired = on_axis(T_FLANGE_CAMERA, CAMERA_M) * tilted if carried else on_axis(RigidTransform.identity(), TOOL_M)
        start = ARM.fk(Q) @ desired.as_matrix()
        seen = (RigidTransform.from_translation([0.0, 0.0, STANDING_M]) * tilted).as_matrix()
        self.T_parent_camera = T_FLANGE_CAMERA.as_matrix() if carried else start @ np.linalg.inv(seen)
        self.T_flange_desired = desired.as_matrix()
        self.hand = Reaches(rng, start, hand_m_s, reach_m=reach_m)
        self.off_q = JOINT_RAD * rng.normal(size=6)
        gain = chosen_gain(None, max(CYCLE_S, frame_s), LATENCY_S + LAG_S + CYCLE_S)
        settings = ServoSettings(
            mount=mount,
            T_parent_camera=RigidTransform.from_matrix(self.T_parent_camera) * off,
            T_flange_desired=desired,
            gain_t=gain.used,
            gain_r=gain.used,
            arm_lag_s=2.0 * CYCLE_S,
            turning=Turning.ALIGN if carried else Turning.KEEP,
        )
        self.source = ServoSource(ARM, RIG, TARGET, settings, CYCLE_S)
        self.guard = Guard(ARM, Limits(speed_m_s=limit_m_s), CYCLE_S)
        self.guard.begin(Q, 0.0)
        self.n, self.frame = 0, 1
        self.q_sent, self.q = Q.copy(), [(-CYCLE_S, Q.copy()), (0.0, Q.copy())]
        self.clean: dict[int, Array] = {}
        self.hidden: list[tuple[float, float]] = []
        self.lie: Lie | None = None
        self.log = Log()

    status = PoseStatus.OK

    @property
    def t_s(self) -> float:
        return self.n * CYCLE_S

    def branch(self) -> Cell:
        """Return a copy that shares only what nobody changes."""
        fixed = (ARM, RIG, TARGET, self.hand, self.source.settings, self.guard.limits, self.source._track._packed)
        other = copy.deepcopy(self, {id(item): item for item in fixed})
        other.log = Log()
        return other

    def flange_at(self, t_s: float) -> Array:
        """Return the true pose (4, 4) of the flange in base axes."""
        for (t0, q0), (t1, q1) in zip(self.q[-2::-1], self.q[:0:-1], strict=True):
            if t_s >= t0:
                return ARM.fk(q0 + (q1 - q0) * (t_s - t0) / (t1 - t0) + self.off_q)
        return ARM.fk(self.q[0][1] + self.off_q)

    def go(self, until_s: float, until: Callable[[Cell], bool] | None = None) -> Cell:
        """Let cycles and frames go on."""
        while self.t_s < until_s - 1e-9 and not (until is not None and until(self)):
            self.n += 1
            t_s = self.t_s
            self.q = [*self.q[-60:], (t_s, self.q[-1][1] + (self.q_sent - self.q[-1][1]) * -np.expm1(-CYCLE_S / LAG_S))]
            while self.frame * self.frame_s + LATENCY_S <= t_s:
                self._see(self.frame, t_s)
                self.frame += 1
            self._cycle(t_s)
        return self

    def _see(self, k: int, now_s: float) -> None:
        t_s = k * self.frame_s
        carried = self.mount is Mount.EYE_IN_HAND
        T_base_rig = self.flange_at(t_s) @ self.T_parent_camera if carried else self.T_parent_camera
        T = np.linalg.inv(T_base_rig) @ self.hand(t_s)
        self.clean[k] = T
        shown: Array | None = self.noisy(T, k)
        if T[2, 3] < 0.05 or np.abs(T[:2, 3]).max() > VIEW * T[2, 3] or any(a <= t_s < b for a, b in self.hidden):
            shown = None
        elif self.lie is not None:
            shown, t_s = self.lie.shown(self, k, t_s)
        if shown is None:
            pose = TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig")
        else:
            pose = TargetPose(
                t_s=t_s,
                status=self.status,
                parent="rig",
                spots=("A", "B", "C"),
                T_parent_target=shown,
                covariance=np.diag(NOISE**2),
            )
        self.source.observe(pose, t_s, now_s)

    def noisy(self, T: Array, k: int, times: float = 1.0) -> Array:
        """Return a pose with the noise of frame k."""
        noise = times * NOISE * np.random.default_rng([self.seed, 8, k]).normal(size=6)
        out = np.array(T)
        out[:3, :3] = Rotation.from_rotvec(noise[3:]).as_matrix() @ T[:3, :3]
        out[:3, 3] += noise[:3]
        return out

    def _cycle(self, t_s: float) -> None:
        guard, source = self.guard, self.source
        read = np.round(self.q[-1][1] / ENCODER_RAD) * ENCODER_RAD
        reading = JointReading(q=read, t_s=t_s, sequence=self.n, source="cell")
        wanted = source.next(guard.cycle_state(t_s, reading))
        target, age_s = source.target(t_s)
        decision = guard.step(wanted, reading, Inputs(now_s=t_s, enabled=True, target=target, target_age_s=age_s))
        if decision.step is not None:
            self.q_sent = self.q_sent + decision.step
            guard.acknowledge(self.q_sent)
        T, log = self.flange_at(t_s), self.log
        log.t_s.append(t_s)
        log.tool.append(T)
        log.states.append(decision.state)
        log.why.append(getattr(wanted, "why", "") or decision.why)
        log.off_m.append(float(np.linalg.norm(self.hand(t_s)[:3, 3] - (T @ self.T_flange_desired)[:3, 3])))


def _direction(rng: np.random.Generator) -> tuple[float, float]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.cos(angle), np.sin(angle)


class Lie:
    """What the cameras say from a moment on; tell(lie, cell, k, t_s) gives the pose (or None) and its stamp."""

    def __init__(self, name: str, seed: int, begun_s: float) -> None:
        self.tell = LIES[name].tell
        self.begun_s = begun_s
        self.first = 0
        self.rng = np.random.default_rng([seed, 9])
        self.drawn: dict[str, Any] = {}

    def shown(self, cell: Cell, k: int, t_s: float) -> tuple[Array | None, float]:
        if t_s < self.begun_s:
            return cell.noisy(cell.clean[k], k), t_s
        self.first = self.first or k
        told = self.tell(self, cell, k, t_s)
        return told if isinstance(told, tuple) else (told, t_s)

    def draw(self, name: str, make: Callable[[np.random.Generator], Any]) -> Any:
        """Return what is drawn once a run."""
        if name not in self.drawn:
            self.drawn[name] = make(self.rng)
        return self.drawn[name]

    def since(self, t_s: float) -> float:
        return t_s - self.begun_s


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A lie; hand, mount, frame_s: those it is told with; well: it begins as the target is followed within 5 mm.

    open: the honest thing that it cannot be told from.
    """

    tell: Callable[[Lie, Cell, int, float], Any]
    hand: str = "any"
    mount: Mount | None = None
    well: bool = False
    open: str = ""
    frame_s: float = FRAME_S


def frozen(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    return cell.noisy(cell.clean[lie.first], lie.first)


def frozen_noisy(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    return cell.noisy(cell.clean[lie.first], k)


def turned(axis: Array) -> Callable[..., Array]:
    def tell(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
        T = np.array(cell.clean[k])
        T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(axis).as_matrix()
        return cell.noisy(T, k)

    return tell


def ambiguous(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    """The other pose at which a flat target looks nearly the same: its normal mirrored at the line of sight."""
    T = np.array(cell.clean[k])
    normal, sight = T[:3, 2], T[:3, 3] / np.linalg.norm(T[:3, 3])
    normal = normal if normal @ sight > 0.0 else -normal
    axis = np.cross(normal, sight)
    angle = np.arcsin(np.clip(np.linalg.norm(axis), 0.0, 1.0))
    T[:3, :3] = Rotation.from_rotvec(2.0 * angle * axis / np.linalg.norm(axis)).as_matrix() @ T[:3, :3]
    return cell.noisy(T, k)


def behind(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    T = cell.noisy(cell.clean[k], k)
    T[2, 3] *= -1.0
    return T


def aside(by_m: float, *, every: int = 1) -> Callable[..., Array]:
    def tell(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
        T = cell.noisy(cell.clean[k], k)
        way = lie.draw("way", lambda rng: _unit(rng))
        if k % every == 0:
            T[:3, 3] += by_m * way
        return T

    return tell


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def creeping(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    T = cell.noisy(cell.clean[k], k)
    T[:3, 3] += lie.draw("way", lambda rng: _unit(rng) * rng.uniform(0.005, 0.02)) * lie.since(t_s)
    return T


def scaled(share: float, in_s: float = 0.0) -> Callable[..., Array]:
    def tell(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
        T = cell.noisy(cell.clean[k], k)
        sign = lie.draw("sign", lambda rng: rng.choice([-1.0, 1.0]))
        T[:3, 3] *= 1.0 + sign * share * (min(lie.since(t_s) / in_s, 1.0) if in_s else 1.0)
        return T

    return tell


def exchanged(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    """Lights A, B, C taken for B, C, A: what fits them best is turned about the normal, and elsewhere."""
    xyz = TARGET.xyz_m
    seen = cell.clean[k][:3, :3] @ np.roll(xyz, 1, axis=0).T + cell.clean[k][:3, 3:]
    T = np.eye(4)
    T[:3, :3] = Rotation.align_vectors((seen - seen.mean(axis=1, keepdims=True)).T, xyz - xyz.mean(axis=0))[
        0
    ].as_matrix()
    T[:3, 3] = seen.mean(axis=1) - T[:3, :3] @ xyz.mean(axis=0)
    return cell.noisy(T, k)


def mirrored(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    M = np.diag([-1.0, 1.0, 1.0, 1.0])
    return cell.noisy(M @ cell.clean[k] @ M, k)


def late(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    back = round(min(0.25 * lie.since(t_s), 0.5) / cell.frame_s)
    return cell.noisy(cell.clean[max(k - back, 1)], k)


def stamps(lie: Lie, cell: Cell, k: int, t_s: float) -> tuple[Array, float]:
    share = lie.draw("share", lambda rng: rng.choice([0.5, 0.9, 1.1, 2.0]))
    return cell.noisy(cell.clean[k], k), lie.begun_s + share * lie.since(t_s)


def half_frozen(lie: Lie, cell: Cell, k: int, t_s: float) -> Array | None:
    """The right camera shows the moment at which the lie began: depth goes astray with each way to the side.

    Where rows or the lights' distances then disagree by what measuring refuses, there is no pose.
    """
    T, T0 = np.array(cell.clean[k]), cell.clean[lie.first]
    left, right = FOCAL_PX * T[:2, 3] / T[2, 3], FOCAL_PX * (T0[:2, 3] - [BASELINE_M, 0.0]) / T0[2, 3]
    scale = FOCAL_PX * BASELINE_M / max(left[0] - right[0], 5.0) / T[2, 3]
    if abs(left[1] - right[1]) > ROWS_PX or abs(scale - 1.0) > DISTANCES:
        return None
    T[:3, 3] *= scale
    return cell.noisy(T, k)


def two_back(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    return cell.noisy(cell.clean[max(k - 2, 1)], k - 2)


def rotation_wrong(by_rad: float) -> Callable[..., Array]:
    def tell(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
        T = cell.noisy(cell.clean[k], k)
        T[:3, :3] = Rotation.from_rotvec(lie.draw("turn", lambda rng: by_rad * _unit(rng))).as_matrix() @ T[:3, :3]
        return T

    return tell


def loud(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    return cell.noisy(cell.clean[k], k, 20.0)


def millimetres(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    T = cell.noisy(cell.clean[k], k)
    T[:3, 3] /= MM
    return T


def pictures_turned(deg: float, dark_s: float = 0.0) -> Callable[..., Array | None]:
    """The pictures of both cameras are turned about their axis; for a while before there are none."""

    def tell(lie: Lie, cell: Cell, k: int, t_s: float) -> Array | None:
        if lie.since(t_s) < dark_s:
            return None
        T = cell.noisy(cell.clean[k], k)
        D = np.eye(4)
        D[:3, :3] = Rotation.from_euler("z", deg, degrees=True).as_matrix()
        return D @ T

    return tell


def to_and_fro(lie: Lie, cell: Cell, k: int, t_s: float) -> Array:
    """The last second of pictures is played backwards, forwards, and so on, their noise with them."""
    last = round(1.0 / cell.frame_s)
    phase = (k - lie.first) % (2 * last)
    old = max(lie.first - min(phase, 2 * last - phase), 1)
    return cell.noisy(cell.clean[old], old)


LIES: dict[str, Kind] = {
    "frozen pose, exact": Kind(tell=frozen),
    "frozen pose, fresh noise": Kind(tell=frozen_noisy, hand="moving"),
    "frozen while followed well": Kind(tell=frozen_noisy, hand="moving", mount=Mount.EYE_IN_HAND, well=True),
    "frozen before a still hand": Kind(tell=frozen_noisy, hand="still"),
    "turned by 180 deg about z": Kind(tell=turned(np.array([0.0, 0.0, np.pi]))),
    "turned by 180 deg about x": Kind(tell=turned(np.array([np.pi, 0.0, 0.0]))),
    "other pose of a flat target": Kind(tell=ambiguous),
    "behind the camera": Kind(tell=behind),
    "aside by 30 mm": Kind(tell=aside(0.03)),
    "aside by 100 mm": Kind(tell=aside(0.1)),
    "aside by 300 mm": Kind(tell=aside(0.3)),
    "aside by 60 mm, 14 Hz": Kind(tell=aside(0.06), frame_s=0.07),
    "offset creeps by 5 to 20 mm/s": Kind(tell=creeping, open="a target that moves so"),
    "scale creeps to 20 % in 3 s": Kind(tell=scaled(0.2, 3.0), open="a target that moves so"),
    "scale wrong by 2 %": Kind(tell=scaled(0.02)),
    "scale wrong by 20 %": Kind(tell=scaled(0.2)),
    "lights exchanged": Kind(tell=exchanged),
    "mirrored in x": Kind(tell=mirrored),
    "delay grows to 0.5 s": Kind(tell=late),
    "stamps scaled": Kind(tell=stamps),
    "one camera frozen": Kind(tell=half_frozen),
    "frame before last": Kind(tell=two_back),
    "alternating, 60 mm": Kind(tell=aside(0.06, every=2)),
    "rotation wrong by 20 deg": Kind(tell=rotation_wrong(20.0 * DEG)),
    "rotation wrong by 4 deg": Kind(tell=rotation_wrong(4.0 * DEG)),
    "noise 20 times": Kind(tell=loud),
    "millimetres": Kind(tell=millimetres),
    "pictures turned by 180 deg": Kind(tell=pictures_turned(180.0), mount=Mount.EYE_IN_HAND),
    "dark, then turned by 180 deg": Kind(tell=pictures_turned(180.0, 0.7), mount=Mount.EYE_IN_HAND),
    "dark, then turned by 90 deg": Kind(tell=pictures_turned(90.0, 0.7), mount=Mount.EYE_IN_HAND),
    "played to and fro": Kind(tell=to_and_fro, mount=Mount.EYE_IN_HAND),
}
STARTS_S = (1.5, 4.0)
AFTER_S = 4.0
WELL_M = 0.005
WHOLE_EVERY = 10
"""One run in so many goes on to its end although it is held for good."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a lie did: away_m, how far the tool's own motion took it from where the honest run had it; way_m: all of
    that way added up; turn_rad: the tool's turn likewise; stopped: at rest at the end, by the guard."""

    away_m: float
    way_m: float
    turn_rad: float
    stopped: bool
    why: str


def judged(lied: Log, honest: Log) -> Verdict:
    """Hold the true tool against the honest run's. What counts is what the tool itself did: a step towards where the
    honest one is now is no harm, nor is standing while that goes on, nor being as far before it as one was."""
    at, other = np.array(lied.tool), np.array(honest.tool)[: len(lied.tool)]
    apart = np.linalg.norm(at[1:, :3, 3] - other[1:, :3, 3], axis=1)
    stood = np.linalg.norm(at[:-1, :3, 3] - other[1:, :3, 3], axis=1)
    turned, kept = _angles(at[1:], other[1:]), _angles(at[:-1], other[1:])
    still = float(np.linalg.norm(at[-1, :3, 3] - at[-20, :3, 3])) < 5e-4
    away_m, way_m = harm(apart, stood)
    return Verdict(
        away_m=away_m,
        way_m=way_m,
        turn_rad=harm(turned, kept)[1],
        stopped=still and lied.states[-1] is not GuardState.RUNNING,
        why=lied.why[-1],
    )


def harm(apart: Array, stood: Array) -> tuple[float, float]:
    """Return the most and the sum of all ways away: of distances with each step, and had it not been made."""
    away = most = total = 0.0
    for now, before in zip(apart, stood, strict=True):
        new = min(max(0.0, away + now - before), now)
        total += max(new - away, 0.0)
        away, most = new, max(most, new)
    return most, total


def _angles(A: Array, B: Array) -> Array:
    cosines = 0.5 * (np.einsum("nij,nij->n", A[:, :3, :3], B[:, :3, :3]) - 1.0)
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def begun(
    seed: int, *, hand: str = "any", mount: Mount | None = None, well: bool = False, frame_s: float = FRAME_S
) -> Cell:
    """Return an honest run up to the random moment at which a lie would begin."""
    rng = np.random.default_rng([seed, 6])
    mounts = list(Mount)[seed % 2] if mount is None else mount
    speed = rng.uniform(0.03, 0.08)
    rests = hand == "still" or (hand == "any" and seed % 3 == 0)
    cell = Cell(seed, mounts, 0.0 if rests else speed, frame_s=frame_s)
    cell.go(rng.uniform(*STARTS_S))
    if well:
        cell.go(30.0, lambda cell: cell.log.off_m[-1] < WELL_M and _hand_speed(cell) > 0.02)
    return cell


def _hand_speed(cell: Cell) -> float:
    t = cell.t_s
    return float(np.linalg.norm(cell.hand(t)[:3, 3] - cell.hand(t - 0.05)[:3, 3])) / 0.05


def told(name: str, start: Cell, after_s: float = AFTER_S) -> Log:
    """Return the log of a lie told from where an honest run stands."""
    cell = start.branch()
    cell.lie = Lie(name, cell.seed, cell.t_s)
    whole = cell.seed % WHOLE_EVERY == 0
    return cell.go(cell.t_s + after_s, None if whole else _over).log


def _over(cell: Cell) -> bool:
    """Tell whether the arm has stood for a second in a hold that only a person ends."""
    n, log = round(1.0 / CYCLE_S), cell.log
    return len(log.why) > n and all(map(for_good, log.why[-n:]))


def for_good(why: str) -> bool:
    """Tell whether a hold is one that ends by a person's deed only."""
    return "enable" in why or "wrong premise" in why or "as the arm's motion" in why


def honest(start: Cell, after_s: float = AFTER_S) -> Log:
    """Return the log of the same run without a lie."""
    cell = start.branch()
    return cell.go(cell.t_s + after_s).log


def honest_run(seed: int, seconds: float = 10.0) -> Log:
    """Return a run without a lie, with a hand of up to 0.5 m/s and a target that is hidden now and then."""
    rng = np.random.default_rng([seed, 5])
    cell = Cell(
        seed,
        list(Mount)[seed % 2],
        rng.choice([0.05, 0.1, 0.2, 0.35, 0.5]),
        limit_m_s=rng.choice([0.1, 0.25, 0.6]),
        reach_m=0.15,
        frame_s=rng.choice([FRAME_S, FRAME_S, 0.07]),
    )
    t_s = 1.0
    while t_s < seconds and rng.random() < 0.9:
        t_s += rng.uniform(0.3, 3.0)
        cell.hidden.append((t_s, t_s + rng.uniform(0.1, 1.0)))
        t_s = cell.hidden[-1][1]
    return cell.go(seconds).log
