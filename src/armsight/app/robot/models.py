"""The model of a robot's arm, which the guard moves it by."""

from __future__ import annotations

from armsight.app.kinematics import load_arm
from armsight.app.robot.opening import SIM
from armsight.app.simulate.scenarios import build_world, load_scenario
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.store.arm_file import arm_from_mapping


def arm_model(robot: str, arm: str | None) -> Arm:
    """Return the arm of a robot DRIVER:DEVICE: the given file's or preset's; a simulated robot brings its own.

    Raises UsageError where none is given, and as load_arm and load_scenario do.
    """
    if arm is not None:
        return load_arm(arm)
    driver, _, device = robot.partition(":")
    if driver != SIM:
        raise UsageError(
            f"the arm behind {robot} is not known",
            consequence="The guard cannot keep its limits, so it is not moved",
            cure="Give --arm with its arm.yaml, its .urdf or a preset's name",
        )
    model, _ = load_scenario(device)
    world = build_world(device, model, seed=None, frames=1, room="dark")  # nobody looks: no room is drawn
    content = {"format": "armsight/arm", "version": 1, **world.nominal.mapping(world.T_flange_tool)}
    return arm_from_mapping(content, f"the arm of {device}")
