"""`armsight verify --live`: 60 pairs a second for half a minute, and how long an alarm takes, by real clocks.

    python benchmarks/verify_live.py [--seconds 30] [--room workshop]

Rendering two pictures takes a simulator longer than a sixtieth of a second, so the pictures are drawn beforehand: a
periodic motion's, and the same with the tool knocked by 3 mm. What is timed begins where a camera ends: both frames of
a pair in memory. The exposure (4 ms) and the cable come on top. Joints are read 125 times a second in a thread, the
recording is written, as with a real arm.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from armsight.clock import ManualClock, SystemClock
from armsight.drivers import RobotState, Sent
from armsight.errors import DeviceFailed
from armsight.ops import verify
from armsight.ops.simulation.scenarios import load_scenario
from armsight.ops.verification.supervising import Supervised
from armsight.records import Frame, JointReading
from armsight.store import rig_from_mapping, target_from_mapping, write_rig, write_target
from armsight.store.arm_file import arm_from_mapping, write_arm
from armsight.store.rigs import World, write_world
from armsight.verify.supervision import Level
from armsight_sim.live import live_cell
from armsight_sim.scenario_builder import build_world
from bench import machine, table

PERIOD_S, FPS, CYCLE_S, SETTLE_S = 3.0, 60.0, 0.008, 3.0
KNOCK_M, KNOCK_FRAMES, KNOCK_EVERY_S = 0.003, 30, 3.0
JUMP_RAD, JUMP_JOINT, JUMP_AT_S = np.deg2rad(0.3), 1, 1.5  # an encoder's zero, for as long, half a period earlier
LATENCY_S = 0.03  # of the scenario: from the exposure to the frame in memory
DEPTH = 4  # frames that a live camera keeps for a slow reader


def scenario(room: str, knock: bool) -> Any:
    """Return the webcam cell with a motion of one period, the tool knocked all the time or never."""
    model = load_scenario("webcam-cell")[0]
    keys = model.model_dump()
    keys["room"] = room
    keys["motion"]["period_s"] = [PERIOD_S] * 6
    if knock:
        keys["events"] = [{"kind": "jump", "at_s": 0.0, "for_s": 1000.0, "by_m": [KNOCK_M, 0.0, 0.0]}]
    return type(model).model_validate(keys)


def drawn(room: str, knock: bool, first: int, count: int) -> tuple[list[tuple[Frame, Frame]], list[np.ndarray]]:
    """Return pairs of a period, from frame `first` of it, and the joints read in that period, every CYCLE_S."""
    clock = ManualClock(0.0)
    cell = live_cell(scenario(room, knock), clock, play=True)
    pairs, joints = [], []
    with cell.robot as robot, cell.pairs as view:
        for k in range(round(PERIOD_S / CYCLE_S)):
            clock.sleep_until(SETTLE_S + k * CYCLE_S + 1e-6)
            joints.append(robot.read().q)
        begin = round(SETTLE_S * FPS) + first
        path = view._path
        for k in range(begin, begin + count):
            t_s = k / FPS
            pairs.append((view._frame(k, t_s, "left", path), view._frame(k, t_s, "right", path)))
    return pairs, joints


def jumped(t_s: float) -> bool:
    """Whether the encoder is off at a time."""
    return JUMP_AT_S <= t_s % (2 * KNOCK_EVERY_S) < JUMP_AT_S + KNOCK_FRAMES / FPS


def off_by_now(t_s: float) -> bool:
    """Whether the readings on both sides of a moment are off: an exposure between a good and a bad one shows half."""
    return jumped(t_s) and jumped(t_s - CYCLE_S)


class Repeated:
    """The pairs of a periodic motion by the clock, as a camera hands them out: late readers lose the oldest."""

    name, total, skew = "prepared", None, None

    def __init__(self, good: list[tuple[Frame, Frame]], knocked: list[tuple[Frame, Frame]], clock: SystemClock) -> None:
        self._good, self._knocked, self._clock = good, knocked, clock
        self.origin_s = 0.0
        self.due_s: list[float] = []
        self.taken_s: list[float] = []
        self.fault: list[str] = []

    def __enter__(self) -> Self:
        self.origin_s = self._clock.now_s() + 0.2
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        k = 0
        while True:
            late = int((self._clock.now_s() - self.origin_s - LATENCY_S) * FPS)
            k = max(k, late - DEPTH)
            self._clock.sleep_until(self.origin_s + k / FPS + LATENCY_S)
            at = k % len(self._good)
            knocked = at < len(self._knocked) and k * 1.0 / FPS % (2 * KNOCK_EVERY_S) >= KNOCK_EVERY_S
            pair = self._knocked[at] if knocked else self._good[at]
            self.due_s.append(self.origin_s + k / FPS + LATENCY_S)
            self.taken_s.append(self._clock.now_s())
            self.fault.append("knock" if knocked else "encoder" if off_by_now(k / FPS) else "")
            yield replace(pair[0], t_s=k / FPS, sequence=k), replace(pair[1], t_s=k / FPS, sequence=k)
            k += 1


class RepeatedRobot:
    """A robot that only says its joints, those of a periodic motion."""

    n_joints, cycle_s, takes_poses, name = 6, CYCLE_S, False, "prepared"
    state = RobotState.READY

    def __init__(self, joints: list[np.ndarray], pairs: Repeated, clock: SystemClock) -> None:
        self._joints, self._pairs, self._clock = joints, pairs, clock

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def read(self) -> JointReading:
        now_s = self._clock.now_s() - self._pairs.origin_s
        k = int(np.floor(now_s / CYCLE_S))
        q = self._joints[k % len(self._joints)].copy()
        q[JUMP_JOINT] += JUMP_RAD * jumped(k * CYCLE_S)
        return JointReading(q=q, t_s=self._pairs.origin_s + k * CYCLE_S, sequence=k, source=self.name)

    def step_joints(self, step: np.ndarray) -> Sent:
        raise DeviceFailed("it only reads")

    def move_pose(self, T_base_flange: Any) -> Sent:
        raise DeviceFailed("it only reads")

    def stop(self) -> None:
        pass

    def reset(self) -> None:
        pass


def files(folder: Path, room: str) -> None:
    """Write rig, target, the true arm and the rig's place."""
    world = build_world(scenario(room, False), frames=1)
    write_rig(folder / "rig.yaml", rig_from_mapping(world.rig, "rig"))
    write_target(folder / "target.yaml", target_from_mapping(world.target, "target"))
    write_world(folder / "world.yaml", World(parent="world", T_parent_rig=world.true.T_world_base * world.T_base_rig))
    content = {"format": "armsight/arm", "version": 1, **world.true.mapping(world.T_flange_tool)}
    write_arm(folder / "arm.yaml", arm_from_mapping(content, "arm"))


