"""Random paths, run on a virtual clock through loop and guard, and a judge of what was sent that has all by itself.

The judge knows the arm's table, the path as it was given and the joints that were sent in each cycle. Kinematics,
distances, speeds and rotations are worked out here in plain numpy; of the product it takes only what it told.
benchmarks/play_paths.py runs hundreds of paths.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import ManualClock
from armsight.control.guard import Guard, Limits
from armsight.control.loop import ControlLoop
from armsight.control.play import PathPlan, PathSource, PlaySettings, Weave, plan_path
from armsight.drivers import RobotState
from armsight.drivers.protocols import Sent
from armsight.errors import DataRefused, UsageError
from armsight.kinematics import preset
from armsight.kinematics.closed_form import singularity_distance
from armsight.records import JointReading, TaughtPath

Array = NDArray[np.float64]
ARMS = ("puma761", "ur10", "irb120", "korayem6r", "stanford-rrp")
CYCLES_S = (0.004, 0.008, 0.012, 0.02)
FINE_M = 2e-5
"""Between the places at which the judge draws a path with a weave."""


@dataclass
class Case:
    """One path for one arm that stands at q, and how it is run. weave: amplitude and wavelength, m, or none."""

    arm: object
    q: Array
    path: TaughtPath
    settings: PlaySettings
    limits: Limits
    cycle_s: float
    override: Callable[[int], float]
    pauses: dict[int, bool]
    steady: bool
    kind: str
    weave: tuple[float, float] | None = None


@dataclass
class Ran:
    """What came of it: deviations beyond what was told in m and rad, shares of speed and time, refusal in words."""

    kind: str
    arm: str
    refused: str = ""
    finished: bool = False
    told_m: float = np.nan
    off_m: float = np.nan
    off_rad: float = np.nan
    missed_m: float = np.nan
    speed: float = np.nan
    time: float = np.nan
    planned_s: float = np.nan
    limited: int = 0
    cycles: int = 0
    states: set[str] = field(default_factory=set)

    @property
    def faults(self) -> list[str]:
        """Return what is not as told."""
        if self.refused:
            return []
        found = {
            "not finished": not self.finished,
            "off the path": self.off_m > self.told_m + 5e-5,
            "part of it left out": self.missed_m > self.told_m + 5e-5,
            "turned": self.off_rad > 2e-3,
            # at an arc's ends rounding turns the weave, and its places beside the arc go 3.5 % faster than the seam
            "too fast": self.speed > (1.05 if self.kind == "woven arc" else 1.02),
            "time": not np.isnan(self.time) and abs(self.time - 1.0) > 0.05,
        }
        return [name for name, is_so in found.items() if is_so]


def tips(arm, q: Array) -> tuple[Array, Array]:
    """Return position (n, 3) and rotation (n, 3, 3) of the tip in base axes at joints (n, j), from the arm's table."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for k, joint in enumerate(arm.joints):
        slides = not arm.revolute[k]
        turn = joint.theta_rad + (0.0 * q[:, k] if slides else joint.sign * q[:, k])
        d = joint.d_m + (joint.sign * q[:, k] if slides else 0.0 * q[:, k])
        c, s, ca, sa = np.cos(turn), np.sin(turn), np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
        A = np.zeros((len(q), 4, 4))
        A[:, 0] = np.stack([c, -s * ca, s * sa, joint.a_m * c], axis=1)
        A[:, 1] = np.stack([s, c * ca, -c * sa, joint.a_m * s], axis=1)
        A[:, 2, 1:3], A[:, 2, 3], A[:, 3, 3] = (sa, ca), d, 1.0
        T = T @ A
    T = T @ arm.T_flange_tool.as_matrix()
    return T[:, :3, 3], T[:, :3, :3]


def to_polyline(p: Array, line: Array) -> tuple[Array, Array]:
    """Return the distance (n,) of positions (n, 3) from a polyline (m, 3), and the length along it (n,) there."""
    a, d = line[:-1], np.diff(line, axis=0)
    size2 = np.maximum((d * d).sum(axis=1), 1e-30)
    s = np.concatenate([[0.0], np.cumsum(np.sqrt((d * d).sum(axis=1)))])
    off, at = np.empty(len(p)), np.empty(len(p))
    for first in range(0, len(p), 512):
        part = p[first : first + 512, None] - a[None]
        share = np.clip((part * d).sum(axis=2) / size2, 0.0, 1.0)
        gap = np.linalg.norm(part - share[..., None] * d, axis=2)
        best = gap.argmin(axis=1)
        rows = np.arange(len(best))
        off[first : first + 512] = gap[rows, best]
        at[first : first + 512] = s[best] + share[rows, best] * np.sqrt(size2[best])
    return off, at


