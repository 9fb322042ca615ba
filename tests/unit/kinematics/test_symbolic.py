"""The formulas, run and read."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.kinematics import Arm, fk_jacobian, in_convention, preset
from armsight.kinematics.symbolic import python_source
from refusals import refuses


def mounted(arm: Arm) -> Arm:
    rng = np.random.default_rng(0)
    joints = tuple(dataclasses.replace(j, theta_rad=0.1, beta_rad=0.02, sign=-1.0) for j in arm.joints)
    return dataclasses.replace(
        arm,
        joints=joints,
        T_world_base=RigidTransform.from_components([1, 2, 3], Rotation.random(rng=rng)),
        T_flange_tool=RigidTransform.from_translation([0, 0, 0.1]),
    )


@pytest.mark.parametrize("name", ["korayem6r", "stanford-rrp", "mounted", "craig"])
def test_the_python_module_gives_our_numbers(name: str) -> None:
    rrp = preset("stanford-rrp")
    arm = {"mounted": mounted(rrp), "craig": in_convention(rrp, "craig")}.get(name) or preset(name)
    space: dict[str, object] = {}
    exec(compile(python_source(arm, name="arm"), "arm.py", "exec"), space)
    for q in np.random.default_rng(1).uniform(-2, 2, (5, arm.n)):
        T, J = space["arm"](*q)  # type: ignore[operator]
        ours = fk_jacobian(arm, q)
        np.testing.assert_allclose(np.array(T, float), ours[0], atol=1e-13)
        np.testing.assert_allclose(np.array(J, float), ours[1], atol=1e-13)


def test_a_name_that_is_no_name_is_refused_and_text_cannot_break_out() -> None:
    with refuses(UsageError, "not a name"):
        python_source(preset("stanford-rrp"), name="a b")
    arm = dataclasses.replace(preset("stanford-rrp"), name='x"""\nimport os\n"""')
    space: dict[str, object] = {}
    exec(compile(python_source(arm), "arm.py", "exec"), space)
    assert "os" not in space
