"""Small data for every kind of report, and the commands that make the reports of it."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

import armsight
from armsight.kinematics import fk, moved, preset
from armsight.records import TaughtPath
from armsight.store.rigs import read_world

Step = str | Callable[[Path], None]
"""A command line without `armsight`, with paths inside the folder, or what makes a table there."""

RIG = "--rig cell/rig.yaml --target cell/target.yaml"
PAIR = f"--left cell/left --right cell/right {RIG}"
CELL = "simulate webcam-cell --frames 24 --room dark -o cell"
BOARD = "--board checkerboard:9x6:0.025"
RNG_SEED = 2


def write_visits(folder: Path) -> None:
    """Write visits.csv: thirty visits of each pose of plan/plan.csv, 30 um of noise, one pose 0.2 mm beside."""
    rng = np.random.default_rng(RNG_SEED)
    rows = list(csv.DictReader((folder / "plan/plan.csv").open()))
    poses = {row["pose"]: row for row in rows if row["tag"] == "poses" and row["pose"]}
    lines = ["pose,visit,x_m,y_m,z_m,qx,qy,qz,qw"]
    for visit in range(30):
        for name, row in poses.items():
            place = [float(row[key]) + rng.normal(0.0, 3e-5) for key in ("x_m", "y_m", "z_m")]
            place[0] += 2e-4 if name == "P2" else 0.0
            lines.append(",".join(map(str, [name, visit, *place, *(row[key] for key in ("qx", "qy", "qz", "qw"))])))
    (folder / "visits.csv").write_text("\n".join(lines) + "\n")


def write_crash(folder: Path) -> None:
    """Write poses.csv: the poses of poses/mastering.csv as a rig sees them, the third joint off by 0.5 deg."""
    q = np.loadtxt(folder / "poses/mastering.csv", delimiter=",", skiprows=1, usecols=range(1, 7))
    knocked = moved(armsight.read_arm(str(folder / "cell/arm.yaml")), {"j3.theta_rad": np.deg2rad(0.5)})
    T_rig_world = read_world(folder / "cell/world.yaml").T_parent_rig.inv()
    seen = T_rig_world * RigidTransform.from_matrix(fk(knocked, q))
    noise = np.random.default_rng(RNG_SEED).normal(0.0, 1e-4, (len(q), 3))
    rows = np.hstack([seen.translation + noise, seen.rotation.as_quat()])
    np.savetxt(folder / "poses.csv", rows, delimiter=",", header="x_m,y_m,z_m,qx,qy,qz,qw", comments="")


def write_readings(folder: Path) -> None:
    """Write joints.csv and measured.csv: sixty poses of a ur10 whose second joint's zero is off by 0.1 deg."""
    rng = np.random.default_rng(RNG_SEED)
    arm = preset("ur10")
    q = np.array([0.0, -1.2, 1.2, 0.0, 1.2, 0.0]) + rng.uniform(-1.2, 1.2, (60, 6))
    seen = RigidTransform.from_matrix(fk(moved(arm, {"j2.theta_rad": np.deg2rad(0.1)}), q))
    rows = np.hstack([seen.translation + rng.normal(0.0, 1e-4, (60, 3)), seen.rotation.as_quat()])
    names = ",".join(f"q{k}" for k in range(1, 7))
    np.savetxt(folder / "joints.csv", q, delimiter=",", header=names, comments="")
    np.savetxt(folder / "measured.csv", rows, delimiter=",", header="x_m,y_m,z_m,qx,qy,qz,qw", comments="")


def write_path(folder: Path) -> None:
    """Write path.csv: a straight way and one up, with the tool turned down."""
    step = np.linspace(0.0, 0.2, 41)
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (41, 1, 1))
    poses[:, :3, 3] = [0.35, -0.05, 0.3]
    poses[:, 1, 3] += np.minimum(step, 0.1)
    poses[:, 2, 3] += np.maximum(step - 0.1, 0.0)
    TaughtPath.of_poses(RigidTransform.from_matrix(poses)).save(folder / "path.csv")


