"""Cures of arms: their kinematics, paths, calibrations, and measurements held against them."""

import math
import re
from pathlib import Path

import numpy as np
from cures_of_runs import HEAD, IN_TIME, JOIN, MOVING, OF_ARM, POSES, RESTING, VERIFY, row
from scipy.spatial.transform import Rotation

from armsight.control.paths import smoothed
from armsight.kinematics import preset
from armsight.store.path_file import read_path
from armsight.units import DEG
from armsight_lab.cell_plan.request import CellPlanJob

HOME = np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])
START = "-0.0078,-1.0686,1.6257,-0.5679,1.7323,0.1617"


def path(*, out=(0, 0.0), shift_m=0.0, tags=(), based=False):
    """Return 61 rows of 2 mm along y before an irb120's home; out: a row and by how much it is beside the others."""
    T = preset("irb120").fk(HOME)
    q = ",".join(f"{value:.9f}" for value in Rotation.from_matrix(T[:3, :3]).as_quat())
    text = "index,t_s,x_m,y_m,z_m,qx,qy,qz,qw,speed_m_s,tag\n"
    for k in range(61):
        x, y, z = T[:3, 3] + [shift_m, 0.002 * k, out[1] * (k == out[0])]
        text += f"{k},,{x:.9f},{y:.9f},{z:.9f},{q},,{dict(tags).get(k, '')}\n"
    return text


def walled(lower, upper):
    """Return limits with a forbidden box."""
    box = f"{{name: wall, lower_m: {lower}, upper_m: {upper}}}"
    return f"format: armsight/limits\nversion: 1\nforbidden: [{box}]\n"


def swinging():
    """Return 12 s in which one turning comes again and again."""
    turns = [[0.02 * k] + [0.4 * math.sin(2.0 * math.pi * 0.02 * k / 2.0 + j) for j in range(6)] for k in range(600)]
    return "t_s," + HEAD + "".join(map(row, turns))


FILES = {
    "taught.csv": path(),
    "outlier.csv": path(out=(30, 0.02)),
    "far.csv": path(shift_m=1.0),
    "tagged.csv": path(tags=((5, "weld_on"), (50, "weld_off"))),
    "tip.yaml": "format: armsight/tip\nversion: 1\ntip_m: [0.0, 0.0, 0.05]\n",
    "swinging.csv": swinging(),
    "wide.yaml": "format: armsight/limits\nversion: 1\njoints: ["
    + ", ".join(["{lower: -3.0, upper: 3.0}"] * 6)
    + "]\n",
    "tool.yaml": walled([-1.0, -0.3, 0.1], [-0.8, 0.0, 0.4]),
    "elbow.yaml": walled([-0.4, -0.2, 0.72], [-0.2, 0.2, 0.9]),
    "short.csv": "t_s," + HEAD + "".join(row([0.02 * k, *(0.01 * k * j for j in range(6))]) for k in range(20)),
}


def scaled(source, goal, columns, by):
    """Return a step that writes a table with some of its columns by a factor larger."""

    def step():
        head, *rows = Path(source).read_text().splitlines()
        at = [head.split(",").index(name) for name in columns]
        cells = [line.split(",") for line in rows]
        for line in cells:
            for k in at:
                line[k] = f"{float(line[k]) * by:.9g}" if line[k] else ""
        Path(goal).write_text("\n".join([head, *(",".join(line) for line in cells)]) + "\n")

    return step


def in_angles(goal):
    """Write pairs.csv with the flange's rotations as angles about z, the new y and the new x."""

    def step():
        head, *rows = Path("pairs.csv").read_text().splitlines()
        names = head.replace("base_flange_qx,base_flange_qy,base_flange_qz,base_flange_qw", "{}").split(",")
        at = names.index("{}")
        lines = [",".join(names).replace("{}", ",".join(f"base_flange_euler_{k}_deg" for k in (1, 2, 3)))]
        for line in rows:
            cells = line.split(",")
            turn = Rotation.from_quat([float(cell) for cell in cells[at : at + 4]]).as_euler("ZYX", degrees=True)
            lines.append(",".join([*cells[:at], *(f"{angle:.9f}" for angle in turn), *cells[at + 4 :]]))
        Path(goal).write_text("\n".join(lines) + "\n")

    return step


