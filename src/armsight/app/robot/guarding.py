"""The guard of a robot: from the arm's file, from the robot itself, or from its joints alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from armsight.control.guard import Guard, Limits
from armsight.drivers import Robot
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm, Joint
from armsight.store.arm_file import arm_from_mapping, read_arm
from armsight.store.interpret import limits_look_like_degrees
from armsight.store.limits_file import read_limits

BLIND_TURN_RAD_S = 0.1
"""Where the arm's lengths are not known, all joints together turn no faster: 0.1 m/s at one metre."""

BEHIND_LOOP_S = 0.1
"""Silence and lateness allowed to whoever asks a guarded loop for motion: meanwhile that one keeps the robot safe."""


def guard_for(robot: Robot, arm: Path | None = None, limits: Path | None = None, *, share: float = 1.0) -> Guard:
    """Return the guard of a robot; share: of all speeds. Nothing is opened.

    A robot that says it is `guarded` is behind a loop with a guard of its own. arm: its arm.yaml; without it the arm
    that the robot itself tells (a simulated one does), or joints without lengths, which are kept slow. limits:
    limits.yaml, or the defaults. Raises UsageError, BadFile, Inconsistent.
    """
    if not 0.0 < share <= 1.0:
        raise UsageError(
            f"the speed {share:g} is no share above 0 and up to 1",
            consequence="Nothing is moved",
            cure="Give for instance 0.2",
        )
    kept = Limits() if limits is None else read_limits(limits)
    if getattr(robot, "guarded", False):  # the loop that moves it watches its readings and cycles itself
        cycles = BEHIND_LOOP_S / robot.cycle_s
        kept = replace(kept, silent_cycles=max(kept.silent_cycles, cycles), late_cycles=max(kept.late_cycles, cycles))
    known = arm_of(robot, arm)
    if known is None:
        known = Arm(name=robot.name, joints=tuple(Joint(name=f"j{i + 1}") for i in range(robot.n_joints)))
        kept = replace(kept, turn_rad_s=min(kept.turn_rad_s, BLIND_TURN_RAD_S))
        if kept.workspace is not None or kept.forbidden:
            raise UsageError(
                "the limits hold boxes, and the arm's lengths are not known",
                consequence="Nothing is moved",
                cure="Give the arm (--arm), or limits without boxes",
            )
    if known.n != robot.n_joints:
        raise UsageError(
            f"{robot.name} has {robot.n_joints} joints, the arm {known.name} has {known.n}",
            consequence="Nothing is moved",
            cure="Give the arm of this robot (--arm)",
        )
    _check_degrees(known, kept, limits)
    return Guard(known, kept.slowed(share), robot.cycle_s)


def _check_degrees(arm: Arm, limits: Limits, file: Path | None) -> None:
    """Raise Inconsistent where the limits of revolute joints are degrees: they would keep the arm within nothing."""
    for k, (joint, revolute) in enumerate(zip(limits.joints, arm.revolute, strict=False)):
        if revolute and limits_look_like_degrees([joint.lower, joint.upper]):
            raise Inconsistent(
                f"{file}: joint {k + 1}: the limits {joint.lower:g} to {joint.upper:g} look like degrees",
                consequence="Taken as radians they would limit nothing; nothing is moved",
                cure="Write lower and upper in rad, or leave them out where the arm's own limits hold",
            )


def arm_of(robot: Robot, arm: Path | None) -> Arm | None:
    """Return the arm of the file, or the one that the robot tells; None where neither is there. Raises BadFile."""
    if arm is not None:
        return read_arm(arm)
    told = getattr(robot, "arm_mapping", None)
    return None if told is None else arm_from_mapping(told(), robot.name)
