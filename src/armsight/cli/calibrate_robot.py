"""`armsight calibrate` of the robot: hand-eye, tool tip, arm, where the rig stands, the whole cell."""

from __future__ import annotations

from armsight.cli.actions import add_action
from armsight.cli.command import calibrate
from armsight.file_names import CELL
from armsight.ops.calibrate_cell import calibrate_cell
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.calibrate_robot import calibrate_arm, calibrate_pivot, calibrate_robot_world, calibrate_tool_tip

add_action(calibrate, calibrate_hand_eye, filed="calibrate handeye", judged=True)
add_action(calibrate, calibrate_cell, own=CELL, filed="calibrate cell", judged=True)
add_action(calibrate, calibrate_tool_tip, filed="calibrate tooltip", judged=True)
add_action(calibrate, calibrate_pivot, filed="calibrate pivot", judged=True)
add_action(calibrate, calibrate_arm, filed="calibrate arm", judged=True)
add_action(calibrate, calibrate_robot_world, filed="calibrate robot-world", judged=True)
