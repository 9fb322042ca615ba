"""The servo in a simulated cell, judged by where arm and target truly are: at rest, at 100 mm/s, before a random hand.

    python benchmarks/servo.py [static] [ramp] [random] [noisy] [--runs 10] [--noisy-runs 100] [--room workshop]
    python benchmarks/servo.py live --minutes 10

The cell is Pachidis 2005's: a Puma 761 of which the servo knows the nominal geometry only, a mirror rig at its flange,
half a frame's latency, a drive that lags by 60 ms, a controller's cycle of 28 ms and a servo's of 70 ms; and the webcam
cell, whose cameras stand and whose arm brings its tool to the target. Hand-eye calibrations are off by HANDEYE.

Pictures are drawn of the room from where the arm truly is at each exposure. Time is simulated, so that the figures do
not depend on this machine; only the time from a frame in memory to the command is taken by a real clock, less what the
simulated drives take of it, while the target is followed. `live` waits for each picture as a camera would make one, and
records as the command does: what other threads, the garbage collector and the system take of a cycle is in it.
"""

from __future__ import annotations

import argparse
import gc
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import SystemClock
from armsight.control.guard import Guard, GuardState, Limits
from armsight.control.loop import ControlLoop
from armsight.control.servo import Mount, ServoSettings, ServoSource, Turning, chosen_gain, on_axis
from armsight.control.status import QueueSink, RobotStatus
from armsight.measure.poses.pipeline import Setup, Track, measure_pair
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.robot.recorder import LoopRecorder
from armsight.ops.servo.vision import SteppedClock
from armsight.ops.simulation.scenarios import load_scenario
from armsight.ops.sources.pace import live_pace
from armsight.records import PoseStatus, Silent, TargetPose
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.arm_file import arm_from_mapping
from armsight.units import DEG, MM
from armsight_sim.live import CarriedView, LiveCell, live_cell
from armsight_sim.motions import CORNER_S, RoundPath
from bench import machine, table

HANDEYE = (3e-4, 0.03 * DEG)  # standard deviation of a hand-eye calibration per axis, m and rad
NOISE = np.array(
    [1.2e-5, 1.2e-5, 1.3e-4, 3e-3, 3e-3, 6e-4]
)  # of a pose, m and rad: what the pictures' poses scatter by
TABLE1 = {"MAE": (0.0089, 0.0412, 0.0949), "SD": (0.0116, 0.0508, 0.1170)}
SERVO_S = 0.07
DISTANCE_M = 0.6


