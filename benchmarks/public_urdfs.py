"""Public arms' URDFs: each is read, with the forward kinematics of Pinocchio, or refused by its cause.

    python benchmarks/public_urdfs.py FOLDER [--all]

FOLDER holds checkouts of the repositories below, each under its name with a + for the slash, at the commit named
(git clone https://github.com/OWNER/NAME OWNER+NAME). None of their files is part of this project. --all: every URDF
that lies there, humanoids and grippers too, not the arms of the list alone.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from armsight.errors import ArmsightError
from armsight.kinematics import Arm, fk
from armsight.store.urdf import read_urdf

REPOSITORIES = {
    "Daniella1/urdf_files_dataset": "81f4cdac42c3a51ba88833180db5bf3697988c87",
    "Gepetto/example-robot-data": "39aa94379908fa743da90b21dc9e1fb8308f746b",
}

ARMS = {
    "Daniella1/urdf_files_dataset": """
        urdf_files/matlab/abb_irb120_support/urdf/abbIrb120.urdf
        urdf_files/matlab/abb_irb120_support/urdf/abbIrb120T.urdf
        urdf_files/matlab/abb_irb1600_support/urdf/abbIrb1600.urdf
        urdf_files/matlab/fanuc_lrmate200ib_support/urdf/fanucLRMate200ib.urdf
        urdf_files/matlab/fanuc_m16ib_support/urdf/fanucM16ib.urdf
        urdf_files/matlab/kortex_description/urdf/kinovaGen3.urdf
        urdf_files/matlab/mecademic_description/urdf/meca500r3.urdf
        urdf_files/matlab/motoman_mh5_support/urdf/yaskawaMotomanMH5.urdf
        urdf_files/matlab/qarm_description/urdf/quanserQArm.urdf
        urdf_files/matlab/ur_description/urdf/universalUR10.urdf
        urdf_files/matlab/ur_description/urdf/universalUR3.urdf
        urdf_files/matlab/ur_description/urdf/universalUR5.urdf
        urdf_files/matlab/ur_e_description/urdf/universalUR10e.urdf
        urdf_files/matlab/ur_e_description/urdf/universalUR16e.urdf
        urdf_files/matlab/ur_e_description/urdf/universalUR3e.urdf
        urdf_files/matlab/ur_e_description/urdf/universalUR5e.urdf
        urdf_files/robotics-toolbox/abb_irb140/urdf/irb140.urdf
        urdf_files/robotics-toolbox/abb_irb140/urdf/irb140QT.urdf
        urdf_files/robotics-toolbox/al5d_description/urdf/al5d_robot.urdf
        urdf_files/robotics-toolbox/fetch_description/robots/fetch_camera.urdf
        urdf_files/robotics-toolbox/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf
        urdf_files/robotics-toolbox/puma560_description/urdf/puma560_robot.urdf
        urdf_files/ros-industrial/abb/abb_irb2400_support/urdf/irb2400.urdf
        urdf_files/ros-industrial/abb/abb_irb6600_support/urdf/irb6640.urdf
        urdf_files/ros-industrial/kuka/kuka_kr120_support/urdf/kr120r2500pro.urdf
        urdf_files/ros-industrial/kuka/kuka_kr16_support/urdf/kr16_2.urdf
        urdf_files/ros-industrial/kuka/kuka_kr210_support/urdf/kr210l150.urdf
        urdf_files/ros-industrial/motoman/motoman_sia10d_support/urdf/sia10d.urdf
        urdf_files/ros-industrial/motoman/motoman_sia10f_support/urdf/sia10f.urdf
        urdf_files/ros-industrial/motoman/motoman_sia20d_support/urdf/sia20d.urdf
        urdf_files/ros-industrial/motoman/motoman_sia5d_support/urdf/sia5d.urdf
        urdf_files/ros-industrial/staubli/staubli_rx160_support/urdf/rx160.urdf
        urdf_files/ros-industrial/staubli/staubli_rx160_support/urdf/rx160l.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_crb15000_support/urdf/crb15000_5_95.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb1200_support/urdf/irb1200_5_90.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb1200_support/urdf/irb1200_7_70.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb120_support/urdf/irb120_3_58.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb120_support/urdf/irb120t_3_58.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb1600_support/urdf/irb1600_6_12.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb1600_support/urdf/irb1600_8_145.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb2600_support/urdf/irb2600_12_165.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb4400_support/urdf/irb4400l_30_243.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb4600_support/urdf/irb4600_20_250.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb4600_support/urdf/irb4600_40_255.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb4600_support/urdf/irb4600_60_205.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb52_support/urdf/irb52_7_120.urdf
        urdf_files/ros-industrial/xacro_generated/abb/abb_irb52_support/urdf/irb52_7_145.urdf
    """,
    "Gepetto/example-robot-data": """
        robots/hextilt_description/urdf/hextilt_flying_arm_5.urdf
        robots/talos_data/robots/talos_left_arm.urdf
        robots/z1_description/urdf/z1.urdf
    """,
}
"""By repository, a file a line: arms of four to seven joints."""

EQUAL = 1e-9
"""m, and parts of rotation matrices: as good as the product of ten transforms with numbers of that many digits."""

POSTURES = 20


def base_tool(pin: Any, model: Any, arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return T_base_tool (4, 4) by Pinocchio, with the arm's joints at their values q (n,) and all others at zero."""
    data, full = model.createData(), pin.neutral(model)
    for joint, value in zip(arm.joints, q, strict=True):
        one = model.joints[model.getJointId(joint.name)]
        full[one.idx_q : one.idx_q + one.nq] = [np.cos(value), np.sin(value)] if one.nq == 2 else [value]
    pin.framesForwardKinematics(model, data, full)
    base, tool = (data.oMf[model.getFrameId(link)] for link in (arm.base_link, arm.tool_link))
    return np.asarray((base.inverse() * tool).homogeneous)


