"""The link to the real LinuxCNC: lag, limits under a bad line, stops, and agreement after what LinuxCNC dropped.

python benchmarks/linuxcnc.py [sine] [lossy] [stops] [agree] [bridge] [--busy 2] [--contract 10]

Starts LinuxCNC (it has to be installed, and none may run). Joints are recorded each servo cycle by a HAL sampler of
its own. sine: six joints to 15 degrees/s; the set point is counted from the state that it answers. lossy: the same,
with 1,000 packets lost and 1,000 late, both ways. stops: the client is killed (-9) at 20 degrees/s, the line cut, an
e-stop pressed. agree: a soft limit, MDI, an e-stop in between. bridge: the bridge is killed. --busy: processes that
compute beside all that. --contract: so many runs of tests/contracts/test_linuxcnc.py.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from armsight.clock import SystemClock
from armsight.drivers import RobotState
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.ops.robot.recorder import run_with_progress
from armsight.testing.wrong_controllers import prove
from armsight_sim.twins.linuxcnc import LinuxcncTwin

PARTS = ("sine", "lossy", "stops", "agree", "bridge")
SPEED, ACCELERATION = 30.0, 200.0
AMPLITUDE, PEAK = 10.0, 15.0
KILL_SPEED = 20.0
WANTED_FAULTS = 1000
CLIENT = """
import sys, time, numpy as np
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.testing.wrong_controllers import prove
with LinuxcncRobot(sys.argv[1], settings={"max_speed_rad_s": 0.5}) as robot:
    prove(robot, time.sleep)
    pace = robot.wait_step(-1, 1.0)
    speed = 0.0
    for i in range(400):
        speed = min(float(sys.argv[2]), speed + 100.0 * 0.008)
        robot.step_joints(np.full(6, np.radians(speed) * 0.008))
        pace = robot.wait_step(pace.steps, 0.1)
        if i == 40:
            print("at speed", flush=True)
"""
MODES = """
import sys, time
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
linuxcnc.nmlfile = "linuxcnc.nml"
command = linuxcnc.command()
for what in sys.argv[1:]:
    if what.startswith("G"):
        command.mdi(what)
    elif what == "joint":
        command.teleop_enable(0)
    else:
        command.mode(getattr(linuxcnc, "MODE_" + what))
    command.wait_complete(5.0)
    time.sleep(0.3)
"""


class Recorded(LinuxcncTwin):
    """A LinuxCNC whose commanded joints and enable are recorded in each servo cycle."""

    def _write(self, folder: Path) -> None:
        super()._write(folder)
        hal = folder / "armsight.hal"
        text = hal.read_text().replace(f"depth=4000 cfg={18 * 'f'}", f"depth=4000,200000 cfg={18 * 'f'},ffffffb")
        lines = [f"net armsight-cmd-{j} => sampler.1.pin.{j}" for j in range(6)]
        lines += ["net armsight-enabled => sampler.1.pin.6", "addf sampler.1 servo-thread"]
        hal.write_text("\n".join([text.rstrip(), *lines]) + "\n")

    @contextlib.contextmanager
    def record(self) -> Iterator[list[Any]]:
        """Record while the block runs; the list then has sample numbers (n,), joints (n, 6) in degrees, enable (n,)."""
        found: list[Any] = []
        waiting = int(self.hal("getp", "sampler.1.curr-depth"))  # of an earlier time
        with (self.folder / "samples").open("wb") as file:
            sampler = self.begin("halsampler", "-t", "-c", "1", stdout=file)
            time.sleep(0.5)
            try:
                yield found
                time.sleep(0.5)
            finally:
                sampler.send_signal(signal.SIGINT)
                sampler.wait()
        rows = [row.split() for row in (self.folder / "samples").read_text().splitlines() if row.count(" ") >= 7]
        rows = [row for row in rows if "overrun" not in row]
        values = np.array([[float(v) for v in row[:8]] for row in rows])
        values = values[waiting:]
        found += [values[:, 0], values[:, 1:7], values[:, 7]]


class Told(LinuxcncRobot):
    """A driver that notes which goal answered which sample, and when it came; its line can be bad."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.goals: list[tuple[int, Any]] = []
        self.times: list[tuple[int, float]] = []
        self.rng: np.random.Generator | None = None
        self.lost = self.late = 0
        self.cut = False
        self._under_way: list[Any] = []

    def _received(self, wait_s: float) -> Any:
        packets, self._under_way = self._under_way + super()._received(wait_s), []
        if self.cut:
            return []
        return [packet for packet in packets if not self._spoiled(lambda: None, packet)]

    def _spoiled(self, held: Any, packet: Any) -> bool:
        chance = 1.0 if self.rng is None else float(self.rng.random())
        self.lost += chance < 0.12
        late = 0.12 <= chance < 0.24
        self.late += late
        if late and packet is not None:
            self._under_way.append(packet)
        return chance < 0.24

    def _encode(self, state: Any) -> bytes:
        self.goals.append((state.sample, np.degrees(self._goals.sent)))
        self.times.append((state.sample, time.monotonic()))
        return super()._encode(state)

    def _answer(self, state: Any, sender: Any) -> None:
        if not self.cut and not self._spoiled(None, None):
            super()._answer(state, sender)

    def moment(self, sample: Any) -> Any:
        """Return when samples were taken, s: states come soon after theirs, some at once."""
        told = np.array(self.times)
        slope = np.polyfit(told[:, 0], told[:, 1], 1)[0]
        return sample * slope + float(np.min(told[:, 1] - slope * told[:, 0]))


