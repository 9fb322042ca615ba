"""The links to ABB (EGM, 4 ms) and Universal Robots (RTDE, 2 ms): each driver against its twin in a process of its own.

A caller moves all joints along sines, one step a cycle, and then rests. Told are: states that never came, answers that
the controller missed, how late the caller and the controller's states were by the plan of their cycle, and how far the
arm is in the end from where the commands said.

    python benchmarks/links_abb_ur.py [egm] [rtde] [--for 60] [--priority 20]

--priority takes the system's real-time priority (Linux, as root), for a machine that is busy with other things.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np

from armsight.clock import SystemClock
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.egm import EgmRobot
from armsight.drivers.rtde import RtdeRobot
from armsight.errors import StaleData
from armsight.sim.twins.egm import EgmTwin
from armsight.sim.twins.rtde import RtdeTwin

PORT = {"egm": 46510, "rtde": 30004}
HOST = "127.77.0.1"
AMPLITUDE_RAD, PERIOD_S = 0.15, 6.0
WARM_UP_S = 2.0


def twin_process(kind: str) -> None:
    """Be the controller until standard input closes; then tell what it has counted."""
    there = f"{HOST}:{PORT[kind]}"
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    twin: Any = EgmTwin(connect=there) if kind == "egm" else RtdeTwin(port=there)
    with twin:
        print("ready", flush=True)
        gc.collect()
        gc.freeze()
        gc.disable()
        twin.run(lambda: not ended.is_set())
        if kind == "egm":
            told = {"taken": twin.controller.counts.taken, "late": twin.controller.counts.late}
        else:
            counts, controller = twin.server.counts, twin.server.controller
            told = {"taken": counts.taken, "refused": counts.refused, "messages": controller.messages[-1:]}
        print(json.dumps(told))


def drive(robot: CyclicRobot, for_s: float) -> dict[str, Any]:
    """Move for a time, then rest; return what was measured."""
    clock = SystemClock()
    cycle_s, n = robot.cycle_s, robot.n_joints
    count = round(for_s / cycle_s)
    wake_s, read_s, call_s = np.zeros(count), np.zeros(count), np.zeros(count)
    phase = np.linspace(0.0, 1.0, n)
    place = np.zeros(n)
    faults = 0
    gc.collect()
    gc.freeze()
    gc.disable()
    start_s = clock.now_s() + WARM_UP_S
    clock.sleep_until(start_s)
    missed = robot.counts.missed if isinstance(robot, EgmRobot) else robot.missed  # type: ignore[attr-defined]
    heard = robot.read().sequence
    for i in range(count):
        due_s = start_s + i * cycle_s
        clock.sleep_until(due_s)
        woken_s = clock.now_s()
        wake_s[i] = woken_s - due_s
        goal = AMPLITUDE_RAD * np.sin(2.0 * np.pi * (i * cycle_s / PERIOD_S)) * (1.0 - 0.3 * phase)
        try:
            read_s[i] = robot.read().t_s
            sent = robot.step_joints(goal - place)
        except StaleData:  # this computer was busy elsewhere; a link that is lost ends the run
            faults += 1
            continue
        place = goal
        call_s[i] = clock.now_s() - woken_s
    gc.enable()
    end_missed = robot.counts.missed if isinstance(robot, EgmRobot) else robot.missed  # type: ignore[attr-defined]
    time.sleep(1.0)
    states = robot.read().sequence - heard - round(1.0 / cycle_s)
    arrivals = np.unique(read_s[read_s > 0.0])
    off = arrivals - arrivals[0] - cycle_s * np.round((arrivals - arrivals[0]) / cycle_s)
    late = off - np.percentile(off, 1.0)
    return {
        "seconds": for_s,
        "states": states,
        "states_missed": end_missed - missed,
        "stale_reads": faults,
        "caller_late_ms": spread(1e3 * wake_s),
        "states_late_ms": spread(1e3 * late),
        "call_us": spread(1e6 * call_s),
        "rest_error_urad": round(1e6 * float(np.abs(robot.read().q - sent.q).max()), 3),
        "limited": list(sent.limited),
    }


def spread(values: np.ndarray) -> dict[str, float]:
    return {
        "median": round(float(np.median(values)), 3),
        "p99": round(float(np.percentile(values, 99)), 3),
        "max": round(float(values.max()), 3),
    }


def measure(kind: str, for_s: float, priority: int) -> dict[str, Any]:
    command = [sys.executable, __file__, "--twin", kind, "--priority", str(priority)]
    twin = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    if twin.stdout is None or twin.stdout.readline() != "ready\n":
        raise SystemExit("the twin did not start")
    if kind == "egm":
        robot: CyclicRobot = EgmRobot(str(PORT[kind]), settings={"bind": HOST})
    else:
        robot = RtdeRobot(HOST)
    try:
        with robot:
            told = drive(robot, for_s)
        answered = robot._answers if isinstance(robot, EgmRobot) else None
    finally:
        out, _ = twin.communicate("")
    told["twin"] = json.loads(out)
    if answered is not None:
        told["answers_missed"] = answered - told["twin"]["taken"]
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", choices=["egm", "rtde", []], default=[])
    parser.add_argument("--for", dest="for_s", type=float, default=60.0)
    parser.add_argument("--twin", choices=["egm", "rtde"])
    parser.add_argument("--priority", type=int, default=0)
    given = parser.parse_args()
    if given.priority:  # the controller goes before its driver, as a real one does not share its processor
        level = given.priority + (10 if given.twin else 0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(level))
    if given.twin:
        twin_process(given.twin)
        return
    for kind in given.kinds or ["egm", "rtde"]:
        print(kind)
        for name, value in measure(kind, given.for_s, given.priority).items():
            print(f"  {name}: {value}")


if __name__ == "__main__":
    main()
