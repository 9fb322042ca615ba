"""The plan of an ISO 9283 test for one arm: plan.csv and plan.json."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from armsight.app.arm_files import load_arm
from armsight.app.requests.verify import PlanJob
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.records import Progress
from armsight.records.output import Output, output
from armsight.store.atomic import write_json
from armsight.store.iso9283_plan import write_test_plan
from armsight.verify.iso9283 import PlannedMotion, PlanOptions, TestPlan, plan_test

PLAN, SUMMARY = "plan.csv", "plan.json"
PATHS = ("line", "rectangle", "large_circle", "small_circle")
CHOICES = ("cube", "poses", "paths")


@output
class PlannedCube(Output):
    """The test cube, in the arm's base frame."""

    centre_m: Annotated[list[float], Doc("Its centre, x y z.")]
    side_m: Annotated[float, Doc("Its side.")]
    plane: Annotated[str, Doc("The test plane: a, b, c or d.")]
    corners_m: Annotated[dict[str, list[float]], Doc("C1 to C8, x y z.")]


@output
class PlannedPose(Output):
    """A test pose."""

    xyz_m: Annotated[list[float], Doc("Position in world, x y z.")]
    q: Annotated[list[float], Doc("The controller's joint readings there, rad or m.")]


@output
class PlannedTest(Output):
    """A motion of the plan."""

    test: Annotated[str, Doc("Its name: the tag of its rows in plan.csv.")]
    figures: Annotated[list[str], Doc("What it is for.")]
    repeats: Annotated[int, Doc("How often it is made.")]
    n: Annotated[int, Doc("Its rows.")]


@output
class VerifyPlanOutput(Output):
    """armsight verify --plan."""

    arm: Annotated[str, Doc("The arm's name.")]
    cube: Annotated[PlannedCube, Doc("The test cube.")]
    quat_xyzw: Annotated[list[float], Doc("The tool's orientation in world.")]
    speed_m_s: Annotated[float, Doc("Speed along the paths: as wanted, or the highest that all joints allow.")]
    poses: Annotated[dict[str, PlannedPose], Doc("P1 to P5.")]
    motions: Annotated[list[PlannedTest], Doc("The motions written.")]
    branch: Annotated[list[str], Doc("The arm's configuration throughout.")]
    singularity_distance: Annotated[float, Doc("The least over all motions.")]
    limit_margin: Annotated[float | None, Doc("Least distance of a joint from a limit, rad or m; null: no limits.")]
    refused: Annotated[list[str], Doc("Larger cubes that were tried, and why not.")]
    files: Annotated[list[str], Doc("What was written.")]


def run_plan(job: PlanJob, progress: Progress | None = None) -> VerifyPlanOutput:
    """Plan the standard's test; write plan.csv and plan.json into the job's folder. Raises UsageError, DataRefused."""
    if job.arm is None:
        raise UsageError("a plan is made for an arm, and none was given", cure="Give --arm with its file or preset")
    options = PlanOptions(side_m=job.side_m, plane=job.plane)
    if job.speed_m_s is not None:
        options = replace(options, speed_m_s=job.speed_m_s)
    plan = plan_test(load_arm(job.arm), options, progress)
    chosen = replace(plan, motions=_chosen(plan, job.part))
    write_test_plan(job.out / PLAN, chosen)
    done = _output(plan, chosen.motions)
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


def _output(plan: TestPlan, motions: tuple[PlannedMotion, ...]) -> VerifyPlanOutput:
    corners = {f"C{i}": corner.tolist() for i, corner in enumerate(plan.cube.corners_m, start=1)}
    margin = plan.limit_margin
    return VerifyPlanOutput(
        arm=plan.arm,
        cube=PlannedCube(
            centre_m=plan.cube.centre_m.tolist(), side_m=plan.cube.side_m, plane=plan.cube.plane, corners_m=corners
        ),
        quat_xyzw=np.asarray(plan.quat_xyzw).tolist(),
        speed_m_s=plan.speed_m_s,
        poses={name: PlannedPose(xyz_m=xyz.tolist(), q=q.tolist()) for name, (xyz, q) in plan.poses.items()},
        motions=[
            PlannedTest(test=motion.test, figures=list(motion.figures), repeats=motion.repeats, n=len(motion.q))
            for motion in motions
        ],
        branch=list(plan.branch),
        singularity_distance=plan.singularity_distance,
        limit_margin=float(margin) if np.isfinite(margin) else None,
        refused=list(plan.refused),
        files=[PLAN, SUMMARY],
    )
