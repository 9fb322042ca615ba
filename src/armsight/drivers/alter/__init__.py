"""Real-time path control over a serial line: the controller sends its state each 28 ms and is answered with a way."""

from armsight.drivers.alter.alter_robot import AlterRobot
