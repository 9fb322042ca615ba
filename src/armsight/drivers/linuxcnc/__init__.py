"""LinuxCNC: a bridge of ours beside it, by UDP. `python -m armsight.drivers.linuxcnc INI` sets the bridge up."""

from armsight.drivers.linuxcnc.driver import LinuxcncRobot, LinuxcncSettings