def supervise(seconds_s: float, room: str) -> None:
    """Draw, then supervise by the clock and print what it took."""
    begun = time.perf_counter()
    good, joints = drawn(room, False, 0, round(PERIOD_S * FPS))
    knocked, _ = drawn(room, True, 0, KNOCK_FRAMES)
    print(f"\n{len(good) + len(knocked)} pairs drawn in {time.perf_counter() - begun:.0f} s, room {room}")
    clock = SystemClock()
    pairs = Repeated(good, knocked, clock)
    robot = RepeatedRobot(joints, pairs, clock)
    decided_s: list[float] = []
    levels: list[Level] = []

    def show(_: Any, __: Any, level: Level, ___: str) -> None:
        decided_s.append(clock.now_s())
        levels.append(level)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder, room)
        devices = Supervised(robot=robot, pairs=pairs, origin_s=lambda: pairs.origin_s)
        done = verify.supervise(
            "prepared", folder / "rig.yaml", folder / "target.yaml", "left one", "right one", folder / "arm.yaml",
            folder / "world.yaml", warn_m=0.001, seconds_s=seconds_s, out=folder / "out", show=show, clock=clock,
            devices=devices,
        )  # fmt: skip
    told(done, pairs, np.array(decided_s), levels, seconds_s)


def told(done: Any, pairs: Repeated, decided_s: np.ndarray, levels: list[Level], seconds_s: float) -> None:
    """Print rate, latencies and alarms."""
    n = len(decided_s)
    latency = 1e3 * (decided_s - np.array(pairs.due_s[:n]))
    fault = pairs.fault[:n]
    raised = [k for k in range(1, n) if levels[k] is Level.WARN and levels[k - 1] is not Level.WARN]
    onsets = [k for k in range(1, n) if fault[k] and not fault[k - 1]]
    alarms = {
        kind: [
            1e3 * (decided_s[k] - pairs.due_s[onset])
            for onset in onsets
            for k in raised
            if onset <= k < onset + KNOCK_FRAMES and fault[onset] == kind
        ]
        for kind in ("encoder", "knock")
    }
    false = sum(not any(fault[max(k - 1, 0) : k + 1]) for k in raised)
    rows = [
        ["pairs taken of those due", f"{n} of {round(seconds_s * FPS) + 1}"],
        ["pairs a second", float(done.rate_hz or 0.0)],
        ["frame in memory to decision, median / p99 / largest ms", _three(latency)],
        ["... of all alarms, from the first pair with the fault", _three(alarms["encoder"] + alarms["knock"])],
        ["... an encoder's zero jumps by 0.3 deg, from the first exposure after it", _three(alarms["encoder"])],
        ["... the tool knocked by 3 mm within a frame: its surroundings are searched", _three(alarms["knock"])],
        ["alarms of faults", f"{sum(map(len, alarms.values()))} of {len(onsets)}"],
        ["alarms without a fault", false],
        ["lost, stale", f"{done.n_lost}, {done.n_stale}"],
        ["noise along the error as told, RMS mm", f"{1e3 * (done.errors.std_m or 0.0):.3g}"],
    ]
    table(f"Supervision, {seconds_s:g} s, warning at 1 mm (the exposure of 4 ms comes on top)", ["", ""], rows)


def _three(values: Sequence[float] | np.ndarray) -> str:
    if not len(values):
        return "-"
    values = np.asarray(values)
    return f"{np.median(values):.2f} / {np.quantile(values, 0.99):.2f} / {values.max():.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--room", default="workshop")
    told_ = parser.parse_args()
    print(machine())
    supervise(told_.seconds, told_.room)


if __name__ == "__main__":
    main()