class Arm:
    """A robot that stands where it was last told to go."""

    name, takes_poses, state = "arm", False, RobotState.READY

    def __init__(self, q: Array, cycle_s: float, clock: ManualClock) -> None:
        self.q, self.cycle_s, self._clock, self.n_joints, self._n = q.copy(), cycle_s, clock, len(q), 0

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def read(self) -> JointReading:
        self._n += 1
        return JointReading(q=self.q, t_s=self._clock.now_s(), sequence=self._n, source="arm")

    def step_joints(self, step: Array) -> Sent:
        self.q = self.q + step
        return Sent(q=self.q, t_s=self._clock.now_s(), sequence=self._n)

    def stop(self) -> None:
        """Stand."""

    reset = stop


def run(case: Case, planner: Callable[..., PathPlan] = plan_path) -> Ran:
    """Plan and run a case, and judge what was sent."""
    ran = Ran(kind=case.kind, arm=case.arm.name)
    try:
        plan = planner(case.path, case.arm, case.limits, case.q, case.settings)
    except (DataRefused, UsageError) as error:
        ran.refused = str(error)
        return ran
    clock = ManualClock()
    robot = Arm(case.q, case.cycle_s, clock)
    source = PathSource(plan, override=case.override(0))
    sent, stages = [], []

    def until(status) -> bool:
        ran.cycles += 1
        sent.append(robot.q)
        at = source.progress
        stages.append(at.stage)
        ran.limited += bool(status.limited) or (status.guard.value != "running" and not at.paused)
        ran.states.add(f"{status.guard.value} {status.why} {status.limited}")
        source.override = case.override(ran.cycles)
        if ran.cycles in case.pauses:
            (source.pause if case.pauses[ran.cycles] else source.resume)()
        return at.stage == "finished"

    loop = ControlLoop(robot, Guard(case.arm, case.limits, case.cycle_s), source, clock, enabled=lambda: True)
    loop.run(for_s=20.0 * plan.time_s + 20.0, until=until)
    ran.finished = source.progress.stage == "finished"
    if "path" in stages:
        judge(case, ran, plan, np.array(sent), np.array(stages))
    return ran


def judge(case: Case, ran: Ran, plan: PathPlan, q: Array, stage: NDArray) -> None:
    """Hold the joints that were sent (n, j) against the path as it was given and what was told of it."""
    p, R = tips(case.arm, q)
    took_s = int((stage != "finished")[(q != q[0]).any(axis=1)].sum()) * case.cycle_s
    ran.told_m, ran.planned_s = plan.rounded_m, plan.time_s
    if case.steady:
        ran.time = took_s * case.override(0) / plan.time_s
    rows = case.path.T_world_tip
    line, _ = drawn(case)
    p, R = p[stage == "path"], R[stage == "path"]
    off, at = to_polyline(p, line)
    ran.off_m = float(off.max())
    ran.missed_m = float(
        max(0.0, (cKDTree(p).query(line)[0] - 0.51 * np.linalg.norm(np.diff(p, axis=0), axis=1).max()).max())
    )
    if not case.settings.keep_rotation:
        ran.off_rad = turned(p[::5], R[::5], rows, ran.told_m + 0.5 * case.settings.blend_m) - plan.rounded_rad
    asked = np.where(np.isfinite(case.path.speed_m_s), case.path.speed_m_s, case.settings.speed_m_s)
    if case.weave is not None:
        _, at = to_polyline(p, rows[:, :3, 3])
        # beside an arc of chords the nearest place leaps from one to the next: the mean of many cycles is looked at
        n = 20 if case.kind == "woven arc" else 1
        ran.speed = float((np.abs(at[n:] - at[:-n]) / (n * case.cycle_s)).max() / asked.max())
    else:
        ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rows[:, :3, 3], axis=0), axis=1))])
        near = 1.5e-3 + 2.0 * plan.rounded_m
        most = np.zeros(len(at))
        for row in range(len(rows) - 1):
            here = (at > ends[row] - near) & (at < ends[row + 1] + near)
            most[here] = np.maximum(most[here], asked[row])
        speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / case.cycle_s
        ran.speed = float((speed / np.maximum(most[1:], most[:-1])).max())