def opened(twin: Recorded) -> Told:
    return Told(twin.address.partition(":")[2], settings={"switch_on": True, "max_speed_rad_s": 0.5})


def sine(robot: Told, for_s: float) -> None:
    """Let six joints swing, one step for each of the controller's cycles."""
    cycle_s, begin = robot.cycle_s, robot.wait_step(-1, 1.0)
    rate = PEAK / AMPLITUDE
    pace, t_s, soft = begin, 0.0, 2.0
    last = np.zeros(6)
    while t_s < for_s and robot.state in (RobotState.READY, RobotState.MOVING):
        t_s = (pace.steps - begin.steps) * cycle_s
        goal = np.full(6, AMPLITUDE * min(1.0, t_s / soft) * np.sin(rate * t_s))
        robot.step_joints(np.radians(goal - last))
        last = goal
        pace = robot.wait_step(pace.steps, 0.1)


def lag(robot: Told, numbers: Any, joints: Any) -> tuple[float, float]:
    """Return by how many ms the commanded joints are behind the goals, and the RMS of what then is left, in degrees."""
    samples = np.array([sample for sample, _ in robot.goals], dtype=float)
    goals = np.array([goal[0] for _, goal in robot.goals])
    inside = (samples > numbers[0] + 2500) & (samples < numbers[-1] - 200)
    best = (np.inf, 0.0)
    for behind in np.arange(0.0, 80.0, 0.5):
        off = np.interp(samples[inside] + behind, numbers, joints[:, 0]) - goals[inside]
        best = min(best, (float(np.sqrt(np.mean(off * off))), float(behind)))
    return best[1], best[0]


def steps(robot: Told, found: list[Any]) -> str:
    joints = found[1][found[0] >= robot.times[0][0]]  # homing sets the position at once
    speed = np.abs(np.diff(joints, axis=0)).max() / 1e-3
    hard = np.abs(np.diff(joints, n=2, axis=0)).max() / 1e-6
    return f"worst speed {speed / SPEED:.5f} of its limit, acceleration {hard / ACCELERATION:.3f} (recorded to 0.02)"


def run_sine(twin: Recorded) -> None:
    with opened(twin) as robot, twin.record() as found:
        prove(robot, time.sleep)
        robot.goals.clear()
        run_with_progress(lambda: sine(robot, 15.0), lambda: None)
        state = f"{robot.state} {robot.why}"
        counts = robot.counts
    behind, rms = lag(robot, found[0], found[1])
    print(f"sine to {PEAK:g} degrees/s: {behind:.1f} ms behind, {rms:.4f} degrees RMS; {steps(robot, found)}; {state}")
    print(f"  {counts}", flush=True)


