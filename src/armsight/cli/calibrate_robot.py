"""armsight calibrate handeye, tooltip, pivot, arm and robot-world."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from armsight.app import requests
from armsight.cli.actions import add_action
from armsight.cli.command import calibrate, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure, pose_rows
from armsight.ops.calibrate_robot import calibrate_arm, calibrate_pivot, calibrate_robot_world, calibrate_tool_tip
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.calibrate.handeye import HandEye


@command(calibrate, filed="calibrate handeye", judged=True)
def handeye(face: CommandUI, job: requests.calibrate_robot.HandEyeJob) -> None:
    """Find where the camera is on the hand (or beside the robot), and say whether the answer is right."""
    from armsight.app.calibrate.handeye import calibrate_handeye

    done = calibrate_handeye(job, face.progress("calibrating"))
    handeye_tables(face, done, job.out)
    face.result(done)


add_action(calibrate, calibrate_tool_tip, filed="calibrate tooltip", judged=True)
add_action(calibrate, calibrate_pivot, filed="calibrate pivot", judged=True)
add_action(calibrate, calibrate_arm, filed="calibrate arm", judged=True)
add_action(calibrate, calibrate_robot_world, filed="calibrate robot-world", judged=True)


def handeye_tables(face: CommandUI, done: HandEye, out: Path) -> None:
    """Print a hand-eye calibration."""
    poses = {
        "T_flange_camera": (done.T_flange_camera, done.std_camera),
        "T_base_target": (done.T_base_target, done.std_target),
        "T_base_camera": (done.T_base_camera, done.std_camera),
        "T_flange_target": (done.T_flange_target, done.std_target),
    }
    for name, (pose, std) in poses.items():
        if pose is not None:
            face.table(name, ["", "value", "+-"], pose_rows(pose, std))
    face.say(done.verdict)
    if done.comparison is not None:
        face.say(done.comparison.why)
    if done.camera_file is not None:
        face.say(f"The result belongs to the freed camera: {done.camera_file}")
    for text in done.advice:
        face.say(f"- {text}")
    for item in done.rejected[:8]:
        face.say(f"  left out: {item.name}: {item.why}")
    from armsight.geometry import xyz_quat

    for proposed in done.proposals or ():
        xyz, quat = (", ".join(f"{v:.4f}" for v in values) for values in xyz_quat(proposed.T_base_flange))
        face.say(f"  propose T_base_flange ({xyz}) m, ({quat}): then {figure(proposed.expected_std_m / MM, 2)} mm")
    face.say(f"Result: {out}; open {out.with_suffix('.report.html')}")