class TimedRobot:
    """A robot that notes when a command is handed to it, and how long the simulated drives took before that."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self.sent_s = self.own_s = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    @property
    def state(self) -> Any:
        begun_s = time.perf_counter()
        state = self._robot.state
        self.own_s += time.perf_counter() - begun_s
        return state

    def read(self) -> Any:
        begun_s = time.perf_counter()
        reading = self._robot.read()
        self.own_s += time.perf_counter() - begun_s
        return reading

    def step_joints(self, step: Any) -> Any:
        self.sent_s = time.perf_counter()
        return self._robot.step_joints(step)


@dataclass(kw_only=True)
class Run:
    """One run of the servo: what it saw, and where arm and target truly were at each cycle."""

    name: str
    T_world_target: list[RigidTransform] = field(default_factory=list)
    seen_s: list[float] = field(default_factory=list)
    t_s: list[float] = field(default_factory=list)
    off_m: list[Any] = field(default_factory=list)
    speed_m_s: list[float] = field(default_factory=list)
    states: list[GuardState] = field(default_factory=list)
    why: set[str] = field(default_factory=set)
    out_of_view: int = 0
    lost: int = 0
    frames: int = 0
    to_command_ms: list[float] = field(default_factory=list)
    did: list[tuple[str, float, int, int]] = field(default_factory=list)
    gain: float = 0.0
    n: int = 0
    arm_lag_s: float = 0.0

    def within(self, first_s: float, last_s: float) -> np.ndarray:
        t = np.array(self.t_s)
        return (t >= first_s) & (t <= last_s)


def off_by(rng: np.random.Generator) -> RigidTransform:
    """Return the error of a hand-eye calibration."""
    turn = Rotation.from_rotvec(HANDEYE[1] * rng.normal(size=3))
    return RigidTransform.from_components(HANDEYE[0] * rng.normal(size=3), turn)


def servo_run(
    name: str,
    cell: LiveCell,
    clock: SteppedClock,
    seconds: float,
    *,
    delay_s: float,
    seed: int = 1,
    predict: bool = True,
    at_tool: float | None = None,
    noisy: bool = False,
    limits: Limits | None = None,
    sink: QueueSink | None = None,
) -> Run:
    """Follow for a time; at_tool: distance from the flange at which the target is wanted, else on the rig's axis."""
    rng = np.random.default_rng([seed, 77])
    arm = arm_from_mapping(cell.robot.arm_mapping(), name)
    rig = rig_from_mapping(dict(cell.rig), name)
    setup = Setup(rig, target_from_mapping(dict(cell.target), name), overlaid=cell.one_image, pace=live_pace())
    T_parent_camera = cell.T_mount_rig * off_by(rng)
    desired = on_axis(T_parent_camera, DISTANCE_M) if at_tool is None else on_axis(RigidTransform.identity(), at_tool)
    cycle_s = cell.robot.cycle_s
    gain = chosen_gain(None, max(cycle_s, 1.0 / cell.pairs.fps), delay_s)
    settings = ServoSettings(
        mount=Mount.EYE_IN_HAND if cell.carried else Mount.EYE_TO_HAND,
        T_parent_camera=T_parent_camera,
        T_flange_desired=desired,
        gain_t=gain.used,
        gain_r=gain.used,
        arm_lag_s=2.0 * cycle_s,
        turning=Turning.ALIGN if at_tool is None else Turning.KEEP,
        predict=predict,
    )
    source = ServoSource(arm, rig, setup.target, settings, cycle_s)
    run = Run(name=name, gain=gain.used, n=gain.n_delay)
    robot = TimedRobot(cell.robot)
    guard = Guard(arm, limits or Limits(), cycle_s)
    loop = ControlLoop(robot, guard, source, clock, enabled=lambda: True, sink=sink)
    eye = Eye(setup, source, clock, cell, run, rng, noisy, sink)
    with cell.robot, cell.pairs:
        T_flange_wanted = (
            cell.T_mount_rig if at_tool is None else RigidTransform.identity()
        ) * RigidTransform.from_translation([0.0, 0.0, DISTANCE_M if at_tool is None else at_tool])
        clock.watch(cell.pairs, eye.take)
        loop.run(for_s=seconds, until=truth_of(cell, clock, run, T_flange_wanted, eye, robot))
    run.arm_lag_s = source.arm_lag_s
    return run


class Eye:
    """Takes pairs as they arrive: measures them, or gives the true pose with noise."""

    def __init__(
        self,
        setup: Setup,
        source: ServoSource,
        clock: Any,
        cell: LiveCell,
        run: Run,
        rng: Any,
        noisy: bool,
        sink: QueueSink | None = None,
    ):
        self.sink, self.how = sink, ""
        self.begun: tuple[float, int, int] = (0.0, 0, 0)
        self.setup, self.source, self.clock, self.cell, self.run, self.rng = setup, source, clock, cell, run, rng
        self.noisy = noisy
        self.track: Track | None = None
        self.in_memory_s: float | None = None
        self.spent_s = 0.0
        if noisy:  # pairs are not drawn
            cell.pairs.moment = lambda index: index  # type: ignore[method-assign, assignment, return-value]

    def T_base_rig(self, t_s: float) -> RigidTransform:
        cell = self.cell
        return cell.robot.true_flange(cell.origin_s + t_s) * cell.T_mount_rig if cell.carried else cell.T_mount_rig

    def take(self, pair: Any) -> None:
        run, t_s = self.run, (pair / self.cell.pairs.fps if self.noisy else pair[0].t_s)
        T_base_rig = self.T_base_rig(t_s)
        T_rig_target = (self.cell.robot.true.T_world_base * T_base_rig).inv() * self.cell.pairs.target_at(t_s)
        seen = in_view(self.setup, T_rig_target)
        run.frames += 1
        run.out_of_view += not seen
        self.begun = spent()
        self.in_memory_s = time.perf_counter()
        if self.noisy:
            pose = self._noisy(t_s, T_rig_target, seen)
        else:
            measured = measure_pair(self.setup, *pair, self.track)
            self.track, pose = measured.track, measured.pose
            self.how = EXPECTED if measured.tracked else "complete search"
        self.source.observe(pose, self.cell.origin_s + t_s, self.clock.now_s())
        self.spent_s = time.perf_counter() - self.in_memory_s
        if self.sink is not None:
            self.sink.pose(replace(pose, t_s=self.cell.origin_s + t_s))
        run.lost += pose.status is not PoseStatus.OK
        if pose.status is PoseStatus.OK:
            run.seen_s.append(t_s)
            run.T_world_target.append(
                self.cell.robot.true.T_world_base * T_base_rig * RigidTransform.from_matrix(pose.T_parent_target)
            )

    def _noisy(self, t_s: float, T: RigidTransform, seen: bool) -> TargetPose:
        if not seen:
            return TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig")
        noise = NOISE * self.rng.normal(size=6)
        turned = Rotation.from_rotvec(noise[3:]) * T.rotation
        shifted = RigidTransform.from_components(T.translation + noise[:3], turned)
        return TargetPose(
            t_s=t_s,
            status=PoseStatus.OK,
            parent="rig",
            T_parent_target=shifted.as_matrix(),
            covariance=np.diag(NOISE**2),
        )