def run_lossy(twin: Recorded) -> None:
    with opened(twin) as robot, twin.record() as found:
        prove(robot, time.sleep)
        robot.rng = np.random.default_rng(1)
        while min(robot.lost, robot.late) < WANTED_FAULTS and robot.state is not RobotState.LOST:
            if robot.state is RobotState.STOPPED:
                robot.rng = None
                robot.reset()
                time.sleep(0.5)
                prove(robot, time.sleep)
                robot.rng = np.random.default_rng(robot.lost)
            run_with_progress(lambda: sine(robot, 8.0), lambda: None)
        state = f"{robot.state} {robot.why}"
    print(f"lossy: {robot.lost} lost, {robot.late} late: {steps(robot, found)}; {state}", flush=True)


def rest(numbers: Any, joints: Any, since: float) -> tuple[float, float, float]:
    """Return after how many samples all joints rest, how far they went on, and how far they came back, in degrees."""
    after = numbers >= since
    track, times = joints[after][:, 0], numbers[after]
    moving = np.flatnonzero(np.abs(np.diff(track)) > 1e-7)
    last = int(moving[-1]) + 1 if len(moving) else 0
    return float(times[last] - since), float(track[-1] - track[0]), float(track.max() - track[-1])


def sample_now(robot: Told, t_s: float) -> float:
    told = np.array(robot.times)
    slope, offset = np.polyfit(told[:, 0], told[:, 1], 1)
    offset = float(np.min(told[:, 1] - slope * told[:, 0]))
    return (t_s - offset) / slope


def said(what: str, found: list[Any], since: float) -> None:
    ms, on, back = rest(found[0], found[1], since)
    print(
        f"{what} at {KILL_SPEED:g} degrees/s: at rest after {ms:.0f} ms, {on:.2f} degrees on, {back:.4f} back",
        flush=True,
    )


def at_speed(robot: Told, speed: float) -> None:
    prove(robot, time.sleep)
    pace, now = robot.wait_step(-1, 1.0), 0.0
    for _ in range(60):
        now = min(speed, now + 100.0 * robot.cycle_s)
        robot.step_joints(np.full(6, np.radians(now) * robot.cycle_s))
        pace = robot.wait_step(pace.steps, 0.1)


def homed(twin: Recorded, robot: Told) -> None:
    """Go back to the middle of all ranges."""
    prove(robot, time.sleep)
    pace = robot.wait_step(-1, 1.0)
    while np.abs(robot._goals.sent).max() > 1e-3 and robot.state is not RobotState.LOST:
        robot.step_joints(np.clip(-robot._goals.sent, -0.002, 0.002))
        pace = robot.wait_step(pace.steps, 0.1)
    time.sleep(0.5)


def run_stops(twin: Recorded) -> None:
    with opened(twin) as robot:
        homed(twin, robot)
    command = [sys.executable, "-c", CLIENT, twin.address.partition(":")[2], str(KILL_SPEED)]
    with twin.record() as found:
        client = subprocess.Popen(command, stdout=subprocess.PIPE)
        if client.stdout is not None:
            client.stdout.readline()
        client.kill()
        killed_s = time.monotonic()
        client.wait()
        time.sleep(1.5)
        with opened(twin) as robot:  # tells which sample was when
            time.sleep(1.0)
    said("client killed", found, sample_now(robot, killed_s))
    with opened(twin) as robot, twin.record() as found:
        homed(twin, robot)
        at_speed(robot, KILL_SPEED)
        robot.cut, cut_s = True, time.monotonic()
        time.sleep(1.0)
        state = robot.state
    said(f"line cut (driver: {state})", found, sample_now(robot, cut_s))
    time.sleep(1.2)
    with opened(twin) as robot, twin.record() as found:
        homed(twin, robot)
        at_speed(robot, 0.5 * KILL_SPEED)
        twin.hal("setp", "halui.estop.activate", "1")
        end_s = time.monotonic() + 2.0
        while robot.state is not RobotState.STOPPED and time.monotonic() < end_s:
            time.sleep(0.0005)
        told_s = time.monotonic()
        why = robot.why
        twin.hal("setp", "halui.estop.activate", "0")
    off = found[0][np.flatnonzero(found[2] < 0.5)[0]]
    print(f"e-stop: told {1e3 * (told_s - robot.moment(off)):.1f} ms after the motion's end: {why}", flush=True)


