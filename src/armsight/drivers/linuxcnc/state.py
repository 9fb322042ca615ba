"""What LinuxCNC told in one cycle, and why it takes no motion."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.drivers.linuxcnc.offsets import Uncorrected

MAY, ENABLED, HOMED, JOINT_MODE, E_STOP, AUTO, MDI = (1 << i for i in range(7))
WHY = {
    0: "LinuxCNC took no motion meanwhile",
    1: "LinuxCNC had no answer for too long, and let the arm come to rest",
    3: "LinuxCNC did not take what it was sent (a limit, a hold), and stands elsewhere",
}
STOPPED = 2
MOVING = "LinuxCNC's joints have not come to rest yet"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinuxcncState:
    """What LinuxCNC told in one cycle.

    session, number, sample: of its motion, the packet and the servo. taken: the newest goal it took. flags: what it
    does. q, commanded, at (n,) in rad or m: measured, commanded, and where it is asked to be; of corrections `at` is
    what offsets (6,) it is asked for, bare what its program alone makes of the flange, and T_base_flange the correction
    that is measured: where the flange would be, had it stood in the base.
    """

    session: int
    number: int
    sample: int
    taken: int
    flags: int
    why: int
    q: Array
    commanded: Array
    at: Array
    bare: Uncorrected | None = None
    T_base_flange: RigidTransform | None = None

    @property
    def why_still(self) -> str:
        """Why it takes no motion just now, in words; empty where it does."""
        flags = self.flags
        words = (
            (flags & MAY, ""),
            (flags & E_STOP, "LinuxCNC is in e-stop"),
            (not flags & ENABLED, "LinuxCNC's machine is off"),
            (not flags & HOMED, "LinuxCNC is not homed, and knows no limits of its joints until then"),
            (self.bare and flags & JOINT_MODE, "LinuxCNC is in joint mode, and its offsets need MDI, AUTO or teleop"),
            (not self.bare and flags & AUTO, "LinuxCNC is in AUTO"),
            (not self.bare and flags & MDI, "LinuxCNC is in MDI"),
            (not self.bare and not flags & JOINT_MODE, "LinuxCNC is not in joint mode"),
        )
        return next((text for holds, text in words if holds), MOVING)
