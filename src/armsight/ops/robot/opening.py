"""A robot by what the person calls it, DRIVER:DEVICE, with its driver's settings, its arm's model and its guard."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.control.guard import Guard, Limits
from armsight.control.guard.limits import JOINT_SPEED, SLIDE_SPEED_M_S, check_fit
from armsight.control.guard.space import Space
from armsight.drivers import ROBOTS, Robot, RobotTraits, known, load
from armsight.errors import DataRefused, Inconsistent, UsageError
from armsight.kinematics import Arm, Joint
from armsight.ops.arm_files import load_arm
from armsight.ops.requests.motion import RobotJob
from armsight.ops.simulation.scenarios import load_scenario
from armsight.store.arm_file import arm_from_mapping
from armsight.store.limits_file import read_limits
from armsight.units import DEG

SIM = "sim"


def open_robot(text: str, clock: Clock, settings: Mapping[str, Any] | None = None) -> Robot:
    """Return the robot that DRIVER:DEVICE names; nothing is opened yet.

    sim:SCENARIO is a scenario's robot by itself; where cameras watch it too, take live_cell, which puts all on one
    clock. ws://HOST:PORT is a robot server's. settings: what the driver takes beyond its device. Raises UsageError,
    DeviceNotFound with the drivers there are, BadFile for a scenario.
    """
    driver, colon, device = text.partition(":")
    if not (driver and colon and device):
        raise UsageError(
            f"{text!r} is not DRIVER:DEVICE",
            consequence="There is no robot",
            cure=f"Give for instance sim:webcam-cell; drivers are: {', '.join(known(ROBOTS))}",
        )
    maker = load(ROBOTS, "ws" if driver == "wss" else driver)
    if driver == SIM:
        model, _ = load_scenario(device)
        return cast(Robot, maker("", settings=model.model_dump(), clock=clock))
    name = text if driver in ("ws", "wss") else device
    return cast(Robot, maker(name, settings=dict(settings or {}), clock=clock))


TAKES_ARM, TAKES_TAGS, LISTENS = ("alter", "dynamixel", "egm", "feetech", "linuxcnc", "rsi"), "rsi", ("egm", "rsi")


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkArm:
    """An arm as a link of poses wants it: joint values to T_base_flange and back, on the branch of given joints."""

    arm: Arm

    def fk(self, q: NDArray[np.float64]) -> RigidTransform:
        """Return T_base_flange of the controller's joint values q (n,) in rad or m."""
        return RigidTransform.from_matrix(self.flange(q))

    def flange(self, q: NDArray[np.float64]) -> Array:
        """Return T_base_flange (4, 4) of the controller's joint values q (n,) in rad or m."""
        T_base_world, T_tool_flange, _ = self._ends
        return np.asarray(T_base_world @ self.arm.fk(self.arm.values(q)) @ T_tool_flange)

    @cached_property
    def _ends(self) -> tuple[Array, Array, Array]:
        """T_base_world, T_tool_flange (4, 4), and the tool's place in the flange (3,)."""
        T_tool_flange = self.arm.T_flange_tool.inv().as_matrix()
        p_flange_tool = np.asarray(self.arm.T_flange_tool.translation)
        return self.arm.T_world_base.inv().as_matrix(), T_tool_flange, p_flange_tool

    def jacobian(self, q: NDArray[np.float64]) -> Array:
        """Return the flange's way and turn (6, n) in base axes by the controller's joint values q (n,)."""
        J = self.arm.jacobian(self.arm.values(q)) @ self.arm.gearing
        T_base_world, _, p_flange_tool = self._ends
        way, turn = T_base_world[:3, :3] @ J[:3], T_base_world[:3, :3] @ J[3:]
        to_tool = self.flange(q)[:3, :3] @ p_flange_tool
        return np.concatenate([way + np.cross(to_tool, turn, axisb=0, axisc=0), turn])

    @property
    def ranges(self) -> Array:
        """Lower and upper (2, n); infinite where joints are coupled, whose readings have no range of their own."""
        ends = np.array([self.arm.lower, self.arm.upper])
        return np.array([[-np.inf], [np.inf]]) * np.ones(self.arm.n) if self.arm.couplings else ends

    def ik(self, T_base_flange: RigidTransform, near: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the controller's joint values (n,) nearest to near (n,). Raises DataRefused out of reach."""
        T_world_tool = self.arm.T_world_base * T_base_flange * self.arm.T_flange_tool
        found = self.arm.ik(T_world_tool, near=self.arm.values(near))
        if len(found) == 0:
            raise DataRefused(f"the pose is out of reach of {self.arm.name}", consequence="It is not sent")
        return self.arm.readings(found[0].q)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockedRobot:
    """A robot, not yet open, and the clock that its loop runs on. called: DRIVER:DEVICE, where it is one's."""

    robot: Robot
    clock: Clock
    called: str = ""


def clocked_robot(job: RobotJob, arm: Arm | None = None) -> ClockedRobot:
    """Return the robot that a job names or brings, and its clock; nothing is opened yet. Raises as open_robot."""
    clock = SystemClock()
    return job.device or ClockedRobot(robot=robot_of(job, clock, arm), clock=clock)


def robot_of(job: RobotJob, clock: Clock, arm: Arm | None = None) -> Robot:
    """Return the robot that a job names, with its driver's settings; nothing is opened yet. Raises as open_robot."""
    settings = driver_settings(job.robot, job.robot_settings, arm=arm, rsi_config=job.rsi_config)
    return open_robot(job.robot, clock, settings)


def open_to_all(job: RobotJob) -> str:
    """Return, in words, that a link listens on every network of this computer; empty where it does not."""
    settings = job.robot_settings or {}
    if job.robot.partition(":")[0] not in LISTENS or settings.get("controller") or settings.get("bind"):
        return ""
    return (
        f"{job.robot} listens on every network of this computer, and takes the first controller that sends; with "
        "--robot-set controller=ADDRESS it listens to that one alone"
    )


def refuse_settings(job: RobotJob) -> None:
    """Raise UsageError where a simulated robot, which is as its scenario says, is told its driver's settings."""
    driver_settings(job.robot, job.robot_settings, rsi_config=job.rsi_config)


def driver_settings(
    robot: str, given: Mapping[str, Any] | None = None, *, arm: Arm | None = None, rsi_config: Path | None = None
) -> dict[str, Any]:
    """Return the settings of the driver that DRIVER:DEVICE names: those given, and what it needs beside them.

    arm: alter sends poses and needs it for joints; where others send poses it says how their probe moves every joint;
    linuxcnc and buses of servos compare its ranges with theirs, and linuxcnc corrects poses by it. rsi_config: the RSI
    Ethernet XML file with the tags of the user's own configuration. Raises UsageError for what the driver has no use
    for; of `given` the driver itself says that.
    """
    driver = robot.partition(":")[0]
    settings = dict(given or {})
    if settings and driver == SIM:
        raise UsageError(
            f"{robot} takes no settings ({', '.join(settings)})",
            consequence="The robot is not opened",
            cure="Omit --robot-set: a simulated robot is as its scenario says",
        )
    if "arm" in settings:
        raise UsageError(
            "the arm is not a setting of a driver",
            consequence="The robot is not opened",
            cure="Give it with --arm",
        )
    if driver in TAKES_ARM and arm is not None:
        settings["arm"] = LinkArm(arm=arm)
    if rsi_config is not None:
        if driver != TAKES_TAGS:
            raise UsageError(f"{robot} takes no RSI configuration", cure="Omit --rsi-config, or give rsi:UDP_PORT")
        settings["rsi_config"] = rsi_config
    return settings


BLIND_TURN_RAD_S = 0.1
"""Where the arm's lengths are not known, all joints together turn no faster: 0.1 m/s at one metre."""

BEHIND_LOOP_S = 0.1
"""Silence and lateness allowed to whoever asks a guarded loop for motion: meanwhile that one keeps the robot safe."""


def guard_for(robot: Robot, arm: Arm | None = None, limits: Path | None = None, *, share: float = 1.0) -> Guard:
    """Return the guard of a robot; share: of all speeds. Nothing is opened.

    A robot that says it is `guarded` is behind a loop with a guard of its own. arm: None for the one
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
    if RobotTraits.of(robot).guarded:  # the loop that moves it watches its readings and cycles itself
        cycles = BEHIND_LOOP_S / robot.cycle_s
        kept = replace(
            kept,
            silent_cycles=max(kept.silent_cycles, cycles),
            late_cycles=max(kept.late_cycles, cycles),
            stall_s=max(kept.stall_s, kept.lost_s),  # a cycle waits for the network; the heartbeat finds a stand-still
        )
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
    with _of_file(limits):
        check_fit(known, kept)  # before a share of a speed in degrees looks like one in radians
        return Guard.of(robot, known, kept.slowed(share))


@contextlib.contextmanager
def _of_file(file: Path | None) -> Iterator[None]:
    """Put the name of the limits' file before what is wrong with them."""
    try:
        yield
    except (Inconsistent, UsageError) as error:
        if file is None:
            raise
        raise type(error)(f"{file}: {error.cause}", consequence=error.consequence, cure=error.cure) from error


def standing(robot: Robot, n: int) -> Array:
    """Return the readings (n,) at which an open robot was last told to stand; by its own where it takes only poses."""
    if not RobotTraits.of(robot).takes_joints:
        return robot.read().q
    return robot.step_joints(np.zeros(n)).q


def standing_outside(guard: Guard, robot: Robot) -> str:
    """Return which limits an open robot stands outside of, by how much and what is then followed; empty within.

    For whoever is asked whether it may move, and for the result: the guard tells it in the recording alone.
    """
    n = guard.arm.n
    q, still = standing(robot, n), np.zeros(n)
    outside = Space(guard.arm, guard.limits, guard.bounds).at(q, still, still, in_space=False).describe()
    return f"the arm stands {outside}" if outside else ""


def noted(outside: str, guard: Guard, job: RobotJob, file: Path | None, robot: Robot | None = None) -> str:
    """Return what is added to the question before a motion: where the arm stands outside its limits, what file, the
    limits.yaml that was given, leaves open, who may speak on the link, and what an open robot's controller lacks."""
    open_ = "" if file is None else left_open(guard.limits, file.name)
    texts = (outside, open_, open_to_all(job), *getattr(robot, "notes", ()))
    return "".join(f" Note: {text}." for text in texts if text)


def left_open(limits: Limits, file: str) -> str:
    """Return what a limits.yaml does not say and what holds instead, in words; empty where it says it."""
    holds = f"{JOINT_SPEED / DEG:.0f} deg/s or {SLIDE_SPEED_M_S:g} m/s where the arm's file gives no speed"
    open_ = []
    without = [str(j + 1) for j, row in enumerate(limits.joints) if row.speed is None]
    if not limits.joints:
        open_.append(f"no joints (the ranges of the arm's file hold, and {holds})")
    elif without:
        open_.append(f"no speed of joint {', '.join(without)} ({holds})")
    if limits.workspace is None:
        beside = " outside the forbidden boxes" if limits.forbidden else ""
        open_.append(f"no workspace (the tool may go wherever the joints reach{beside})")
    return f"{file} gives {' and '.join(open_)}" if open_ else ""


@contextlib.contextmanager
def beside_outside(outside: str) -> Iterator[None]:
    """Tell, with why a way is refused, that the arm stands outside its limits already."""
    try:
        yield
    except Inconsistent as error:
        if not outside or outside in error.cause:
            raise
        raise Inconsistent(f"{error.cause}; {outside}", consequence=error.consequence, cure=error.cure) from error


def arm_of(robot: Robot, arm: Arm | None) -> Arm | None:
    """Return the arm that is given, or the one that the robot knows; None where neither is there."""
    if arm is not None:
        return arm
    mapping = RobotTraits.of(robot).arm_mapping
    return None if mapping is None else arm_from_mapping(mapping(), robot.name)


def arm_model(robot: str, arm: str | None) -> Arm:
    """Return the arm of a robot DRIVER:DEVICE: the given file's or preset's; a simulated robot brings its own.

    Nothing is opened. Raises UsageError where none is given, and as load_arm and open_robot do.
    """
    if arm is not None:
        return load_arm(arm)
    known = arm_of(open_robot(robot, SystemClock()), None)
    if known is None:
        raise UsageError(
            f"the arm behind {robot} is not known",
            consequence="The guard cannot keep the limits of its tool, so it is not served",
            cure="Give --arm with its arm.yaml, its .urdf or a preset's name",
        )
    return known
