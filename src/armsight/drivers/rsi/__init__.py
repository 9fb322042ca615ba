"""KUKA's Robot Sensor Interface: the controller sends its state as XML over UDP and is answered with a correction."""

from armsight.drivers.rsi.rsi_robot import RsiRobot

__all__ = ["RsiRobot"]
