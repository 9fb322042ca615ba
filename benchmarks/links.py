"""Drivers of controllers against their twins, each twin a process of its own, in real time.

python benchmarks/links.py [alter] [rsi] [--for 60]

Prints for each link: cycles, those that neither side has, answers late by the controller's count, how far the arm
stands at the end from where it was last told to go, and how late the caller's own cycle began.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.clock import SystemClock
from armsight.drivers.alter import AlterRobot
from armsight.drivers.rsi import RsiRobot
from armsight.sim.twins.base import small_arm

SWING_RAD = 0.05
PERIOD_S = 4.0


class Model:
    """The twin's arm, as the driver of a serial link takes it."""

    def fk(self, q: np.ndarray) -> RigidTransform:
        return small_arm().flange(q)

    def ik(self, T_base_flange: RigidTransform, near: np.ndarray) -> np.ndarray:
        return small_arm().reach(T_base_flange.as_matrix(), near)


@contextlib.contextmanager
def twin(*arguments: str) -> Iterator[str]:
    """Run a twin; give the device it tells."""
    command = [sys.executable, "-c", "from armsight.cli import main; main()", "twin", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        if process.stdout is not None:
            yield process.stdout.readline().strip().partition(":")[2]
    finally:
        os.kill(process.pid, signal.SIGINT)
        process.wait(10)


def run(robot: AlterRobot | RsiRobot, time_s: float) -> None:
    clock = SystemClock()
    lateness, limited = [], 0
    with robot:
        gc.disable()
        start, sent = robot.read().q, None
        begin_s = clock.now_s()
        for k in range(round(time_s / robot.cycle_s)):
            due_s = begin_s + (k + 1) * robot.cycle_s
            clock.sleep_until(due_s)
            lateness.append(clock.now_s() - due_s)
            wave = SWING_RAD * 0.5 * (1.0 - np.cos(2.0 * np.pi * (due_s - begin_s) / PERIOD_S))
            sent = robot.step_joints(start + wave - (start if sent is None else sent.q))
            limited += bool(sent.limited)
        time.sleep(1.0)
        off = np.abs(robot.read().q - sent.q).max()
        gc.enable()
        counts, late = robot.counts, np.percentile(lateness, [50, 99, 100]) * 1e3
    print(f"{robot.name.partition(':')[0]}: {counts.heard} cycles of {robot.cycle_s * 1e3:g} ms heard in {time_s:g} s")
    print(f"  missed {counts.missed}, answers late {counts.late}, refused {counts.refused}, repeated {counts.repeated}")
    print(f"  commands {len(lateness)}, limited {limited}; at rest off by {off * 1e6:.1f} urad (encoder step 10 urad)")
    print(f"  caller late by {late[0]:.3f} ms median, {late[1]:.3f} p99, {late[2]:.3f} at most", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("links", nargs="*", default=["alter", "rsi"])
    parser.add_argument("--for", dest="time_s", type=float, default=60.0)
    chosen = parser.parse_args()
    if "alter" in chosen.links:
        with twin("alter") as device:
            run(AlterRobot(device, settings={"arm": Model()}), chosen.time_s)
    if "rsi" in chosen.links:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        with twin("rsi", "--connect", f"127.0.0.1:{port}"):
            run(RsiRobot(str(port), settings={"bind": "127.0.0.1"}), chosen.time_s)


if __name__ == "__main__":
    main()
