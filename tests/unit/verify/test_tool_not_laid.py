"""Positions alone with the base laid and the tool as the arm's file has it: what a tool explains is no joint's."""

import numpy as np
import pytest

import armsight
from armsight.errors import Inconsistent
from refusals import refuses


def verified(tool_m, *, zero=None, known=False, n=30, how="base"):
    """Verify a UR10 whose tool's point is there in flange axes, one joint of which (from 0) reads 0.5 degrees less."""
    arm, rng = armsight.presets.ur10(), np.random.default_rng(1)
    q = np.array([0.0, -1.2, 1.5, -0.5, 1.0, 0.0]) + rng.uniform(-1.0, 1.0, (n, 6))
    T = arm.fk(q + np.deg2rad(0.5) * np.eye(6)[zero] if zero is not None else q)
    xyz = T[:, :3, 3] + T[:, :3, :3] @ np.asarray(tool_m) + [0.3, 0.2, 0.1] + rng.normal(0.0, 1e-4, (n, 3))
    if known:
        arm = arm.moved(dict(zip(("tool.x_m", "tool.y_m", "tool.z_m"), tool_m, strict=True)))
    seen = dict(zip(("x_m", "y_m", "z_m"), xyz.T, strict=True))
    return armsight.verify(seen, arm=arm, joints=q, align=how)


@pytest.mark.parametrize(("tool_m", "zero"), [((0.01, -0.005, 0.03), None), ((0.02, 0.0, 0.06), 2)])
def test_a_tool_that_the_arms_file_lacks_is_named(tool_m, zero):
    with refuses(Inconsistent, "tool", "align both"):
        verified(tool_m, zero=zero)


def test_its_cures_verify():
    tool_m = (0.01, -0.005, 0.03)
    assert verified(tool_m, how="both").after.rms_m < 3e-4
    assert verified(tool_m, known=True).after.rms_m < 3e-4


def test_a_tool_far_out_is_refused_as_no_fit():
    with refuses(Inconsistent, "align both"):
        verified((0.1, 0.0, 0.6))


@pytest.mark.parametrize(("tool_m", "zero"), [((0.0, 0.0, 0.0), 2), ((0.1, 0.0, 0.05), 5), ((0.1, 0.0, 0.05), 2)])
def test_a_joints_zero_stays_the_joints_where_the_tool_is_known(tool_m, zero):
    found = verified(tool_m, zero=zero, known=True)
    assert found.cause == f"joint {zero + 1}"
    if not any(tool_m):  # joint 6 moves nothing there, and is not judged
        assert not found.joints[5].judged and found.joints[5].offset_rad is None
