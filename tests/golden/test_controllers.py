"""What a calibrated arm becomes in its controller: a controller that holds what the sheet says puts the tool there.

The controllers here are products of 4 x 4 matrices with the nominal table, the zeros, the tool and the frame as the
text of the sheet has them; nothing of what wrote the sheet.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Coupling, fk, preset
from armsight.ops.controllers import CONTROLLERS, controller_sheet
from armsight.store.arm_file import write_arm

NUMBER = r"-?\d+\.?\d*(?:e-?\d+)?"
ZEROS_DEG = (0.2, 0.3, -0.25, 0.15, -0.1)


def numbers(text):
    return [float(cell) for cell in re.findall(NUMBER, text)]


def placed(arm):
    """The arm in a measured world, with a tool."""
    base = RigidTransform.from_components([1.0, 0.2, 0.3], Rotation.from_euler("xyz", [1, 2, 30], degrees=True))
    tool = RigidTransform.from_components([0.01, 0.02, 0.15], Rotation.from_euler("xyz", [10, 20, 30], degrees=True))
    return replace(arm, T_world_base=base, T_flange_tool=tool)


def turned(arm, lengths=0.0):
    """The arm with readings that are short by ZEROS_DEG, and lengths off by some tenths of a mm."""
    changes = {
        f"{joint.name}.theta_rad": joint.sign * np.deg2rad(zero)
        for joint, zero in zip(arm.joints, ZEROS_DEG, strict=False)
    }
    more = {
        f"{arm.joints[1].name}.a_m": lengths,
        f"{arm.joints[1].name}.beta_rad": lengths,
        f"{arm.joints[3].name}.d_m": lengths,
    }
    return placed(arm).moved(changes | more)


def pose(numbers_mm, order, unit=1e-3):
    xyz, angles = np.array(numbers_mm[:3]) * unit, numbers_mm[3:6]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(order, angles, degrees=True).as_matrix()
    T[:3, 3] = xyz
    return T


def rapid_pose(cells):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(cells[3:7], scalar_first=True).as_matrix()
    T[:3, 3] = np.array(cells[:3]) * 1e-3
    return T


def ur_pose(cells):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(cells[3:6]).as_matrix()
    T[:3, 3] = cells[:3]
    return T


POSES = {
    "kuka": lambda text: pose(numbers(re.sub(r"\b[XYZABC] ", " ", text)), "ZYX"),
    "fanuc": lambda text: pose(numbers(text), "xyz"),
    "abb": lambda text: rapid_pose(numbers(text)),
    "staubli": lambda text: pose(numbers(text), "XYZ"),
    "ur": lambda text: ur_pose(numbers(text)),
}


def line_of(sheet, lead):
    return next(line[len(lead) :] for line in sheet.splitlines() if line.startswith(lead))


def by_products(nominal, q, rows=None):
    """The flange in the base by the nominal table, or by rows of it."""
    T = np.eye(4)
    for k, (joint, value) in enumerate(zip(nominal.joints, q, strict=True)):
        a, alpha, d, theta = (joint.a_m, joint.alpha_rad, joint.d_m, joint.theta_rad) if rows is None else rows[k]
        link = np.eye(4)
        link[:3, :3] = Rotation.from_euler("x", alpha).as_matrix()
        link[:3, 3] = a, 0.0, d
        around = np.eye(4)
        around[:3, :3] = Rotation.from_euler("z", joint.sign * value + theta).as_matrix()
        T = T @ around @ link
    return T


def postures(arm, n=60):
    rng = np.random.default_rng(4)
    return rng.uniform(np.clip(arm.lower, -3, 3), np.clip(arm.upper, -3, 3), (n, arm.n))


@pytest.mark.parametrize(
    ("to", "name"), [("kuka", "kr6"), ("abb", "irb120"), ("fanuc", "irb120"), ("staubli", "irb120")]
)
def test_zeros_base_and_tool_are_what_is_typed(to, name):
    """Zeros to 1e-5 deg, and the tool within the sheet's own digits, of an arm that differs by zeros alone."""
    nominal = preset(name)
    model = turned(nominal)
    sheet, found = controller_sheet(model, nominal, to)
    controller = CONTROLLERS[to]
    shown = [float(line_of(sheet, f"{controller.axis.format(k)}:").split()[0]) for k in range(1, 7)]
    assert shown[:5] == pytest.approx(ZEROS_DEG, abs=2e-5)
    tool = (
        POSES[to](line_of(sheet, controller.tool.removesuffix("[n] =")).split("=", 1)[-1])
        if to == "kuka"
        else POSES[to](line_of(sheet, controller.tool).removeprefix("[n]:"))
    )
    world = POSES[to](line_of(sheet, controller.frame))
    q = postures(nominal)
    wanted = fk(model, q)
    for reading, T in zip(q, wanted, strict=True):
        T_base_tool = by_products(nominal, reading + np.deg2rad(shown)) @ tool
        off = np.linalg.solve(world, T_base_tool) - T
        assert np.abs(off[:3, 3]).max() < 3e-6
    assert found.most_m < 1e-6
    assert found.before_m > 1e-3


