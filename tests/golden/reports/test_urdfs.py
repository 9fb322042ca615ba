"""Strangers' URDFs: read as Pinocchio reads them, or refused by their cause; each cure is followed to the letter."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from armsight.errors import BadFile
from armsight.kinematics import fk
from armsight.ops.arm_files import load_arm
from armsight.store.arm_file import read_arm, write_arm
from armsight.store.urdf import arm_from_urdf, read_urdf
from refusals import names_it, refuses
from reports import case

SAME_ARM = [
    "bad_outside",
    "bom",
    "doctype",
    "far_outside",
    "fixed_axis0",
    "inertial_rpy",
    "inf_limits",
    "latin1",
    "lead_blank",
    "lead_comment",
    "lim_16pi",
    "lim_1e5_6r",
    "mass_neg_outside",
    "mimic_empty",
    "nan_vel",
    "newline_nums",
    "no_lohi",
    "ns_default",
    "ns_prefix_ok",
    "only_upper",
    "plain",
    "sw_zero",
    "two_roots",
    "unbound_prefix",
]
OWN_PLACES = [
    "anti",
    "ax2",
    "ax3",
    "ax4",
    "ax5",
    "ax6",
    "cc",
    "g",
    "lim_1e6",
    "m",
    "ob",
    "obl",
    "obl3",
    "p3",
    "scara",
    "sign",
    "table",
    "urcal",
    "rot_world_base",
]


@pytest.mark.parametrize("name", [*SAME_ARM, "utf16"])
def test_what_says_nothing_of_the_chain_changes_nothing_of_it(name):
    arm, plain = read_urdf(case("urdf") / f"{name}.urdf"), read_urdf(case("urdf") / "plain.urdf")
    q = np.random.default_rng(0).uniform(-1.9, 1.9, (20, 6))
    np.testing.assert_allclose(fk(arm, q), fk(plain, q), atol=1e-15)


@pytest.mark.parametrize("name", [*SAME_ARM, *OWN_PLACES, "rounded-axes"])
def test_poses_are_pinocchios(name):
    pin = pytest.importorskip("pinocchio", reason="Pinocchio (pin) is not installed")
    path = case("arms-07" if name == "rounded-axes" else "urdf") / f"{name}.urdf"
    try:
        model = pin.buildModelFromUrdf(str(path))
    except ValueError:
        pytest.skip("Pinocchio does not read it")
    arm, data = read_urdf(path), model.createData()
    low, high = np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0)
    for q in np.random.default_rng(1).uniform(low, high, (20, arm.n)):
        full = pin.neutral(model)
        for joint, value in zip(arm.joints, q, strict=True):
            one = model.joints[model.getJointId(joint.name)]
            full[one.idx_q : one.idx_q + one.nq] = [np.cos(value), np.sin(value)] if one.nq == 2 else [value]
        pin.framesForwardKinematics(model, data, full)
        base, tool = (data.oMf[model.getFrameId(link)] for link in (arm.base_link, arm.tool_link))
        ours = arm.T_world_base.inv().as_matrix() @ fk(arm, q)
        np.testing.assert_allclose(ours, (base.inverse() * tool).homogeneous, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("lim_1e6", (-math.inf, math.inf)),
        ("lim_1e5_6r", (-math.inf, math.inf)),
        ("inf_limits", (-math.inf, math.inf)),
        ("sw_zero", (-math.inf, math.inf)),
        ("no_lohi", (-math.inf, math.inf)),
        ("lim_16pi", (-50.3, 50.3)),
        ("only_upper", (0.0, 2.9)),
        ("nan_vel", (-2.0, 2.0)),
    ],
)
def test_limits_that_are_none_are_none_and_go_to_arm_yaml_and_back(name, limits, tmp_path):
    arm = load_arm(str(case("urdf") / f"{name}.urdf"))
    write_arm(tmp_path / "a.yaml", arm)
    for one in (arm, read_arm(tmp_path / "a.yaml")):
        assert (one.joints[0].lower, one.joints[0].upper) == limits
        assert (one.joints[1].lower, one.joints[1].upper) == (
            (-math.inf, math.inf) if name == "sw_zero" else (-2.9, 2.9)
        )
    assert ("0 to 0" in arm.source) is (name in ("sw_zero", "no_lohi"))


def test_a_mimicking_joint_follows_and_has_no_reading_of_its_own(tmp_path):
    """j2 mimics j1 by -1: where its column is 0, or its own value, as drivers and publishers have it."""
    arm, plain = load_arm(str(case("urdf") / "mimic_in.urdf")), load_arm(str(case("urdf") / "plain.urdf"))
    write_arm(tmp_path / "a.yaml", arm)
    for one in (arm, read_arm(tmp_path / "a.yaml")):
        for column in (0.0, -0.3):
            readings = np.array([0.3, column, 0.3, 0.3, 0.3, 0.3])
            right = fk(plain, [0.3, -0.3, 0.3, 0.3, 0.3, 0.3])
            np.testing.assert_allclose(fk(one, one.values(readings)), right, atol=1e-15)
        with pytest.raises(Exception, match="j2 has no drive"):
            one.values([0.3, 0.3, 0.3, 0.3, 0.3, 0.3])
        with pytest.raises(Exception, match="no drive"):
            one.ik(right)


REFUSED = {
    "commas": (("j2", "0.1, 0, 0.1"), [('xyz="0.1, 0, 0.1"', 'xyz="0.1 0 0.1"')]),
    "deg_limits": (
        ("j1", "-170 to 170", "degrees"),
        [('lower="-170" upper="170"', 'lower="-2.96705973" upper="2.96705973"'), ('lower="-90" upper="150"', None)],
    ),
    "dup_names": (("j2",), [('"j2" type="revolute"><parent link="l2"', '"j3" type="revolute"><parent link="l2"')]),
    "mass_missing_value": (("l2", "mass"), [("<mass/>", '<mass value="0.1"/>')]),
    "mm_prismatic": (("j2", "millimetres"), [('lower="0" upper="400"', 'lower="0" upper="0.4"')]),
    "rpy_deg": (("j2", "degrees"), [('rpy="-90 0 0"', 'rpy="-1.570796327 0 0"')]),
    "swapped": (("j1", "swapped"), [('lower="2.9" upper="-2.9"', 'lower="-2.9" upper="2.9"')]),
    "upper_type": (("j2", "Revolute"), [("Revolute", "revolute")]),
    "xyz_mm": (("j2", "100 0 100", "millimetres"), [('"100 0 100"', '"0.1 0 0.1"')]),
    "xacro": (("xacro",), [("${a} 0 ${b}", "0.1 0 0.1")]),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_read_once_its_cure_is_followed(name):
    words, edits = REFUSED[name]
    path = case("urdf") / f"{name}.urdf"
    text = path.read_text()
    for old, new in edits:
        with refuses(BadFile, *(words if new else ())) as error:
            arm_from_urdf(text, str(path))
        new = new or re.search(r'lower="\S+" upper="[^"]+"', error.value.cure)[0]
        if name in ("deg_limits", "rpy_deg", "xyz_mm", "mm_prismatic"):  # the cure gives the numbers
            assert all(number in error.value.cure for number in re.findall(r"-?\d+\.\d+", new))
        assert old in text
        text = text.replace(old, new)
    arm = arm_from_urdf(text)
    assert arm.n == 6
    if name not in ("mm_prismatic",):
        q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
        np.testing.assert_allclose(fk(arm, q), fk(read_urdf(case("urdf") / "plain.urdf"), q), atol=1e-9)


@pytest.mark.parametrize("name", ["xacro_macro.urdf", "sdf.urdf", "mjcf.xml"])
def test_other_formats_are_named(name):
    with refuses(BadFile, name) as error:
        load_arm(str(case("urdf") / name))
    assert names_it(error.value, "xacro" if "xacro" in name else "<robot>") or "robot" in str(error.value)
    assert error.value.cure