def agreed(what: str, twin: Recorded, robot: Told) -> None:
    """Reset, look whether anything jumps, and compare the driver's goals with LinuxCNC's commanded joints."""
    time.sleep(1.0)
    before, why = np.array(twin.joints_deg()), robot.why
    if robot.state is RobotState.STOPPED:
        robot.reset()
    time.sleep(0.5)
    jumped = np.abs(np.array(twin.joints_deg()) - before).max()
    prove(robot, time.sleep)
    at_speed(robot, 5.0)
    time.sleep(1.0)
    off = np.abs(np.array(twin.joints_deg()) - np.degrees(robot._goals.sent)).max()
    print(f"{what}: jumped by {jumped:.5f} degrees, then off by {off:.5f}; told: {why or 'nothing'}", flush=True)


def run_agree(twin: Recorded) -> None:
    modes = lambda *what: twin.begin("/usr/bin/python3", "-c", MODES, *what).wait()  # noqa: E731
    with opened(twin) as robot:
        homed(twin, robot)
        upper = twin.hal("getp", "ini.0.max_limit").strip()
        twin.hal("setp", "ini.0.max_limit", "1.0")
        time.sleep(0.3)
        at_speed(robot, KILL_SPEED)
        time.sleep(1.0)
        twin.hal("setp", "ini.0.max_limit", upper)
        time.sleep(0.3)
        agreed("soft limit", twin, robot)
        modes("MDI", "G91 G0 Z-5", "MANUAL", "joint")
        agreed("MDI in between", twin, robot)
        twin.hal("setp", "halui.estop.activate", "1")
        time.sleep(0.5)
        twin.hal("setp", "halui.estop.activate", "0")
    with opened(twin) as robot:
        agreed("e-stop and reset", twin, robot)


def run_bridge(twin: Recorded) -> None:
    with opened(twin) as robot, twin.record() as found:
        homed(twin, robot)
        at_speed(robot, KILL_SPEED)
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if f"{twin.folder}/linuxcnc_bridge".encode() in (process / "cmdline").read_bytes():
                    os.kill(int(process.name), signal.SIGKILL)
        killed_s = time.monotonic()
        time.sleep(1.0)
        why = robot.why
    since = sample_now(robot, killed_s)
    off = found[0][np.flatnonzero((found[2] < 0.5) & (found[0] > since))[:1]] - since
    said(f"bridge killed (machine off after {off.round().tolist()} ms; driver: {why})", found, since)


def busy() -> None:
    while True:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=list(PARTS))
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--contract", type=int, default=0)
    args = parser.parse_args()
    others = [multiprocessing.Process(target=busy, daemon=True) for _ in range(args.busy)]
    for other in others:
        other.start()
    print(f"load {os.getloadavg()[0]:.1f} of {os.cpu_count()} processors")
    if not args.contract:
        with Recorded(clock=SystemClock()) as twin:
            for part in sorted(args.parts, key=PARTS.index):  # behind the last one no bridge is left
                {"sine": run_sine, "lossy": run_lossy, "stops": run_stops, "agree": run_agree, "bridge": run_bridge}[
                    part
                ](twin)
    file, good = Path(__file__).parents[1] / "tests/contracts/test_linuxcnc.py", 0
    for _ in range(args.contract):
        begun_s = time.monotonic()
        done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-m", "alone", str(file)], check=False)
        good += done.returncode == 0
        print(f"contract: {good} good; {time.monotonic() - begun_s:.0f} s", flush=True)
    for other in others:
        other.kill()


if __name__ == "__main__":
    main()