def test_what_a_controller_does_not_hold_is_told_in_mm():
    """The loss of the sheet is that of the controller made of it, over other postures within a fifth."""
    nominal = preset("kr6")
    model = turned(nominal, lengths=4e-4)
    sheet, found = controller_sheet(model, nominal, "kuka")
    shown = [float(line_of(sheet, f"A{k}:").split()[0]) for k in range(1, 7)]
    tool, world = (POSES["kuka"](line_of(sheet, lead).split("=", 1)[1]) for lead in ("TOOL_DATA", "BASE_DATA"))
    q = postures(nominal, 300)
    off = [
        np.linalg.norm((np.linalg.solve(world, by_products(nominal, r + np.deg2rad(shown)) @ tool) - T)[:3, 3])
        for r, T in zip(q, fk(model, q), strict=True)
    ]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(found.rms_m, rel=0.2)
    assert found.rms_m > 2e-4
    assert found.before_m > found.most_m
    assert f"{found.rms_m * 1e3:.3f} mm RMS" in sheet


def test_a_universal_robot_holds_the_whole_table():
    nominal = preset("ur10e")
    changes = {"j2.theta_rad": 0.002, "j2.beta_rad": 0.001, "j3.beta_rad": -0.0007, "j3.alpha_rad": 0.002}
    changes |= {"j2.a_m": 0.0005, "j5.d_m": 0.0002, "j6.alpha_rad": 0.001, "j1.theta_rad": 0.01, "j1.d_m": 0.0003}
    model = placed(nominal).moved(changes)
    sheet, found = controller_sheet(model, nominal, "ur")
    lists = {
        key: np.array(numbers(line_of(sheet, key))) for key in ("delta_theta", "delta_a", "delta_d", "delta_alpha")
    }
    drawn = np.array([[j.a_m, j.alpha_rad, j.d_m, j.theta_rad] for j in nominal.joints])
    rows = drawn + np.stack([lists["delta_a"], lists["delta_alpha"], lists["delta_d"], lists["delta_theta"]], axis=1)
    tool, world = POSES["ur"](line_of(sheet, "set_tcp: p")), POSES["ur"](line_of(sheet, "feature (installation): p"))
    q = postures(nominal)
    for reading, T in zip(q, fk(model, q), strict=True):
        off = np.linalg.solve(world, by_products(nominal, reading, rows) @ tool) - T
        assert np.abs(off[:3, 3]).max() < 3e-6
    assert found.most_m < 1e-7
    assert lists["delta_theta"][0] == pytest.approx(0.01)


def test_readings_of_coupled_joints_get_zeros_of_their_own():
    """J3 against the horizontal: q3 = J3 + J2, so that a zero of joint 2 takes itself off that of J3."""
    nominal = preset("irb120")
    j2, j3 = nominal.joints[1].name, nominal.joints[2].name
    coupled = replace(nominal, couplings=(Coupling(joint=j3, by=j2, share=1.0),))
    model = replace(turned(nominal), couplings=coupled.couplings)
    _, found = controller_sheet(model, coupled, "fanuc")
    zeros = np.rad2deg(found.zeros)
    assert zeros[:5] == pytest.approx((0.2, 0.3, -0.25 - 0.3, 0.15, -0.1), abs=2e-5)


@pytest.mark.parametrize(
    ("to", "model", "nominal", "error", "match"),
    [
        ("kuka", "kr6", None, UsageError, "not given"),
        ("siemens", "kr6", "kr6", UsageError, "siemens"),
        ("kuka", "kr6", "irb120", Inconsistent, "no calibration of"),
        ("kuka", "kr6", "iiwa14", Inconsistent, "joints"),
        ("ur", "kr6", "kr6", Inconsistent, "backwards"),
    ],
)
def test_another_arm_is_refused(to, model, nominal, error, match, tmp_path):
    path = tmp_path / "arm.yaml"
    write_arm(path, placed(preset(model)))
    with pytest.raises(error, match=match) as found:
        armsight.convert(path, tmp_path / "out.txt", to=to, nominal=nominal)
    assert found.value.cure
    assert not (tmp_path / "out.txt").exists()


def test_a_sheet_is_not_written_over_a_model(tmp_path):
    path = tmp_path / "arm.yaml"
    write_arm(path, placed(preset("kr6")))
    with pytest.raises(UsageError, match="model"):
        armsight.convert(path, tmp_path / "new.yaml", to="kuka", nominal="kr6")
    done = armsight.convert(path, tmp_path / "krc.txt", to="kuka", nominal="kr6")
    assert (tmp_path / "krc.txt").read_text().startswith("# KUKA")
    assert done.lost_most_m < 1e-6
