"""Defaults that both a calculation and the commands, pages and functions in front of it tell: each stands here once.

Nothing but numbers: help is shown without loading what uses them.
"""

import math

PATH_SPEED_M_S = 0.01
"""Along a path that says none: the pace of a welder's hand."""
BLEND_M = 0.003
"""Length over which a path's corners are rounded."""
APPROACH_SPEED_M_S = 0.02
RETRACT_M = 0.05
"""A path's start is neared from so far before it."""
HAND_SPEED_M_S = 0.05
"""With which the target of a simulated cell is led."""

SWEEP_SPEED = 0.1
"""Share of a joint's travel a second in a sweep."""
SWEEP_READINGS = 10

MOTION_S = 120.0
"""Of the motion by which a cell is calibrated."""
MOTION_HZ = 125.0
CAMERA_HZ = 30.0
SPOT_STD_PX = 0.1
"""Standard deviation of a spot's centre where the caller gives none: MATH 2.3 uses it for webcams."""

PLATE_NEAR_M = 0.06
"""From the lens to the plate of a mirror rig, as designed."""
MIRROR_GAP_M = 0.04
"""From the plate to the mirror behind it."""
GLASS = 1.5
"""Refractive index of ordinary glass."""

PICK_STD_PX = 0.5
"""A person's picks in a picture."""
PATCH_PX = 15
"""Side of what is looked for in the other picture."""
SMOOTHING_M = 5e-4
"""No row of a path moves further when it is smoothed."""
SMOOTHING_RAD = math.radians(1.0)
PATH_GAP_M = 1e-3
"""Between the ends of paths that are joined."""
PATH_GAP_RAD = math.radians(5.0)
LIT_LIGHTS = 3
SAG = 0.05
"""Standard deviation of what a joint gives way, rad per metre of lever of the weight that it carries."""
LENGTH_M = 2e-3
"""Standard deviation of a nominal arm's lengths, where positions alone are known."""
CELL_LENGTH_M = 1e-3
"""The same of an arm that stands in a cell with all of its lights and cameras unknown."""
ANGLE_RAD = 0.03
"""Standard deviation of a nominal arm's joint zeros and axes' directions."""
STALE_S = 0.02
"""Age of a controller's reading that is stale: two packets in a row may be late, and an ordinary system too."""
TIP_POINT_STD_M = 2e-4
"""Standard deviation believed of a point that a tip rests on: a dot measured by two cameras at 0.6 m."""
HEIGHT_STD_M = 5e-4
"""Standard deviation believed of a target's height: a rule, or the tool put on it."""
TOUCH_LENGTH_STD_M = 5e-5
"""Standard deviation believed of the distance of two touched points, or a ball's radius: calipers say 0.03 mm."""
TIP_GOAL_M = 1e-4
"""A tip known so well is good enough."""

UDP_CYCLE_S, RTDE_CYCLE_S, ALTER_CYCLE_S = 0.004, 0.002, 0.028
"""How often controllers send: by UDP, an e-Series by RTDE, and over a serial line at 38,400 baud."""
SERVO_CYCLE_S = 0.01
"""How often a bus of servos is asked and told: twice what six of them at 1 Mbit/s take."""
OPEN_S, RTDE_OPEN_S = 5.0, 8.0
"""Of waiting for a controller; one that is to load and start a program takes longer."""

STALE_CYCLES = 3.5
"""The same in cycles, where those are longer: two frames in a row may be lost, a third is a fault."""
TOOL_SPEED_M_S = 0.1
"""At which a tool or flange is led at most, where nothing else is said."""
TOOL_SPEED_RAD_S = math.pi / 3.0

LOOK_S = 0.005
"""Between two looks for a newer picture: a robot that tells 125 times a second is heard each time."""
LOST_LOOKS = 10
"""Looks in a row without what is looked for, from which on it is lost: lights hide behind the arm, and while the
screen's pictures come single ones are skipped."""
BLIND_S = 0.5
"""Nothing compared for so long is told."""
MASTERING_SPAN_RAD = math.radians(30.0)
"""How far joints go from those about which poses are proposed after a crash."""
JOINT_STD = 2e-5
"""Of a joint reading in rad or m: a step of a 17-bit encoder is 5e-5 rad."""
LATENCY_STD_S = 0.01
"""Of the time from an exposure to the frame in memory, of cameras nobody has measured."""

ITERATIONS, BOARD_ITERATIONS = 100, 60
"""Of a fit at most; of boards all but the first few steps change nothing that could be seen."""
JOINT_SCALE = 0.02
"""Standard deviation of a joint's scale."""
EXPORT_ACCELERATION_M_S2 = 0.5
"""Of the tool, in the programs of robots."""

FOLDS = 5
"""Of the error on boards that were left out."""
