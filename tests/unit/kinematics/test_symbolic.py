"""The formulas, run and read."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.kinematics import Arm, fk_jacobian, in_convention, preset
from armsight.kinematics.symbolic import formulas, latex_source, python_source
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


def test_korayems_formulas_read_as_printed() -> None:
    """The corrected a_y (MATH A2), az and j56 of Korayem 2018, letter by letter."""
    f = formulas(preset("korayem6r"))
    names = {str(symbol): symbol for symbol in (*f.short, *f.constants)}
    c1, s1, c5, s5, c234, s234 = (names[key] for key in ("c1", "s1", "c5", "s5", "c234", "s234"))
    assert (f.T[1, 2] - (c1 * c5 - c234 * s1 * s5)).expand() == 0
    assert (f.T[2, 2] - s234 * s5).expand() == 0
    assert (f.J[4, 5] - f.T[1, 2]).expand() == 0
    assert str(f.short[c234]) == "cos(q2 + q3 + q4)"
    assert "a_y &= c_{1} c_{5} - c_{234} s_{1} s_{5}" in latex_source(preset("korayem6r"))


def test_a_name_that_is_no_name_is_refused_and_text_cannot_break_out() -> None:
    with refuses(UsageError, "not a name"):
        python_source(preset("stanford-rrp"), name="a b")
    arm = dataclasses.replace(preset("stanford-rrp"), name='x"""\nimport os\n"""')
    space: dict[str, object] = {}
    exec(compile(python_source(arm), "arm.py", "exec"), space)
    assert "os" not in space
