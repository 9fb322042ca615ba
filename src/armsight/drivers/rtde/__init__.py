"""Universal Robots behind RTDE, through the library ur-rtde."""

from armsight.drivers.rtde.rtde_robot import RtdeRobot
