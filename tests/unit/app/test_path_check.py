"""Whether a path can be run is asked once: `path check` and the page say what play does with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Limits
from armsight.control.play import PlaySettings, plan_path
from armsight.errors import ArmsightError
from armsight.kinematics import presets
from armsight.ops.path.check import checked
from armsight.records import TaughtPath

ARM = replace(presets.ur10(), T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.15]))
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
STAND = RigidTransform.from_matrix(ARM.fk(ARM.values(Q)))
STRAIGHT = np.linspace(0.0, 0.06, 61)


def along(x_m: np.ndarray, *, t_s: np.ndarray | None = None, turned: float = 0.0) -> TaughtPath:
    """Return a path along the x of the tool as it stands, turned about its z at the end."""
    rows = [
        STAND * RigidTransform.from_components([x, 0.0, 0.01], Rotation.from_rotvec([0.0, 0.0, z]))
        for x, z in zip(x_m, np.linspace(0.0, turned, len(x_m)), strict=True)
    ]
    return TaughtPath.of_poses(RigidTransform.concatenate(rows), t_s=t_s)


CASES = {
    "plain": along(STRAIGHT),
    "a pause at both ends": along(np.concatenate([np.zeros(30), STRAIGHT, np.full(30, 0.06)])),
    "rows 5 um apart": along(np.concatenate([STRAIGHT, STRAIGHT[-1] + [5e-6, 1e-5]])),
    "a tool that turns faster than the limits": along(np.linspace(0.0, 0.02, 21), turned=2.0),
    "a jump": along(np.concatenate([STRAIGHT[:30], STRAIGHT[30:] + 0.2])),
    "out of reach": along(np.linspace(0.0, 3.0, 600)),
}


@pytest.mark.parametrize("keep_rotation", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_a_check_says_what_play_does(name: str, keep_rotation: bool) -> None:
    path = CASES[name]
    try:
        plan, why = plan_path(path, ARM, Limits(), Q, PlaySettings(speed_m_s=0.05, keep_rotation=keep_rotation)), ""
    except ArmsightError as error:
        plan, why = None, error.cause
    told = checked(path, ARM, Limits(), speed_m_s=0.05, start=Q, keep_rotation=keep_rotation, page_of="p")
    assert (told.ok, told.refused) == (plan is not None, why)
    assert (plan is None) == (name in ("a jump", "out of reach"))
    assert plan is None or told.play_s == pytest.approx(plan.time_s)
    assert ("can be run" if told.ok else "cannot be run") in told.content
