"""A robot by what the person calls it, DRIVER:DEVICE, and the settings of its driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.app.requests.motion import RobotJob
from armsight.app.simulate.scenarios import load_scenario
from armsight.clock import Clock
from armsight.drivers import ROBOTS, Robot, known, load
from armsight.errors import DataRefused, UsageError
from armsight.kinematics import Arm

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


TAKES_ARM, TAKES_TAGS, LISTENS = ("alter", "egm", "rsi"), "rsi", ("egm", "rsi")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkArm:
    """An arm as a link of poses wants it: joint values to T_base_flange and back, on the branch of given joints."""

    arm: Arm

    def fk(self, q: NDArray[np.float64]) -> RigidTransform:
        """Return T_base_flange of the controller's joint values q (n,) in rad or m."""
        T_world_tool = RigidTransform.from_matrix(self.arm.fk(self.arm.values(q)))
        return self.arm.T_world_base.inv() * T_world_tool * self.arm.T_flange_tool.inv()

    def ik(self, T_base_flange: RigidTransform, near: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the controller's joint values (n,) nearest to near (n,). Raises DataRefused out of reach."""
        T_world_tool = self.arm.T_world_base * T_base_flange * self.arm.T_flange_tool
        found = self.arm.ik(T_world_tool, near=self.arm.values(near))
        if len(found) == 0:
            raise DataRefused(f"the pose is out of reach of {self.arm.name}", consequence="It is not sent")
        return self.arm.readings(found[0].q)


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

    arm: alter sends poses and needs it for joints; where others send poses it says how their probe moves every joint.
    rsi_config: the RSI Ethernet XML file with the tags of
    the user's own configuration. Raises UsageError for what the driver has no use for; of `given` the driver itself
    says that, and what it knows.
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
