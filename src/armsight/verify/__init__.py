"""Is the arm where it says it is: measured against expected, and what the difference comes from."""

from armsight.verify.alignment import Align as Align
from armsight.verify.cause import Cause as Cause
from armsight.verify.model import JointVerdict as JointVerdict
from armsight.verify.model import Kind as Kind
from armsight.verify.pairing import Paired as Paired
from armsight.verify.pairing import Reported as Reported
from armsight.verify.records import Figures as Figures
from armsight.verify.records import Measured as Measured
from armsight.verify.records import Repeats as Repeats
from armsight.verify.verification import Configurations as Configurations
from armsight.verify.verification import Verification as Verification
from armsight.verify.verification import verify as verify
