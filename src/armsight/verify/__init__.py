"""Is the arm where it says it is: measured against expected, and what the difference comes from."""

from armsight.verify.alignment import Align
from armsight.verify.cause import Cause
from armsight.verify.effects import JointVerdict, Kind
from armsight.verify.pairing import Paired, Reported
from armsight.verify.records import Figures, Measured, Repeats
from armsight.verify.verification import Configurations, Verification, verify

__all__ = [
    "Align",
    "Cause",
    "Configurations",
    "Figures",
    "JointVerdict",
    "Kind",
    "Measured",
    "Paired",
    "Repeats",
    "Reported",
    "Verification",
    "verify",
]
