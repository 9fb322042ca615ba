"""arm.yaml and URDF: round trips exact to 1e-12, and files that are refused, by name."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import Arm, fk, in_convention, moved, parameter_names, preset
from armsight.records import NamedCovariance
from armsight.store.arm_file import arm_from_mapping, arm_mapping, read_arm, write_arm
from armsight.store.urdf import arm_from_urdf, urdf_text, write_urdf
from refusals import refuses

ALL = ("irb120", "korayem6r", "stanford-rrp", "ur10")
PLACE = ["a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad"]
KEYS = [*PLACE, "sign", "lower", "upper", "max_speed", "stall_effort", "type"]


def variants(name: str) -> list[Arm]:
    """The preset; mounted somewhere with a tool; with every parameter off; with nearly parallel axes (beta)."""
    rng = np.random.default_rng(0)
    arm = preset(name)
    mounted = dataclasses.replace(
        arm,
        T_world_base=RigidTransform.from_components([1, 2, 3], Rotation.random(rng=rng)),
        T_flange_tool=RigidTransform.from_components([0.1, -0.2, 0.3], Rotation.random(rng=rng)),
        joints=tuple(dataclasses.replace(j, sign=-1.0 if k == 1 else 1.0) for k, j in enumerate(arm.joints)),
    )
    off = moved(arm, {key: rng.normal() * 1e-2 for key in parameter_names(arm)})
    second = arm.joints[1].name
    hayati = moved(arm, {f"{second}.alpha_rad": 1e-3, f"{second}.beta_rad": -2e-3, "tool.x_m": 0.1})
    return [arm, mounted, off, hayati, in_convention(off, "craig")]


def joint_values(arm: Arm) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.uniform(np.maximum(arm.lower, -3), np.minimum(arm.upper, 3), (20, arm.n))


@pytest.mark.parametrize("name", ALL)
def test_urdf_and_back_gives_the_same_poses(name: str) -> None:
    for arm in variants(name):
        q = joint_values(arm)
        once = arm_from_urdf(urdf_text(arm))
        twice = arm_from_urdf(urdf_text(once))
        np.testing.assert_allclose(fk(once, q), fk(arm, q), atol=1e-12)
        np.testing.assert_allclose(fk(twice, q), fk(arm, q), atol=1e-12)
        for joint, other in zip(arm.joints, once.joints, strict=True):
            for key in ("name", "lower", "upper", "max_speed", "stall_effort"):
                assert getattr(other, key) == pytest.approx(getattr(joint, key), abs=1e-12), (joint.name, key)


@pytest.mark.parametrize("name", ALL)
def test_arm_yaml_and_back_is_the_same_arm(name: str, tmp_path: Path) -> None:
    for k, arm in enumerate(variants(name)):
        path = tmp_path / f"{k}.yaml"
        write_arm(path, arm)
        q = joint_values(arm)
        for back in (read_arm(path), arm_from_mapping(arm_mapping(arm))):  # a robot tells its arm without a file
            for joint, other in zip(arm.joints, back.joints, strict=True):
                assert all(getattr(joint, key) == getattr(other, key) for key in KEYS)
            assert (back.name, back.convention, back.source) == (arm.name, arm.convention, arm.source)
            np.testing.assert_allclose(fk(back, q), fk(arm, q), atol=1e-12)


def test_standard_deviations_travel_with_the_arm(tmp_path: Path) -> None:
    matrix = np.array([[4e-8, 1e-8], [1e-8, 9e-8]])
    covariance = NamedCovariance(names=("j2.a_m", "j3.theta_rad"), matrix=matrix)
    arm = dataclasses.replace(preset("ur10"), covariance=covariance)
    write_arm(tmp_path / "arm.yaml", arm)
    back = read_arm(tmp_path / "arm.yaml")
    assert back.covariance is not None
    np.testing.assert_array_equal(back.covariance.matrix, matrix)
    assert "std: {a_m: 0.0002}" in (tmp_path / "arm.yaml").read_text().replace("\n", " ")
    only = arm_from_mapping(mapping(std={"d_m": 0.1}))
    assert only.covariance is not None
    assert only.covariance.std() == {"j1.d_m": pytest.approx(0.1)}


def mapping(**joint: object) -> dict[str, object]:
    row = {"name": "j1", "type": "revolute", **joint}
    return {"format": "armsight/arm", "convention": "standard", "joints": [row]}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (mapping(type="ball"), ("ball", "revolute, prismatic")),
        (mapping(lower=1.0, upper=-1.0), "swapped"),
        (mapping(sign=0.0), "sign"),
        ({**mapping(), "convention": "proximal"}, "convention"),
        (mapping(std={"a_m": -1.0}), "negative"),
    ],
)
def test_arm_yaml_that_cannot_be(content: dict[str, object], words: str) -> None:
    with refuses(BadFile, words):
        arm_from_mapping(content, "my.yaml")


JOINT = '<joint name="{name}" type="{type}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'
LIMIT = '<limit lower="-1" upper="1" effort="0" velocity="0"/>'


def robot(*joints: dict[str, str], links: int = 4, head: str = "") -> str:
    names = "".join(f'<link name="l{k}"/>' for k in range(links))
    body = "".join(
        JOINT.format(
            **{"name": f"j{k}", "type": "revolute", "parent": f"l{k}", "child": f"l{k + 1}", "more": LIMIT, **joint}
        )
        for k, joint in enumerate(joints)
    )
    return f'{head}<robot name="r">{names}{body}</robot>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (robot({"type": "floating"}, {}, {}), ("j0", "floating")),
        (robot({}, {"parent": "l0"}, links=3), ("branches", "l0", "j0, j1")),
        (robot({}, {"child": "l1"}, links=3), ("l1", "two joints")),
        (robot({}, {"parent": "l3", "child": "l2"}, links=4), ("2 root links", "l0, l3", "--base")),
        (robot({"parent": "l1", "child": "l0"}, {"parent": "l0", "child": "l1"}, links=2), "loop"),
        (robot({"type": "prismatic", "more": '<axis xyz="0 0 2"/>' + LIMIT}, links=2), ("j0", "length 2")),
        (robot({"more": '<limit lower="1" upper="-1"/>'}, links=2), "swapped"),
        (robot({"more": ""}, links=2), "no <limit>"),
        (robot({"more": LIMIT + '<mimic joint="j9"/>'}, links=2), "mimics"),
        (robot({"more": LIMIT + '<origin xyz="1 2" rpy="0 0 0"/>'}, links=2), "origin xyz"),
        (robot({"child": "l7"}, links=2), ("j0", "l7")),
        (robot({}, links=2, head='<!DOCTYPE r [<!ENTITY a "aaaa">]>'), "entities"),
        ("<robot", "XML"),
        ("<sdf/>", "<robot>"),
    ],
)
def test_urdf_that_is_refused(text: str, words: str) -> None:
    with refuses(BadFile, words) as error:
        arm_from_urdf(text, "my.urdf")
    assert "my.urdf" in str(error.value)


def test_a_scale_has_no_place_in_urdf(tmp_path: Path) -> None:
    arm = preset("ur10")
    scaled = dataclasses.replace(arm, joints=(dataclasses.replace(arm.joints[0], sign=1.01), *arm.joints[1:]))
    with pytest.raises(Inconsistent, match=r"by 1\.01"):
        write_urdf(tmp_path / "a.urdf", scaled)
