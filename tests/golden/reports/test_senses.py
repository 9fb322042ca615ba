"""Strangers' arms whose joints count the other way than the model: named, and what cures them works."""

import re

import numpy as np
import yaml

from armsight.errors import Inconsistent
from armsight.kinematics import preset
from armsight.ops.arm_files import convert_arm
from armsight.ops.calibrate_robot import calibrate_arm
from refusals import names_it, refuses
from reports import case


def calibrated(tmp_path, points, model="irb120"):
    return calibrate_arm(str(model), case("arms-27") / points, out=tmp_path / "a.yaml")


def test_a_joint_that_counts_the_other_way_is_named_and_the_cure_works(tmp_path):
    points, joints = "points.csv", (2, 5)
    named = [f"j{j}" for j in joints]
    with refuses(Inconsistent, *named, "sign: -1", "the other way") as caught:
        calibrated(tmp_path, points)
    assert not (tmp_path / "a.yaml").exists()
    assert not [j for j in range(1, 7) if j not in joints and f"j{j} counted" in caught.value.cause]
    done = calibrated(tmp_path, points, corrected(tmp_path, caught.value.cure, joints))
    assert done.after.mean_m < 2e-3
    assert np.isfinite(done.after.max_m)


def corrected(folder, cure, reversed_=()):
    """Return the model's file with what the cure says added to its theta_rad, and these joints reversed."""
    convert_arm("irb120", folder / "irb120.yaml")
    content = yaml.safe_load((folder / "irb120.yaml").read_text())
    for j in reversed_:
        content["joints"][j - 1]["sign"] = -1
    for number, j in re.findall(r"(-?\d\.\d+) \(j(\d)\)", cure):
        content["joints"][int(j) - 1]["theta_rad"] += float(number)
    (folder / "irb120.yaml").write_text(yaml.safe_dump(content))
    return folder / "irb120.yaml"


def test_readings_that_count_from_other_places_are_named_and_the_cure_works(tmp_path):
    arm, rng = preset("irb120"), np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (60, 6))
    rows = np.column_stack([q - [0.0, 0.0, 0.6, 0.0, 0.0, 0.0], arm.fk(q)[:, :3, 3]])
    points = tmp_path / "x.csv"
    np.savetxt(points, rows, delimiter=",", header="q1,q2,q3,q4,q5,q6,x_m,y_m,z_m", comments="")
    with refuses(Inconsistent, "other places", "0.600 (j3)", "theta_rad") as caught:
        calibrated(tmp_path, points)
    done = calibrated(tmp_path, points, corrected(tmp_path, caught.value.cure))
    assert done.after.max_m < 1e-4


def test_verify_names_it_too(armsight, tmp_path):
    words = ["verify", "--measured", case("arms-27") / "points-j6.csv", "--arm", "irb120", "-o", tmp_path / "v"]
    refused = armsight(*words)
    assert refused.code == 3 and names_it(refused.text, "j6", "counted", "sign: -1")
    assert not (tmp_path / "v" / "verify.json").exists()
