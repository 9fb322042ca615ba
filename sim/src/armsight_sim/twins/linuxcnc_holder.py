"""Stands in the place of LinuxCNC's screen: switches on, homes, and ends LinuxCNC by ending.

Debian's Python runs it, with LinuxCNC's own module: holder.py ON UP OWNER. It writes the file UP where all joints are
homed, or what went wrong, and ends with the process OWNER, or where the file ON is taken away.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

WAIT_S = 20.0


def main() -> None:
    """Switch on, home, wait."""
    on, up, owner = Path(sys.argv[1]), Path(sys.argv[2]), Path("/proc", sys.argv[3])
    sys.path.append("/usr/lib/python3/dist-packages")
    import linuxcnc  # type: ignore[import-not-found]

    linuxcnc.nmlfile = str(up.parent / "linuxcnc.nml")
    stat, command = linuxcnc.stat(), linuxcnc.command()

    def until(what: str, holds: Callable[[Any], bool]) -> None:
        end_s = time.monotonic() + WAIT_S
        while time.monotonic() < end_s and on.exists() and owner.exists():
            stat.poll()
            if holds(stat):
                return
            time.sleep(0.02)
        raise SystemExit(f"{what} did not come to be within {WAIT_S:g} s")

    why = "up"
    try:
        command.state(linuxcnc.STATE_ESTOP_RESET)
        until("the end of the e-stop", lambda now: not now.estop)
        command.state(linuxcnc.STATE_ON)
        until("the machine's enabling", lambda now: bool(now.enabled))
        command.mode(linuxcnc.MODE_MANUAL)
        until("manual mode", lambda now: bool(now.task_mode == linuxcnc.MODE_MANUAL))
        command.teleop_enable(0)
        command.home(-1)  # all of them: homed one after the other without waiting, some never end
        until("the homing of all joints", lambda now: all(now.homed[: now.joints]))
        time.sleep(0.1)  # at its end the task turns to teleop
        command.teleop_enable(0)
        until("joint mode", lambda now: bool(now.motion_mode == linuxcnc.TRAJ_MODE_FREE))
    except SystemExit as error:
        why = str(error)
    new = up.with_suffix(".new")
    new.write_text(why, encoding="utf-8")
    new.replace(up)
    while on.exists() and owner.exists():
        time.sleep(0.1)


if __name__ == "__main__":
    main()
