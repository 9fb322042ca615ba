"""A camera on the flange that shows its last picture again and again, with new stamps: where the true arm then goes.

    python benchmarks/servo_pictures.py [--seeds 4] [--room workshop]

Pachidis 2005's cell with rendered pictures, measured and followed as by `armsight servo`. From a random moment on the
picture is the same to the last digit, or the same with a sensor's fresh noise. Judged as in servo_lies.py.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

from armsight.control.guard import Guard, Limits
from armsight.control.loop import ControlLoop
from armsight.control.servo import Mount, ServoSettings, ServoSource, chosen_gain, on_axis
from armsight.control.status import QueueSink, RobotStatus
from armsight.measure.poses.pipeline import Setup
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.servo.vision import ServoDevices, SteppedClock, Vision
from armsight.records import Silent
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.arm_file import arm_from_mapping
from armsight.units import MM
from bench import machine, table, test_scene
from servo import DELAY_S, DISTANCE_M, SERVO_S, off_by, puma

judge = test_scene("servo_lies")
NOISE_DN = 1.5
AFTER_S = 4.0
SHOWN = ("honest", "same pixels", "same picture, fresh noise")


def run(seed: int, shown: str, begun_s: float, room: str) -> Any:
    """Return the log of a run whose pictures stand from begun_s on."""
    rng, clock = np.random.default_rng([seed, 77]), SteppedClock()
    cell = puma(clock, hand="still" if seed % 4 == 0 else "random", speed=0.06, seed=seed, room=room)
    arm = arm_from_mapping(cell.robot.arm_mapping(), "arm")
    setup = Setup(
        rig_from_mapping(dict(cell.rig), ""), target_from_mapping(dict(cell.target), ""), overlaid=cell.one_image
    )
    T_flange_camera = cell.T_mount_rig * off_by(rng)
    cycle_s = cell.robot.cycle_s
    gain = chosen_gain(None, SERVO_S, DELAY_S).used
    settings = ServoSettings(
        mount=Mount.EYE_IN_HAND,
        T_parent_camera=T_flange_camera,
        T_flange_desired=on_axis(T_flange_camera, DISTANCE_M),
        gain_t=gain,
        gain_r=gain,
        arm_lag_s=2.0 * cycle_s,
    )
    source = ServoSource(arm, setup.rig, setup.target, settings, cycle_s)
    devices = ServoDevices(
        robot=cell.robot, pairs=cell.pairs, clock=clock, overlaid=cell.one_image, origin_s=lambda: cell.origin_s
    )
    vision = Vision(setup, devices, QueueSink())
    vision.source = source
    loop = ControlLoop(cell.robot, Guard(arm, Limits(), cycle_s), source, clock, enabled=lambda: True)
    log, pair_of, last = judge.Log(), cell.pairs.moment, {}

    def pair(index: int) -> Any:
        if shown == "honest" or index / cell.pairs.fps < begun_s:
            last["pair"] = pair_of(index)
            return last["pair"]
        return tuple(
            replace(frame, image=again(frame.image, shown, rng), t_s=index / cell.pairs.fps, sequence=index)
            for frame in last["pair"]
        )

    def note(status: RobotStatus) -> bool:
        log.t_s.append(status.t_s - cell.origin_s)
        log.tool.append(cell.robot.true_flange(status.t_s).as_matrix())
        log.states.append(status.guard)
        log.why.append(status.why)
        return False

    cell.pairs.moment = pair
    with cell.robot, cell.pairs:
        clock.watch(cell.pairs, vision.take)
        loop.run(for_s=begun_s + AFTER_S, until=note)
    return log


def again(image: np.ndarray, shown: str, rng: np.random.Generator) -> np.ndarray:
    """Return the picture as it is shown again."""
    if shown == "same pixels":
        return image
    most = np.iinfo(image.dtype).max
    return np.clip(np.round(image + rng.normal(0.0, NOISE_DN, image.shape)), 0, most).astype(image.dtype)


def cut(log: Any, begun_s: float) -> Any:
    """Return what a log has from a moment on."""
    first = int(np.searchsorted(log.t_s, begun_s))
    return judge.Log(t_s=log.t_s[first:], tool=log.tool[first:], states=log.states[first:], why=log.why[first:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--room", default="workshop")
    asked = parser.parse_args()
    prepare(Silent())
    print(machine())
    found: dict[str, list[Any]] = {shown: [] for shown in SHOWN[1:]}
    for seed in range(1, asked.seeds + 1):
        begun_s = float(np.random.default_rng([seed, 6]).uniform(2.5, 4.0))
        honest = cut(run(seed, "honest", begun_s, asked.room), begun_s)
        for shown in SHOWN[1:]:
            verdict = judge.judged(cut(run(seed, shown, begun_s, asked.room), begun_s), honest)
            print(seed, shown, f"{verdict.way_m / MM:.1f} mm", verdict.stopped, verdict.why, flush=True)
            found[shown].append(verdict)
    rows = [
        (
            shown,
            len(some),
            *(float(f([v.way_m / MM for v in some])) for f in (np.median, np.max)),
            sum(v.stopped for v in some),
        )
        for shown, some in found.items()
    ]
    table(
        "A picture that stands, Pachidis 2005's cell",
        ("shown", "runs", "way mm, median", "way mm, worst", "stopped"),
        rows,
    )


if __name__ == "__main__":
    main()
