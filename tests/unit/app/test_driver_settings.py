"""Drivers get what they need beyond their device: an arm where the link speaks of poses, the user's own tags."""

from pathlib import Path

import numpy as np
import pytest

from armsight.app.robot.opening import LinkArm, driver_settings
from armsight.errors import DataRefused, UsageError
from armsight.kinematics import presets
from refusals import refuses

Q = np.array([0.3, -1.1, 1.6, -0.9, 1.2, 0.4])


def test_an_arm_goes_from_joints_to_the_flange_and_back() -> None:
    link = LinkArm(arm=presets.ur10())
    T_base_flange = link.fk(Q)
    np.testing.assert_allclose(T_base_flange.as_matrix(), presets.ur10().fk(Q), atol=1e-12)  # no tool, base in world
    np.testing.assert_allclose(link.ik(T_base_flange, near=Q + 0.05), Q, atol=1e-6)


def test_a_pose_out_of_reach_is_refused() -> None:
    link = LinkArm(arm=presets.ur10())
    far = link.fk(Q).as_matrix().copy()
    far[:3, 3] *= 10.0
    with refuses(DataRefused, "reach"):
        link.ik(type(link.fk(Q)).from_matrix(far), near=Q)


def test_only_the_driver_that_needs_it_gets_it() -> None:
    arm = presets.ur10()
    assert set(driver_settings("alter:/dev/ttyS0", arm=arm)) == {"arm"}
    assert driver_settings("sim:webcam-cell", arm=arm) == {}
    assert driver_settings("rsi:49152", rsi_config=Path("x.xml")) == {"rsi_config": Path("x.xml")}
    with pytest.raises(UsageError, match="RSI"):
        driver_settings("egm:6510", rsi_config=Path("x.xml"))