def with_covariance(goal, cov_x_y):
    """Return a step that writes the poses with deviations of 0.1 mm and 1 mrad, and with a covariance of x and y."""

    def step():
        head, *rows = Path("poses.csv").read_text().splitlines()
        names, cells = head.split(","), [line.split(",") for line in rows]
        told = {f"s{k}_m": "1e-4" for k in "xyz"} | {f"sr{k}_rad": "1e-3" for k in "xyz"} | {"cov_x_y": str(cov_x_y)}
        lines = [",".join(told.get(name, cell) for name, cell in zip(names, line, strict=True)) for line in cells]
        Path(goal).write_text("\n".join([head, *lines]) + "\n")

    return step


def untimed(source, goal):
    """Return a step that takes the times out of a table."""

    def step():
        lines = Path(source).read_text().splitlines(keepends=True)
        Path(goal).write_text("".join(line.partition(",")[2] for line in lines))

    return step


def without_limits():
    """Write the cell's arm without the ranges of its joints."""
    Path("open.yaml").write_text(re.sub(r"(lower|upper): [-.\d]+, ", "", Path("cell/arm.yaml").read_text()))


def plan(**more):
    """Return a call that plans a motion for the cell of given_files."""

    def made():
        from armsight_lab.cell_plan.run import run_cell_plan

        known = {"model": "cell/arm.yaml", "start": START, "duration_s": 20.0, "rate_hz": 50.0}
        return run_cell_plan(CellPlanJob(**{"out": Path("motion.csv"), **known, **more}))

    return made


POINTS = f"join --measured poses.csv {OF_ARM} -o x.csv"
PAIRS = f"join --measured poses.csv {OF_ARM} --as pairs --setup eye-to-hand -o pairs.csv"
CALIBRATE = "calibrate arm --model irb120 -o arm.yaml --points"
HANDEYE = "calibrate handeye --setup eye-to-hand -o h.yaml"
QS = tuple(f"q{k}" for k in range(1, 7))
EXPORT = "path export taught.csv -o a.script --speed-m-s 0.01"
ON_ARM = "--arm irb120"
STREAMS = f"{HANDEYE} --robot-stream measured.csv --camera-stream measured.csv"

