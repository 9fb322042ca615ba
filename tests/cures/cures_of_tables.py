"""Cures of files: calibrations of others, tables, arms, targets, cameras."""

import random
from pathlib import Path

from armsight.ops.measurement.run import target_of
from armsight.store.tracks import read_times

ROWS = [
    [random.Random(k).uniform(-60.0, 60.0) for k in range(6 * i, 6 * i + 6)]
    + [random.Random(1000 + 3 * i + k).uniform(200.0, 600.0) for k in range(3)]
    for i in range(20)
]


def table(head, rows):
    return "\n".join([*([head] if head else []), *(",".join(f"{x:.5f}" for x in row) for row in rows)]) + "\n"


def pair(T="[-0.1, 0, 0]", D="[0, 0, 0, 0, 0]", size="image_width: 640\nimage_height: 480\n", more=""):
    """Return OpenCV's file of a pair."""
    cameras = "".join(f"M{i}: [[300, 0, 320], [0, 300, 240], [0, 0, 1]]\nD{i}: {D}\n" for i in (1, 2))
    return f"%YAML:1.0\n---\n{size}{cameras}R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: {T}\n{more}"


def target(*keys):
    return "\n".join(("format: armsight/target", "version: 1", "kind: spots", *keys)) + "\n"


def board(square_m, marker_m):
    sizes = f"columns: 5\nrows: 7\nsquare_m: {square_m}\nmarker_m: {marker_m}\ndictionary: DICT_5X5_50\n"
    return f"format: armsight/target\nversion: 1\nkind: charuco\n{sizes}"


def hung(parent, child):
    return f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.1 0 0.2"/><axis xyz="0 0 1"/>'


def urdf(links, *more):
    """Return an arm of one joint between base and arm with a fixed tip, and what else hangs on it."""
    named = "".join(f'<link name="{name}"/>' for name in links.split())
    turn = f'<joint name="a" type="revolute">{hung("base", "arm")}<limit lower="-3" upper="3"/></joint>'
    return (
        f'<robot name="r">{named}{turn}<joint name="b" type="fixed">{hung("arm", "tip")}</joint>{"".join(more)}</robot>'
    )


def arm(d_m, lower):
    """Return the file of an arm of two joints."""
    joint = f"alpha_rad: 1.2, a_m: 0.2, d_m: {d_m}, theta_rad: 0.1, lower: {lower}, upper: 2.0"
    joints = "".join(f"  - {{name: j{k}, type: revolute, {joint}}}\n" for k in (1, 2))
    return f"format: armsight/arm\nversion: 1\nname: two\nconvention: standard\njoints:\n{joints}"


FISH = "[-0.02, 0.006, -0.004, 0.0008]"
POINTS = "spots_m: {A: [0, 0.03, 0], B: [0.04, 0, 0], C: [0, -0.03, 0.01]}"
ANGLES = [[x / 1000.0 for x in row[6:]] + row[:3] for row in ROWS]
PLACES = [[*row[6:], 0.0, 0.0, 0.0, 1.0] for row in ROWS]
IN_M = [[*(x / 1000.0 for x in row[:3]), *row[3:]] for row in PLACES]
TURNS = [[x / 100.0 for x in row[:6]] for row in ROWS]
BEND = f'<joint name="c" type="planar">{hung("arm", "more")}</joint>'
MIMIC = (
    f'<joint name="c" type="revolute">{hung("tip", "more")}<limit lower="-1" upper="1"/><mimic joint="no"/></joint>'
    f'<joint name="no" type="revolute">{hung("more", "far")}<limit lower="-1" upper="1"/></joint>'
)
SECOND = f'<joint name="c" type="revolute">{hung("other", "more")}<limit lower="-1" upper="1"/></joint>'
CAMERA = "width: 640, height: 480, fx: 500, fy: 500, cx: 320, cy: 240, skew: 0, distortion: [0, 0, 0, 0, 0]"


