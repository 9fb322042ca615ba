"""plan.csv: the motions of an ISO 9283 test for one arm, with the columns of a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armsight.columns import POSE7
from armsight.store.atomic import write_text
from armsight.store.tables import cells
from armsight.verify.iso9283 import TestPlan

PLAN_COLUMNS = ("index", *POSE7, "speed_m_s", "tag", "pose", "repeats")


def write_test_plan(path: Path, plan: TestPlan) -> None:
    """Write plan.csv in one step: one row per commanded pose, in world, in the order of the motions.

    tag: the motion's name; pose: P1 to P5, empty on the way; repeats: how often the whole motion is made. Raises
    DeviceFailed where the disk refuses.
    """
    n = plan.motions[0].q.shape[1]
    rows = [",".join([*PLAN_COLUMNS, *(f"q{i + 1}" for i in range(n))])]
    for motion in plan.motions:
        for name, xyz, q in zip(motion.names, motion.xyz_m, motion.q, strict=True):
            numbers = cells(np.concatenate([xyz, plan.quat_xyzw, [plan.speed_m_s]]))
            rows.append(f"{len(rows) - 1},{numbers},{motion.test},{name},{motion.repeats},{cells(q)}")
    write_text(path, "\n".join(rows) + "\n")
