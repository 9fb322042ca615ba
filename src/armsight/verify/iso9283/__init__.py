"""The figures of ISO 9283:1998 from measured poses, paths and arrivals, each with its own standard deviation."""

from armsight.verify.iso9283.evaluate import Iso9283Test as Iso9283Test
from armsight.verify.iso9283.evaluate import evaluate as evaluate
from armsight.verify.iso9283.figure import Figures as Figures
from armsight.verify.iso9283.figure import IsoFigure as IsoFigure
from armsight.verify.iso9283.motions import TestCube as TestCube
from armsight.verify.iso9283.observations import ArrivalTest as ArrivalTest
from armsight.verify.iso9283.observations import CommandedPath as CommandedPath
from armsight.verify.iso9283.observations import PathRun as PathRun
from armsight.verify.iso9283.observations import PathTest as PathTest
from armsight.verify.iso9283.observations import PoseVisits as PoseVisits
from armsight.verify.iso9283.observations import Stamps as Stamps
from armsight.verify.iso9283.plan import PlannedMotion as PlannedMotion
from armsight.verify.iso9283.plan import PlannedPose as PlannedPose
from armsight.verify.iso9283.plan import PlanOptions as PlanOptions
from armsight.verify.iso9283.plan import TestPlan as TestPlan
from armsight.verify.iso9283.plan import plan_test as plan_test