def drawn(case: Case) -> tuple[Array, Array]:
    """Return the line (m, 3) as it was drawn, with its weave, and lengths (m,) along it without one."""
    T = case.path.T_world_tip
    xyz = T[:, :3, 3]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=1))])
    if case.weave is None:
        return xyz, s
    amplitude, wavelength = case.weave
    at = np.linspace(0.0, s[-1], int(s[-1] / FINE_M))
    places = np.stack([np.interp(at, s, xyz[:, k]) for k in range(3)], axis=1)
    tangent = np.gradient(np.stack([np.interp(at, s, xyz[:, k]) for k in range(3)], axis=1), at, axis=0)
    if case.settings.keep_rotation:
        z = np.broadcast_to(tips(case.arm, case.q[None])[1][0, :, 2], places.shape)
    else:
        z = np.stack([np.interp(at, s, T[:, k, 2]) for k in range(3)], axis=1)
    across = np.cross(z, tangent)
    across /= np.linalg.norm(across, axis=1)[:, None]
    return places + amplitude * np.sin(2.0 * np.pi * at / wavelength)[:, None] * across, at


def turned(p: Array, R: Array, rows: Array, near_m: float) -> float:
    """Return how far rotations (n, 3, 3) at places (n, 3) are at most from those of a path's rows near there."""
    places, turns = [], []
    for a, b in itertools.pairwise(rows):
        turn = (Rotation.from_matrix(b[:3, :3]) * Rotation.from_matrix(a[:3, :3]).inv()).as_rotvec()
        far = np.linalg.norm(b[:3, 3] - a[:3, 3])
        share = np.linspace(0.0, 1.0, 2 + int(max(far / 5e-5, np.linalg.norm(turn) / 2e-3)))
        places.append(a[:3, 3] + share[:, None] * (b[:3, 3] - a[:3, 3]))
        turns.append((Rotation.from_rotvec(share[:, None] * turn) * Rotation.from_matrix(a[:3, :3])).as_quat())
    tree, quats = cKDTree(np.concatenate(places)), np.concatenate(turns)
    worst = 0.0
    for here, mine in zip(tree.query_ball_point(p, near_m), Rotation.from_matrix(R).as_quat(), strict=True):
        if here:
            worst = max(worst, 2.0 * np.arccos(min(1.0, float(np.abs(quats[here] @ mine).max()))))
    return worst


KINDS = ("line", "polyline", "arc", "weave", "woven arc", "turning line", "turning polyline", "turning arc", "in place")