KINDS: Mapping[str, tuple[Step, ...]] = {
    "measure": ("simulate webcam-cell --frames 24 --room workshop -o cell", f"measure {PAIR} -o measured"),
    "verify": (write_readings, "verify --measured measured.csv --arm ur10 --joints joints.csv -o verified"),
    "verify-live": (
        "simulate webcam-cell --frames 1 --room dark -o cell",
        "verify --live --robot sim:webcam-cell --play --left camera:sim:webcam-cell:left "
        f"--right camera:sim:webcam-cell:right {RIG} --arm cell/arm_true.yaml --world cell/world.yaml --warn-mm 5 "
        "--stop-mm 50 --frames 60 -o watch",
    ),
    "mastering": (
        "simulate webcam-cell --frames 1 --room dark -o cell",
        f"verify --mastering --arm cell/arm.yaml --world cell/world.yaml {RIG} "
        "--around=0,-1.0472,1.5708,-0.5236,1.5708,0 -o poses",
        write_crash,
        "verify --mastering --arm cell/arm.yaml --world cell/world.yaml --measured poses.csv "
        "--joints poses/mastering.csv -o crash",
    ),
    "iso9283": (
        "verify --plan --arm ur10 -o plan",
        write_visits,
        "verify --measured visits.csv --commanded plan/plan.csv --align none -o iso",
    ),
    "repeats": ("verify --plan poses --arm ur10 -o plan", write_visits, "verify --measured visits.csv -o repeats"),
    "stereo": (
        "simulate board-cell --frames 12 -o cell",
        f"calibrate stereo --left cell/left --right cell/right {BOARD} -o rig.yaml",
    ),
    "camera": ("simulate board-cell --frames 12 -o cell", f"calibrate camera cell/left {BOARD} -o camera.yaml"),
    "zoom": (
        *(f"simulate board-cell --frames 12 --zoom {zoom} -o zoom{zoom}" for zoom in (100, 300, 500)),
        *(f"calibrate camera zoom{zoom}/left {BOARD} --zoom {zoom} -o left.yaml" for zoom in (100, 300, 500)),
    ),
    "mirrors": (
        "simulate mirrors -o set",
        "calibrate mirrors --image set/complex --board checkerboard:7x5:0.015 -o rig.yaml",
        "measure --rig rig.yaml --target set/target.yaml --image set/lights -o measured",
    ),
    "handeye": ("simulate handeye -o set", "calibrate handeye --pairs set/pairs.csv -o handeye.yaml"),
    "arm": (
        "simulate arm-points -o set",
        "calibrate arm --model set/arm.yaml --points set/points.csv --holdout set/holdout.csv -o calibrated.yaml",
    ),
    "identify": (
        "simulate kapucu2005-rrp --room dark -o cell",
        f"identify {PAIR} --joints cell/sweep_joints.csv --world cell/world.yaml -o arm.yaml",
    ),
    "kapucu2005": ("reproduce kapucu2005 -o paper",),
    "korayem2018": ("reproduce korayem2018 --frames 12 -o paper",),
    "pachidis2005": ("reproduce pachidis2005 --frames 12 -o paper",),
    "kinematics": ("kinematics show --arm ur10e -o arm.html",),
    "path": (write_path, "path check path.csv --arm irb120 --speed-m-s 0.01 -o check.html"),
    "history": (
        "simulate handeye -o set",
        *("calibrate handeye --pairs set/pairs.csv -o handeye.yaml --cell a --history runs.sqlite" for _ in range(6)),
        "history trend --cell a --history runs.sqlite -o drift",
    ),
    "design": (
        CELL,
        f"design {RIG} --volume=-0.1:0.1,-0.1:0.1,1.5:1.8 --board checkerboard:9x6:0.04 --wanted-mm 0.5 -o planned",
    ),
    "compare": (
        CELL,
        "simulate webcam-cell --frames 24 --room dark --seed 5 -o again",
        f"measure {PAIR} -o a",
        f"measure --left again/left --right again/right {RIG} -o b",
        "compare a b -o compared",
    ),
}
"""Kind of report -> what makes it. `calibrate pivot`, `tooltip`, `timing` and `target`, servo, teach and play write
none."""