def rig(x_m, camera=CAMERA):
    sides = "".join(
        f"  {side}: {{{camera}, T_rig_camera: {{xyz_m: [{x}, 0, 0], quat_xyzw: [0, 0, 0, 1]}}}}\n"
        for side, x in (("left", 0.0), ("right", x_m))
    )
    return f"format: armsight/rig\nversion: 1\nkind: stereo\ncameras:\n{sides}"


FILES = {
    "cm.yml": pair(T="[-7.5, 0, 0]"),
    "nosize.yml": pair(size=""),
    "fish.yml": pair(D=FISH),
    "fish-told.yml": pair(D=FISH, more="distortion_model: equidistant\n"),
    "cv.yml": pair(),
    "bare.csv": table("", ROWS),
    "degrees.csv": table("q1,q2,q3,q4,q5,q6", [row[:6] for row in ROWS]),
    "angles.csv": table("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", ANGLES),
    "none.csv": table("a,b,c", [[1.0, 2.0, 3.0]] * 5),
    "unnamed-mm.csv": table("x,y,z,qx,qy,qz,qw", PLACES),
    "mm.csv": table("x_mm,y_mm,z_mm,qx,qy,qz,qw", PLACES),
    "m.csv": table("x_m,y_m,z_m,qx,qy,qz,qw", IN_M),
    "m-as-mm.csv": table("x_mm,y_mm,z_mm,qx,qy,qz,qw", IN_M),
    "um-as-mm.csv": table("x_mm,y_mm,z_mm,qx,qy,qz,qw", [[*(1e3 * x for x in r[:3]), *r[3:]] for r in PLACES]),
    "um.csv": table("x_um,y_um,z_um,qx,qy,qz,qw", [[*(1e3 * x for x in r[:3]), *r[3:]] for r in PLACES]),
    "rad-as-deg.csv": table(",".join(f"q{k}_deg" for k in range(1, 7)), TURNS),
    "rad.csv": table(",".join(f"q{k}_rad" for k in range(1, 7)), TURNS),
    "rotvec.csv": table("x_m,y_m,z_m,rotvec_x_deg,rotvec_y_deg,rotvec_z_deg", [[*r[:3], 200, 80, 300] for r in ANGLES]),
    "middle.csv": table("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", [[*r[:3], r[3], 120 + r[4] / 9, 150] for r in ANGLES]),
    "flat.csv": table("", [[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]] * 8),
    "unnamed.csv": table("q1,q2,q3,a,b,c", [[0.1, 0.2, 0.3, 0.4, 0.5, 0.6 + 0.01 * k] for k in range(3)]),
    "unnamed_deg.csv": table(
        "q1_deg,q2_deg,q3_deg,a,b,c", [[5.0, 9.0, 3.0, 0.4, 0.5, 0.6 + 0.1 * k] for k in range(3)]
    ),
    "gap.csv": table("q1,q2,q4", [[0.1, 0.2, 0.01 * k] for k in range(9)]),
    "nogap.csv": table("q1,q2,q3", [[0.1, 0.2, 0.01 * k] for k in range(9)]),
    "late.csv": "t_s\n1.7e18\n1.7e18\n",
    "times.csv": "t_s\n1.7e9\n1700000000.02\n",
    "loose.yaml": target("diameter_m: 0.005"),
    "lit.yaml": target(POINTS),
    "labels.yaml": target("labels: [A, B, C]"),
    "std.yaml": target(POINTS, "std_m: {A: [0.001, 0.001, 0.001]}"),
    "stds.yaml": target(POINTS, "std_m: {A: [1e-4, 1e-4, 1e-4], B: [1e-4, 1e-4, 1e-4], C: [1e-4, 1e-4, 1e-4]}"),
    "marker.yaml": board(0.03, 0.04),
    "square.yaml": board(0.04, 0.03),
    "arm-mm.yaml": arm(300.0, -2.0),
    "arm.yaml": arm(0.3, -2.0),
    "arm-deg.yaml": arm(0.3, -170.0),
    "planar.urdf": urdf("base arm tip more", BEND),
    "fixed.urdf": urdf("base arm tip"),
    "mimic.urdf": urdf("base arm tip more far", MIMIC),
    "roots.urdf": urdf("base arm tip other more", SECOND),
    "rig-mm.yaml": rig(1e-9),
    "middle.yaml": rig(0.1, CAMERA.replace("cx: 320", "cx: 320000")),
    "pair.yaml": rig(0.1),
    "camera.yaml": f"format: armsight/camera\nversion: 1\n{CAMERA.replace(', ', chr(10), 7)}\n",
}