TRIED = {
    ("control/paths/outliers.py", "Take the outlier out (armsight path smooth --outliers drop)"): (
        f"path export outlier.csv -o a.script --speed-m-s 0.01 {ON_ARM}",
        f"path smooth outlier.csv -o s.csv --outliers drop && path export s.csv -o a.script --speed-m-s 0.01 {ON_ARM}",
    ),
    ("ops/path/tools.py", "leave them out with --outliers drop"): (
        "path smooth outlier.csv -o s.csv",
        "path smooth outlier.csv -o s.csv --outliers drop && path smooth outlier.csv -o t.csv --outliers keep",
    ),
    ("control/paths/smoothing.py", "180 (pi rad) at most"): (
        lambda: smoothed(read_path(Path("taught.csv")), bound_m=0.0005, bound_rad=180.0),
        lambda: smoothed(read_path(Path("taught.csv")), bound_m=0.0005, bound_rad=math.pi),
    ),
    ("control/paths/along.py", "10 mm are 0.01"): (
        "path offset taught.csv -o a.csv --by-m 10",
        "path offset taught.csv -o a.csv --by-m 0.01",
    ),
    ("ops/path/export.py", "or one of the endings"): (
        "path export taught.csv -o a.txt",
        "path export taught.csv -o a.txt --to csv && path export taught.csv -o a.py",
    ),
    ("ops/path/export.py", "or omit --weld-output"): (
        f"{EXPORT} {ON_ARM} --weld-output 1",
        f"{EXPORT} {ON_ARM} && path export tagged.csv -o b.script --speed-m-s 0.01 {ON_ARM} --weld-output 1",
    ),
    ("ops/path/export.py", "Give the arm too"): (
        f"{EXPORT} --tip tip.yaml --frame base",
        f"{EXPORT} --frame base {ON_ARM}",
    ),
    ("ops/path/export.py", "whose file says it"): (EXPORT, f"{EXPORT} {ON_ARM} && {EXPORT} --frame base"),
    ("ops/path/export.py", "`armsight path check`"): (
        f"path export far.csv -o a.script --speed-m-s 0.01 {ON_ARM}",
        f"{EXPORT} {ON_ARM}",
    ),
    ("ops/kinematics_results.py", "Give radians, for instance"): (
        f"kinematics show {ON_ARM} --joints 0,90,0,0,0,0 -o a.html",
        f"kinematics show {ON_ARM} --joints 0,-1.2,0.4,0,0,0 -o a.html",
    ),
    ("calibrate/arm/points.py", "Give metres; the numbers look like"): (
        (POINTS, scaled("x.csv", "wrong.csv", ("x_m", "y_m", "z_m"), 100.0), f"{CALIBRATE} wrong.csv --as-stated"),
        f"{CALIBRATE} x.csv",
    ),
    ("calibrate/arm/points.py", "Give radians; the numbers"): (
        (POINTS, scaled("x.csv", "wrong.csv", QS, 1.0 / DEG), f"{CALIBRATE} wrong.csv --as-stated"),
        f"{CALIBRATE} x.csv",
    ),
    ("calibrate/handeye/consensus.py", "Give both tables in metres"): (
        (
            PAIRS,
            scaled("pairs.csv", "wrong.csv", [f"camera_target_{k}_m" for k in "xyz"], 3.0),
            f"{HANDEYE} --pairs wrong.csv --as-stated",
        ),
        f"{HANDEYE} --pairs pairs.csv",
    ),
    ("ops/calibration/handeye.py", "Give --euler {}"): (
        (PAIRS, in_angles("angles.csv"), f"{HANDEYE} --pairs angles.csv --euler xyz"),
        f"{HANDEYE} --pairs angles.csv --euler zyx",
    ),
    ("calibrate/handeye/stream_pairing.py", "Record ten seconds"): (
        POSES.replace("{}", "short.csv") + STREAMS,
        MOVING + STREAMS,
    ),
    ("calibrate/handeye/stream_pairing.py", "(--clocks-within)"): (
        POSES.replace("{}", "swinging.csv") + STREAMS,
        f"{STREAMS} --clocks-within 0.3",
    ),
    ("ops/join.py", "Give --joints, both files with t_s"): (
        (untimed("poses.csv", "m.csv"), f"{JOIN.replace('poses.csv', 'm.csv')} {OF_ARM} --still"),
        f"{RESTING}{IN_TIME} resting.csv --still",
    ),
    ("verify/alignment.py", "`--align both`"): (
        f"{VERIFY} --arm ur10 --joints j.csv",
        f"{VERIFY} --arm irb120 --joints j.csv --align both",
    ),
    ("verify/synchronise.py", "mirrored positions, millimetres"): (
        f"{MOVING}verify --measured measured.csv {ON_ARM} --joints resting.csv -o v",
        f"verify --measured measured.csv {ON_ARM} --joints moving.csv -o v",
    ),
    ("verify/synchronise.py", "or leave t_s out of both"): (
        POSES.replace("{}", "short.csv") + f"verify --measured measured.csv {ON_ARM} --joints short.csv -o v",
        (
            untimed("measured.csv", "m.csv"),
            untimed("short.csv", "q.csv"),
            f"verify --measured m.csv {ON_ARM} --joints q.csv -o v",
        ),
    ),
    ("store/covariances.py", "Write covariances in m and rad"): (
        (with_covariance("wrong.csv", 9.0), f"{VERIFY.replace('poses.csv', 'wrong.csv')} {OF_ARM}"),
        (with_covariance("right.csv", 1e-9), f"{VERIFY.replace('poses.csv', 'right.csv')} {OF_ARM}"),
    ),
    ("armsight_lab/cell_plan/run.py", "(--link-radius-mm)"): (
        plan(limits=Path("elbow.yaml")),
        lambda: [plan(limits=Path("elbow.yaml"), link_radius_m=0.01)(), plan()()],
    ),
    ("armsight_lab/cell_plan/plan.py", "or correct the boxes (--limits)"): (
        plan(limits=Path("tool.yaml")),
        plan(limits=Path("free.yaml")),
    ),
    ("armsight_lab/cell_plan/run.py", "or none of them, for small moves"): (plan(rig=Path("cell/rig.yaml")), plan()),
    ("armsight_lab/cell_plan/plan.py", "Give one value for each joint"): (plan(start="0,-1,1.6"), plan()),
    ("armsight_lab/cell_plan/plan.py", "or in limits.yaml (--limits)"): (
        (without_limits, plan(model="open.yaml")),
        lambda: [plan(model="open.yaml", limits=Path("wide.yaml"))(), plan()()],
    ),
    ("armsight_lab/cell_plan/plan.py", "Move it back within them"): (
        plan(limits=Path("aside.yaml")),
        lambda: [plan(start=START.replace("-0.0078", "0.5"), limits=Path("aside.yaml"))(), plan()()],
    ),
}