def checked(pin: Any, path: Path) -> tuple[str, str, float]:
    """Return what became of a file, read, refused or unlike, in words, and how far it is from Pinocchio."""
    try:
        arm = read_urdf(path)
    except ArmsightError as error:
        return "refused", f"{error.cause.removeprefix(str(path) + ': ')[:110]}", np.nan
    told = f"{arm.n} joints, {arm.base_link} to {arm.tool_link}"
    try:
        model = pin.buildModelFromUrdf(str(path))
    except ValueError as error:
        return "read", f"{told}; Pinocchio refuses it: {str(error)[:60]}", np.nan
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0)
    off = 0.0
    for q in rng.uniform(np.minimum(low, high), np.maximum(low, high), (POSTURES, arm.n)):
        values = arm.values(q * [joint.driven for joint in arm.joints])
        ours = arm.T_world_base.inv().as_matrix() @ fk(arm, values)
        off = max(off, float(np.abs(ours - base_tool(pin, model, arm, values)).max()))
    return "read" if off <= EQUAL else "unlike", told, off


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--all", action="store_true")
    given = parser.parse_args()
    try:
        import pinocchio as pin
    except ImportError:
        print("skipped: Pinocchio (pin) is not installed")
        return 0
    counts: Counter[str] = Counter()
    worst = 0.0
    for repository in REPOSITORIES:
        folder = given.folder / repository.replace("/", "+")
        files = [folder / name for name in ARMS[repository].split()]
        if given.all:
            files = sorted(folder.rglob("*.[uU][rR][dD][fF]"))
        there = [path for path in files if path.is_file()]
        if len(there) < len(files) or not files:
            print(f"skipped: {folder} holds {len(there)} of {len(files)} files of {repository}")
        for path in there:
            what, why, off = checked(pin, path)
            counts[what] += 1
            worst = max(worst, off) if np.isfinite(off) else worst
            print(f"{what:8s} {off:8.1e}  {path.relative_to(given.folder)}: {why}")
    print(f"\n{sum(counts.values())} files: {dict(counts)}; furthest from Pinocchio {worst:.1e} (m, parts of matrices)")
    return 1 if counts["unlike"] else 0


if __name__ == "__main__":
    sys.exit(main())