TABLE = "convert table"
ARM = "convert arm -o a.yaml"

TRIED = {
    ("store/foreign/numbers.py", "--unit 0.001"): ("convert rig cm.yml -o a.yaml", "{} --unit 0.01"),
    ("store/foreign/opencv.py", "--size 640x480"): ("convert rig nosize.yml -o a.yaml", "{} --size 640x480"),
    ("store/foreign/opencv.py", "distortion_model: equidistant"): (
        "convert rig fish.yml -o a.yaml",
        "convert rig fish-told.yml -o a.yaml",
    ),
    ("ops/conversion.py", "Give --to with"): (
        "convert rig cv.yml --to nothing -o a.yaml",
        "convert rig cv.yml --to ros -o l.yaml -o r.yaml",
    ),
    ("store/interpret/standard.py", "--columns q1..q6_deg,xyz_mm"): (
        f"{TABLE} bare.csv --as points -o a.csv",
        "{} --columns q1..q6_deg,xyz_mm",
    ),
    ("store/interpret/assemble.py", "--as-stated if they are radians"): (
        f"{TABLE} degrees.csv --as joints -o a.csv",
        "{} --units deg",
    ),
    ("store/interpret/assemble.py", "--euler with the order"): (
        f"{TABLE} angles.csv --as poses -o a.csv",
        "{} --euler xyz-fixed",
    ),
    ("ops/tables.py", "Give --as with"): (
        f"{TABLE} degrees.csv --as nothing -o a.csv",
        f"{TABLE} degrees.csv --as joints --units deg -o a.csv",
    ),
    ("store/interpret/assemble.py", "--as-stated if they are metres"): (
        f"{TABLE} unnamed-mm.csv --as poses",
        "{} --units mm",
    ),
    ("store/interpret/assemble.py", "um is 0.001 mm"): (
        f"{TABLE} um-as-mm.csv --as poses",
        f"{TABLE} um.csv --as poses && {TABLE} um-as-mm.csv --as poses --as-stated",
    ),
    ("store/interpret/assemble.py", "--as-stated if they are mm"): (
        f"{TABLE} m-as-mm.csv --as poses",
        f"{TABLE} m.csv --as poses && {TABLE} m-as-mm.csv --as poses --as-stated",
    ),
    ("store/interpret/assemble.py", "or give --as-stated if they are degrees"): (
        f"{TABLE} rad-as-deg.csv --as joints",
        f"{TABLE} rad.csv --as joints && {TABLE} rad-as-deg.csv --as joints --as-stated",
    ),
    ("store/interpret/assemble.py", "Give --euler with their order"): (
        f"{TABLE} rotvec.csv --as poses",
        "{} --euler xyz && {} --as-stated",
    ),
    ("store/interpret/assemble.py", "Check --euler or --robot-format"): (
        f"{TABLE} middle.csv --as poses --euler xyz",
        f"{TABLE} middle.csv --as poses --euler yxz && {{}} --as-stated",
    ),
    ("store/interpret/assemble.py", "Give --columns with the cells"): (
        f"{TABLE} flat.csv --as poses",
        f"{{}} --columns {','.join(f'm{row}{column}' for row in range(4) for column in range(4))}",
    ),
    ("ops/tables.py", "Name them in the first line, or give --columns"): (
        f"{TABLE} unnamed.csv --as points",
        "{} --columns q1,q2,q3,x_m,y_m,z_m",
    ),
    ("store/interpret/read.py", "Name them in the first line, or give --columns"): (
        f"{TABLE} unnamed_deg.csv --as points",
        "{} --columns q1_deg,q2_deg,q3_deg,x_m,y_m,z_m",
    ),
    ("store/interpret/read.py", "Say it with --as"): (
        f"{TABLE} none.csv",
        f"{TABLE} none.csv --as joints --columns q1,q2,q3",  # without columns it says what is missing
    ),
    ("store/interpret/standard.py", "Number the joints q1"): (
        f"{TABLE} gap.csv --as joints",
        f"{TABLE} nogap.csv --as joints && {{}} --columns q1,q2,q3",
    ),
    ("store/interpret/table_format.py", "Give --robot-format too"): (
        f"{TABLE} bare.csv --as joints --columns q1..q3_deg,pose",
        "{} --robot-format kuka",
    ),
    ("store/interpret/table_format.py", "Write for instance, in quotes"): (
        "verify --measured poses.csv --arm irb120 --joints j.csv -o v --units 'tracker:m;robot:rad'",
        "verify --measured poses.csv --arm irb120 --joints j.csv -o v --units 'measured:m;robot:rad'",
    ),
    ("store/interpret/table_format.py", "Write for instance mm,deg"): (
        f"{TABLE} degrees.csv --as joints --units grad",
        f"{TABLE} degrees.csv --as joints --units mm,deg",
    ),
    ("store/lost.py", "columns that are not used"): (
        "verify --measured unread.csv --arm irb120 --joints j.csv -o v",
        f"{TABLE} unread.csv --as poses --columns x_m,y_m,z_m,qx,qy,qz,qw,-,-,-,-,-,- -o read.csv && "
        "verify --measured read.csv --arm irb120 --joints j.csv -o v",
    ),
    ("store/tracks.py", "Give seconds; milliseconds"): (
        lambda: read_times(Path("late.csv")),
        lambda: read_times(Path("times.csv")),
    ),
    ("store/targets.py", "Give spots_m: "): (
        lambda: target_of(Path("loose.yaml")),
        lambda: [target_of(Path(name)) for name in ("lit.yaml", "labels.yaml")],
    ),
    ("store/targets.py", "Give std_m: "): (
        lambda: target_of(Path("std.yaml")),
        lambda: [target_of(Path(name)) for name in ("lit.yaml", "stds.yaml")],
    ),
    ("store/targets.py", "as marker_m, both in metres"): (
        lambda: target_of(Path("marker.yaml")),
        lambda: target_of(Path("square.yaml")),
    ),
    ("store/rigs.py", "Check T_rig_camera of both"): ("doctor --rig rig-mm.yaml", "doctor --rig pair.yaml"),
    ("optics/camera.py", "Look for a wrong decimal point"): ("doctor --rig middle.yaml", "doctor --rig pair.yaml"),
    ("store/arm_file.py", "Write metres: "): (f"{ARM} arm-mm.yaml", f"{ARM} arm.yaml"),
    ("store/arm_file.py", "Write radians; a joint"): (f"{ARM} arm-deg.yaml", f"{ARM} arm.yaml"),
    ("store/urdf.py", "Known are revolute"): (f"{ARM} planar.urdf --tip more", f"{ARM} planar.urdf --tip tip"),
    ("store/urdf.py", "Name the last link of the arm"): (
        f"{ARM} fixed.urdf --base arm --tip tip",
        f"{ARM} fixed.urdf --tip tip",
    ),
    ("store/urdf.py", "Choose a chain without it"): (f"{ARM} mimic.urdf --tip far", f"{ARM} mimic.urdf --tip tip"),
    ("store/urdf_tree.py", "Name it with --base"): (f"{ARM} roots.urdf", "{} --base base"),
    ("ops/arm_files.py", "Leave --tip and --base away"): (f"{ARM} arm.yaml --tip tip", f"{ARM} arm.yaml"),
    ("_files.py", "but not both"): (f"{ARM} roots.urdf#base:tip --tip tip", f"{ARM} roots.urdf#base:tip"),
    ("ops/convert.py", "and convert the file that is written"): (
        "convert rig pair.yaml --zoom-left 1 --to ros -o l.yaml -o r.yaml",
        "convert rig pair.yaml --to ros -o l.yaml -o r.yaml",
    ),
}
