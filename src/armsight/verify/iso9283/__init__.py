"""The figures of ISO 9283:1998 from measured poses, paths and arrivals, each with its own standard deviation."""

from armsight.verify.iso9283.evaluate import Iso9283Test, evaluate
from armsight.verify.iso9283.figure import Figure, Figures
from armsight.verify.iso9283.motions import TestCube
from armsight.verify.iso9283.observations import ArrivalTest, CommandedPath, PathRun, PathTest, PoseVisits, Stamps
from armsight.verify.iso9283.plan import PlannedMotion, PlannedPose, PlanOptions, TestPlan, plan_test

__all__ = [
    "ArrivalTest",
    "CommandedPath",
    "Figure",
    "Figures",
    "Iso9283Test",
    "PathRun",
    "PathTest",
    "PlanOptions",
    "PlannedMotion",
    "PlannedPose",
    "PoseVisits",
    "Stamps",
    "TestCube",
    "TestPlan",
    "evaluate",
    "plan_test",
]