def cases(seed: int, kind: str | None = None, arm_name: str | None = None) -> Case:
    """Return a random path for a random arm."""
    rng = np.random.default_rng([46, seed])
    arm_name = arm_name or ARMS[seed % len(ARMS)]
    arm = replace(
        preset(arm_name),
        T_flange_tool=RigidTransform.from_translation([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0, 0.2)]),
    )
    free = arm.n >= 6
    kind = kind or str(rng.choice(KINDS if free else KINDS[:5]))
    q = stand(arm, rng)
    xyz, turns = OUTLINES[kind](rng)
    start, R = tips(arm, q[None])
    pose = RigidTransform.from_components(start[0], Rotation.from_matrix(R[0]))
    tilt = RigidTransform.from_components(rng.uniform(-0.015, 0.015, 3), Rotation.from_rotvec(rng.normal(0.0, 0.1, 3)))
    lie = RigidTransform.from_rotation(
        Rotation.random(rng=rng) if "we" not in kind and "wo" not in kind else Rotation.identity()
    )
    T = np.array(
        [
            (pose * tilt * RigidTransform.from_components(lie.apply(x), turn)).as_matrix()
            for x, turn in zip(xyz, turns, strict=True)
        ]
    )
    speeds = np.full(len(T), np.nan)
    if rng.random() < 0.3:
        speeds = np.repeat(rng.uniform(0.02, 0.08, -(-len(T) // 8)), 8)[: len(T)]
    path = TaughtPath.of_poses(RigidTransform.from_matrix(T), parent="base", speed_m_s=speeds)
    weave = None
    if kind in ("weave", "woven arc"):
        weave = (float(rng.uniform(0.0005, 0.003)), float(rng.uniform(0.004, 0.012)))
    settings = PlaySettings(
        speed_m_s=float(np.exp(rng.uniform(np.log(0.02), np.log(0.09)))),
        blend_m=float(rng.uniform(0.001, 0.006)),
        weave=Weave() if weave is None else Weave.parse(f"sine:{weave[0]}:{weave[1]}"),
        approach_speed_m_s=0.08,
        retract_m=float(rng.uniform(0.0, 0.03)),
        keep_rotation=not free,
    )
    limits = (
        Limits()
        if rng.random() < 0.5
        else Limits(
            speed_m_s=float(rng.uniform(0.05, 0.3)),
            acceleration_m_s2=float(rng.uniform(0.5, 4.0)),
            jerk_m_s3=float(rng.uniform(30.0, 300.0)),
            turn_rad_s=float(rng.uniform(0.3, 2.0)),
        )
    )
    override, pauses, steady = how(rng)
    return Case(
        arm,
        q,
        path,
        settings,
        limits,
        float(rng.choice(CYCLES_S, p=(0.05, 0.15, 0.3, 0.5))),
        override,
        pauses,
        steady,
        kind,
        weave,
    )


def stand(arm, rng: np.random.Generator) -> Array:
    """Return readings far from singularities and from the ends of the joints' ranges."""
    low = np.where(np.isfinite(arm.lower), arm.lower, -2.5)
    high = np.where(np.isfinite(arm.upper), arm.upper, 2.5)
    if arm.n == 3:
        low, high = np.array([-2.0, 0.6, 0.4]), np.array([2.0, 1.2, 0.8])
    while True:
        q = low + (high - low) * rng.uniform(0.3, 0.7, arm.n)
        if arm.n == 3 or singularity_distance(arm, arm.values(q)) > 0.2:
            return q


def how(rng: np.random.Generator) -> tuple[Callable[[int], float], dict[int, bool], bool]:
    """Return the override of each cycle, when it is paused and goes on, and whether both stay as they are."""
    mode, seed, base = rng.integers(4), int(rng.integers(1 << 30)), float(rng.uniform(0.4, 1.0))
    if mode == 0:
        return (lambda _: 1.0), {}, True
    if mode == 1:
        return (lambda _: base), {}, True
    pauses = {}
    at = 0
    for _ in range(rng.integers(0, 6)):
        at += int(rng.integers(5, 400))
        pauses[at] = True
        at += int(rng.integers(1, 60))
        pauses[at] = False
    if mode == 2:
        shares = np.random.default_rng(seed).uniform(0.1, 1.0, 4096)  # another one in every cycle
        return (lambda k: float(shares[k % 4096])), pauses, False
    steps = np.random.default_rng(seed).choice([0.2, 0.5, 1.0], 4096)
    return (lambda k: float(steps[(k // 97) % 4096])), pauses, False


def still(xyz: Array) -> tuple[Array, list[Rotation]]:
    return xyz, [Rotation.identity()] * len(xyz)


def line(rng: np.random.Generator) -> tuple[Array, list[Rotation]]:
    return still(np.outer(np.linspace(0.0, 1.0, rng.integers(2, 20)), [rng.uniform(0.02, 0.08), 0.0, 0.0]))


def polyline(rng: np.random.Generator) -> tuple[Array, list[Rotation]]:
    steps = rng.normal(size=(rng.integers(2, 6), 3))
    steps *= (rng.uniform(0.012, 0.03, len(steps)) / np.linalg.norm(steps, axis=1))[:, None]
    return still(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))


def arc(rng: np.random.Generator, step_m: float = 1e-3) -> tuple[Array, list[Rotation]]:
    radius, angle = rng.uniform(0.01, 0.03), rng.uniform(0.5, 2.0 * np.pi)
    at = np.linspace(0.0, angle, 1 + int(np.ceil(radius * angle / step_m)))
    return still(radius * np.stack([np.sin(at), 1.0 - np.cos(at), 0.0 * at], axis=1))


def fine_arc(rng: np.random.Generator) -> tuple[Array, list[Rotation]]:
    return arc(rng, 2.5e-4)


def turning(outline: Callable) -> Callable:
    def turned_outline(rng: np.random.Generator) -> tuple[Array, list[Rotation]]:
        xyz, _ = outline(rng)
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        total = rng.uniform(0.1, min(2.0 * np.pi, 1.4 * (len(xyz) - 1)))
        if rng.random() < 0.5:
            axis = np.array([0.0, 0.0, 1.0])
        return xyz, [Rotation.from_rotvec(share * total * axis) for share in np.linspace(0.0, 1.0, len(xyz))]

    return turned_outline


def in_place(rng: np.random.Generator) -> tuple[Array, list[Rotation]]:
    before, after = rng.uniform(0.01, 0.03, 2)
    total, count = rng.uniform(0.5, 2.0 * np.pi), int(rng.integers(8, 30))
    xyz = np.array([[0.0, 0.0, 0.0], *[[before, 0.0, 0.0]] * (count + 1), [before, after, 0.0]])
    turns = [0.0, *np.linspace(0.0, total, count + 1), total]
    axis = np.array([0.0, 0.0, 1.0]) if rng.random() < 0.7 else np.array([0.6, 0.0, 0.8])
    return xyz, [Rotation.from_rotvec(angle * axis) for angle in turns]


OUTLINES: dict[str, Callable] = {
    "line": line,
    "polyline": polyline,
    "arc": arc,
    "weave": line,
    "woven arc": fine_arc,
    "turning line": turning(line),
    "turning polyline": turning(polyline),
    "turning arc": turning(arc),
    "in place": in_place,
}