def spent() -> tuple[float, int, int]:
    """Return this thread's processor time, how often the system or another thread took over, and collections so far."""
    switched = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
    return time.thread_time(), switched, sum(one["collections"] for one in gc.get_stats())


def in_view(setup: Setup, T_rig_target: RigidTransform) -> bool:
    """Tell whether every light is in both pictures."""
    xyz = T_rig_target.apply(setup.model.xyz_m)
    if not (xyz[:, 2] > 0.05).all():
        return False
    for camera, uv in zip((setup.rig.left, setup.rig.right), setup.rig.project(xyz), strict=True):
        if not ((uv >= 0.0) & (uv <= [camera.width - 1.0, camera.height - 1.0])).all():
            return False
    return True


def truth_of(
    cell: LiveCell, clock: Any, run: Run, T_flange_wanted: RigidTransform, eye: Eye, robot: TimedRobot
) -> Callable[[RobotStatus], bool]:
    """Return what notes after each cycle how far the target truly is from where it is wanted, in world axes."""

    def note(status: RobotStatus) -> bool:
        t_s = status.t_s - cell.origin_s
        if eye.in_memory_s is not None and status.guard is GuardState.RUNNING:
            run.to_command_ms.append((eye.spent_s + robot.sent_s - clock.returned_s - robot.own_s) * 1e3)
            cpu_s, switched, collected = (now - then for now, then in zip(spent(), eye.begun, strict=True))
            run.did.append((eye.how, 1e3 * cpu_s, switched, collected))
        eye.in_memory_s, robot.own_s = None, 0.0
        wanted = cell.robot.true.T_world_base * cell.robot.true_flange(status.t_s) * T_flange_wanted
        before, now = cell.pairs.target_at(max(t_s - 1e-3, 0.0)), cell.pairs.target_at(t_s)
        run.t_s.append(t_s)
        run.off_m.append(now.translation - wanted.translation)
        run.speed_m_s.append((now.translation - before.translation) / 1e-3)
        run.states.append(status.guard)
        if status.why:
            run.why.add(status.why.split(",")[0])
        return status.guard is GuardState.STOPPED

    return note


def puma(
    clock: SteppedClock, *, hand: str | None, speed: float, seed: int, room: str, fps: float = 1.0 / SERVO_S
) -> Any:
    return live_cell(
        load_scenario("pachidis2005-static")[0], clock, hand=hand, speed_m_s=speed, seed=seed, fps=fps, room=room
    )


class WatchedClock(SteppedClock):
    """Simulated time that notes the real one at which it gave the loop its cycle."""

    returned_s = 0.0

    def sleep_until(self, t_s: float) -> None:
        super().sleep_until(t_s)
        self.returned_s = time.perf_counter()


class PacedClock(WatchedClock):
    """The same, which waits for each picture's arrival by the wall clock; late: pictures that were drawn too slowly."""

    late = 0

    def watch(self, moments: Any, take: Callable[[Any], None]) -> None:
        wall = SystemClock()
        ahead_s = wall.now_s() - self.now_s()

        def paced(moment: Any) -> None:
            nonlocal ahead_s
            due_s = self.now_s() + ahead_s
            if wall.now_s() > due_s:
                self.late, ahead_s = self.late + 1, wall.now_s() - self.now_s()
            wall.sleep_until(due_s)
            take(moment)

        super().watch(moments, paced)


DELAY_S = 0.04 + 0.088  # of the cell: a frame's latency, and drive and controller: 2 cycles of 70 ms, begun ones whole


