"""Arms of bus servos: Feetech's STS and Robotis' Dynamixel X, on one serial line."""

from armsight.drivers.servo_bus.robot import DynamixelRobot, FeetechRobot
