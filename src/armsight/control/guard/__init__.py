"""Keeps an arm within limits: the one way from a set point to the robot."""

from armsight.control.guard.decision import Decision, GuardEvent, GuardState, Inputs, TargetState
from armsight.control.guard.guard import Guard
from armsight.control.guard.limits import Box, JointBounds, JointLimit, Limits, joint_bounds
