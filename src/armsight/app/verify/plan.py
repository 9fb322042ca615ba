"""The plan of an ISO 9283 test for one arm: plan.csv and plan.json."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from armsight.app.requests.verify import PlanJob
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.ops.arm_files import load_arm
from armsight.records import Progress
from armsight.records.output import extended, output
from armsight.store.atomic import write_json
from armsight.store.path_file import write_test_plan
from armsight.verify.iso9283 import PlannedMotion, PlannedPose, PlanOptions, TestPlan, plan_test

PLAN, SUMMARY = "plan.csv", "plan.json"
PATHS = ("line", "rectangle", "large_circle", "small_circle")
CHOICES = ("cube", "poses", "paths")


@output
class VerifyPlanOutput(TestPlan):
    """armsight verify --plan."""

    poses: Annotated[dict[str, PlannedPose], Doc("P1 to P5.")]
    files: Annotated[tuple[str, ...], Doc("What was written.")]


def run_plan(job: PlanJob, progress: Progress | None = None) -> VerifyPlanOutput:
    """Plan the standard's test; write plan.csv and plan.json into the job's folder. Raises UsageError, DataRefused."""
    if job.arm is None:
        raise UsageError("a plan is made for an arm, and none was given", cure="Give --arm with its file or preset")
    options = PlanOptions(side_m=job.side_m, plane=job.plane)
    if job.speed_m_s is not None:
        options = replace(options, speed_m_s=job.speed_m_s)
    plan = plan_test(load_arm(job.arm), options, progress)
    motions = _chosen(plan, job.part)
    done = extended(plan, VerifyPlanOutput, motions=motions, poses=plan.tour, files=(PLAN, SUMMARY))
    write_test_plan(job.out / PLAN, done)
    write_json(job.out / SUMMARY, done.to_dict())
    return done


def _chosen(plan: TestPlan, what: str) -> tuple[PlannedMotion, ...]:
    names = list(dict.fromkeys(motion.test for motion in plan.motions))
    if what not in (*CHOICES, *names):
        raise UsageError(
            f"--plan {what} is not known", cure=f"Use one of: {', '.join(dict.fromkeys([*CHOICES, *names]))}"
        )
    wanted = {
        "cube": set(names),
        "poses": set(names) - set(PATHS),
        "paths": set(PATHS),
    }.get(what, {what})
    return tuple(motion for motion in plan.motions if motion.test in wanted)