def static(room: str) -> Run:
    """The target at rest, 106 vectors of ten frames each, errors in world axes as the true arm places them."""
    clock = WatchedClock()
    cell = puma(clock, hand=None, speed=0.0, seed=1, room=room)
    run = servo_run("static", cell, clock, 3.0 + 1060 * SERVO_S + 0.2, delay_s=DELAY_S)
    keep = np.array(run.seen_s) > 3.0
    xyz = np.array([T.translation for T, k in zip(run.T_world_target, keep, strict=True) if k])[:1060]
    vectors = xyz[: len(xyz) // 10 * 10].reshape(-1, 10, 3).mean(axis=1) / MM
    truth = cell.pairs._world.target_path(np.zeros(1))[0].translation / MM
    about_mean, about_truth = vectors - vectors.mean(axis=0), vectors - truth
    rows = []
    for k, axis in enumerate("xyz"):
        rows.append(
            (
                axis,
                float(about_mean[:, k].std(ddof=1)),
                TABLE1["SD"][k],
                float(np.abs(about_mean[:, k]).mean()),
                TABLE1["MAE"][k],
                float(np.abs(about_truth[:, k]).mean()),
            )
        )
    table(
        f"Target at rest: {len(vectors)} vectors of 10 frames, mm in world axes",
        ("axis", "SD", "paper", "MAE about the mean", "paper", "MAE about the truth"),
        rows,
    )
    arrived = np.linalg.norm(np.array(run.off_m)[run.within(3.0, 1e9)], axis=1) / MM
    print(
        f"\nFrames lost {run.lost} of {run.frames}, out of view {run.out_of_view}. The point held is off by "
        f"{arrived.mean():.3g} mm on average (hand-eye and arm), and shakes by {arrived.std():.2g} mm."
    )
    return run


WORST = 10
"""Cycles whose story is told."""
EXPECTED = "where expected"
"""Where a light was looked for: in windows, or near the target's last place; else in all of the picture."""


def live(room: str, minutes: float) -> Run:
    """The target led on a circle at 40 mm/s by the wall clock, recorded: how long a cycle takes, what the worst did."""
    clock = PacedClock()
    cell = puma(clock, hand="circle", speed=0.04, seed=1, room=room)
    with tempfile.TemporaryDirectory() as folder, LoopRecorder(Path(folder) / "servo.mcap", clock) as recorder:
        run = servo_run("live", cell, clock, 60.0 * minutes, delay_s=DELAY_S, sink=recorder.sink)
    took = np.array(run.to_command_ms)
    rows = [(float(took[k]), *run.did[k]) for k in sorted(range(len(took)), key=lambda k: -took[k])[:WORST]]
    searched = [ms for ms, did in zip(took, run.did, strict=True) if did[0] != EXPECTED]
    processor = np.percentile([did[1] for did in run.did], [50, 99, 100])
    table(
        f"{minutes:g} minutes by the wall clock, the {WORST} longest cycles, ms",
        ("frame to command", "looked at", "processor, drives included", "taken over", "collections"),
        rows,
    )
    print(
        f"\n{len(took)} cycles, {len(searched)} with a complete search (median {np.median(searched or [0.0]):.2f} ms), "
        f"{sum(did[2] > 0 for did in run.did)} taken over by others, {sum(did[3] for did in run.did)} collections; "
        f"{run.lost} of {run.frames} frames lost, {clock.late} pictures drawn too late. Processor, drives included, "
        f"median, 99 %, longest: {', '.join(f'{ms:.2f}' for ms in processor)} ms."
    )
    return run


def ramp(room: str) -> list[Run]:
    """The target to and fro on a straight line at 100 mm/s: how far behind it the arm is."""
    rows, runs = [], []
    for predict in (True, False):
        clock = WatchedClock()
        cell = puma(clock, hand="still", speed=0.0, seed=1, room=room)
        start = (
            cell.pairs.target_at(0.0)
            if not isinstance(cell.pairs, CarriedView)
            else cell.pairs._world.target_path(np.zeros(1))[0]
        )
        line = RoundPath([[0.0, 0.0], [0.4, 0.0], [0.0, 0.0]], start, 0.1, CORNER_S)
        cell.pairs._world = replace(
            cell.pairs._world, target_path=lambda t, line=line: line(np.maximum(np.asarray(t) - 1.0, 0.0))
        )
        run = servo_run("ramp", cell, clock, 12.0, delay_s=DELAY_S, predict=predict, limits=Limits(speed_m_s=0.15))
        runs.append(run)
        off, v = np.array(run.off_m), np.array(run.speed_m_s)
        speed = np.linalg.norm(v, axis=1)
        steady = (speed > 0.0995) & (run.within(3.0, 5.3) | run.within(7.3, 9.3))
        lag = (off[steady] * v[steady]).sum(axis=1) / speed[steady] / MM
        size = np.linalg.norm(off[run.within(2.0, 9.4)], axis=1) / MM
        rows.append(
            (
                "predicted and fed forward" if predict else "the law alone",
                run.gain,
                run.n,
                100.0 / run.gain,
                float(lag.mean()),
                float(lag.max()),
                float(size.max()),
                run.out_of_view,
                run.lost,
            )
        )
    table(
        "Target at 100 mm/s on a line of 400 mm, to and fro (guard: 150 mm/s)",
        (
            "servo",
            "gain 1/s",
            "cycles of delay",
            "v/K mm",
            "lag mm, mean",
            "lag mm, max",
            "off mm at the turns, max",
            "out of view",
            "frames lost",
        ),
        rows,
    )
    return runs


def random_hands(room: str, runs: int, *, noisy: bool, seconds: float) -> list[Run]:
    """Hands at random, no faster than the arm may be: whether the target ever leaves the view."""
    done = []
    for seed in range(1, runs + 1):
        clock = WatchedClock()
        cell = puma(clock, hand="random", speed=0.06, seed=seed, room="dark" if noisy else room)
        done.append(servo_run("random", cell, clock, seconds, delay_s=DELAY_S, seed=seed, noisy=noisy))
    offs = [np.linalg.norm(np.array(run.off_m)[run.within(3.0, 1e9)], axis=1) / MM for run in done]
    speeds = [np.linalg.norm(np.array(run.speed_m_s), axis=1).max() for run in done]
    table(
        f"{runs} random hands of up to 60 mm/s, turning too, {seconds:g} s each, "
        + ("poses of the truth with noise" if noisy else "from pictures in the room"),
        (
            "runs with the target out of view",
            "frames",
            "frames lost",
            "off mm, median",
            "off mm, 99 %",
            "off mm, max",
            "fastest target mm/s",
            "held",
        ),
        [
            (
                sum(run.out_of_view > 0 for run in done),
                sum(run.frames for run in done),
                sum(run.lost for run in done),
                float(np.median(np.concatenate(offs))),
                float(np.percentile(np.concatenate(offs), 99)),
                float(np.concatenate(offs).max()),
                float(max(speeds) / MM),
                "; ".join(sorted(set().union(*(run.why for run in done)))),
            )
        ],
    )
    return done


def standing(room: str) -> list[Run]:
    """Cameras that stand, the arm's flange brought to 150 mm behind a target in a hand."""
    rows, runs = [], []
    for hand, speed in (("still", 0.0), ("circle", 0.08), ("random", 0.06)):
        clock = WatchedClock()
        scenario = load_scenario("webcam-cell")[0]
        cell = live_cell(scenario, clock, hand=hand, speed_m_s=speed, seed=2, fps=30.0, room=room)
        run = servo_run(hand, cell, clock, 8.0, delay_s=0.03 + 0.05, at_tool=0.15)
        runs.append(run)
        off = np.array(run.off_m)[run.within(4.0, 1e9)]
        v = np.array(run.speed_m_s)[run.within(4.0, 1e9)]
        lag = 0.0 if not speed else float(((off * v).sum(axis=1) / np.linalg.norm(v, axis=1)).mean() / MM)
        rows.append(
            (
                hand,
                1e3 * speed,
                run.gain,
                run.n,
                lag,
                float(np.linalg.norm(off, axis=1).mean() / MM),
                run.lost,
                run.frames,
            )
        )
    table(
        "Cameras that stand (webcam cell), flange 150 mm behind the target",
        (
            "hand",
            "mm/s",
            "gain 1/s",
            "cycles of delay",
            "lag mm",
            "off mm, mean (hand-eye too)",
            "frames lost",
            "frames",
        ),
        rows,
    )
    return runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["static", "ramp", "random", "noisy", "standing"])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--noisy-runs", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--room", default="workshop")
    parser.add_argument("--minutes", type=float, default=10.0, help="of `live`")
    asked = parser.parse_args()
    prepare(Silent())
    print(machine())
    drawn: list[Run] = []
    for part in asked.parts:
        if part == "static":
            drawn.append(static(asked.room))
        elif part == "ramp":
            drawn += ramp(asked.room)
        elif part == "live":
            drawn.append(live(asked.room, asked.minutes))
        elif part == "random":
            drawn += random_hands(asked.room, asked.runs, noisy=False, seconds=asked.seconds)
        elif part == "noisy":
            random_hands(asked.room, asked.noisy_runs, noisy=True, seconds=asked.seconds)
        else:
            drawn += standing(asked.room)
    took = np.concatenate([run.to_command_ms for run in drawn]) if drawn else np.empty(0)
    if len(took):
        table(
            "From a frame in memory to the command out, real clock, ms (paper: 70)",
            ("frames", "median", "p99", "longest"),
            [(len(took), float(np.median(took)), float(np.percentile(took, 99)), float(took.max()))],
        )


if __name__ == "__main__":
    main()
