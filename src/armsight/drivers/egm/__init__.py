"""ABB's Externally Guided Motion: the controller sends its state over UDP each 4 ms and is answered with a goal."""

from armsight.drivers.egm.egm_robot import EgmRobot

__all__ = ["EgmRobot"]
