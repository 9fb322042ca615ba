"""One cheap good call of each action, as command words on files that are made once, and those that need a device."""

import os
import shlex
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from armsight.kinematics import preset
from armsight.records import TaughtPath
from armsight.store.arm_file import read_arm
from armsight.store.path_file import write_path
from simulated import simulated

POSE = "x_m,y_m,z_m,qx,qy,qz,qw"
LIT = "--rig lit/rig.yaml --target lit/target.yaml --left lit/left --right lit/right"
BOARD = "--board checkerboard:7x5:0.02"
PAIRS = f"--left boards/left --right boards/right {BOARD}"

CASES = {
    "boards.print_board": "board checkerboard:9x6:0.025 -o new.pdf",
    "calibrate_cameras.calibrate_camera": f"calibrate camera boards/left {BOARD} -o new.yaml",
    "calibrate_cameras.calibrate_stereo": f"calibrate stereo {PAIRS} -o new.yaml",
    "calibrate_cameras.calibrate_zoom_rig": "calibrate zoom-rig --rig zoom/rig.yaml --left zoom/left.yaml "
    "--zoom-left 35 --zoom-right 35 -o new.yaml",
    "calibrate_hand_eye.calibrate_hand_eye": "calibrate handeye --pairs pairs.csv -o new.yaml",
    "calibrate_mirrors.calibrate_mirrors": f"calibrate mirrors --image complex {BOARD} -o new.yaml",
    "calibrate_mirrors.check_mirrors": f"calibrate mirrors --check --rig mirrors.yaml --image some {BOARD}",
    "calibrate_rig.calibrate_cameras": "calibrate cameras --camera west=boards/left --camera east=boards/right "
    f"{BOARD} -o new.yaml",
    "calibrate_rig.calibrate_target": "calibrate target --rig webcam/rig.yaml --left webcam/left --right webcam/right "
    "--lights 3 -o new.yaml",
    "calibrate_rig.calibrate_timing": "calibrate timing --rig lit/rig.yaml --target lit/target.yaml "
    "--left-spots waved-left.csv --right-spots waved-right.csv -o new.yaml",
    "calibrate_robot.calibrate_tool_tip": "calibrate tooltip --poses pivot/flange.csv -o new.yaml",
    "calibrate_robot.calibrate_pivot": "calibrate pivot --rig pivot/rig.yaml --target pivot/target.yaml "
    "--left pivot/left --right pivot/right -o new.yaml",
    "calibrate_robot.calibrate_arm": "calibrate arm --model points/arm.yaml --points points/points.csv "
    "--holdout points/holdout.csv --propose 2 -o new.yaml",
    "calibrate_robot.calibrate_robot_world": "calibrate robot-world --arm points/arm_tool.yaml "
    "--points points/observed.csv -o new.yaml",
    "convert.camera": "convert camera camera.yaml --to ros -o new.yaml",
    "convert.rig": "convert rig lit/rig.yaml --to opencv -o new.yml",
    "convert.poses": "convert poses poses.csv -o new.tum",
    "convert.any_table": "convert table log.txt --robot-format kuka --as robot_poses -o new.csv",
    "convert.handeye": "convert handeye webcam/handeye.yaml --to easy_handeye -o new.yaml",
    "convert.arm": "convert arm robot.urdf -o new.yaml",
    "convert.export_recording": "convert recording lit.mcap -o new",
    "files.compare": "compare zoom/rig.yaml zoom/again.yaml --distance 1.2 -o new",
    "files.join": "join --measured poses.csv --joints joints.csv --arm irb120 --as points --offset 0 -o new.csv",
    "identify.identify_arm": "identify --sweep sweep.csv -o new.yaml",
    "kinematics.fk": "kinematics fk --arm irb120 --joints joints.csv -o new.csv",
    "kinematics.ik": "kinematics ik --arm irb120 --poses poses.csv --near joints.csv -o new.csv",
    "kinematics.jacobian": "kinematics jacobian --arm irb120 --joints joints.csv -o new.csv",
    "kinematics.path": "kinematics path --arm irb120 --poses poses.csv --start joints.csv -o new.csv",
    "kinematics.write_formulas": "kinematics formulas --arm webcam/arm.yaml -o new.tex",
    "kinematics.show_arm": "kinematics show --arm webcam/arm.yaml -o new.html",
    "machine.write_simulation": "simulate hand-cell --frames 1 --room dark -o new",
    "machine.doctor": "doctor --rig lit/rig.yaml --depth 1.5",
    "measure.measure": f"measure {LIT} -o new",
    "measure.record": "record --left lit/left --right lit/right --rig lit/rig.yaml --target lit/target.yaml "
    "--frames 3 -o new.mcap",
    "paths.smooth": "path smooth path.csv --bound-m 0.0005 -o new.csv",
    "paths.resample": "path resample path.csv --step-m 0.005 -o new.csv",
    "paths.fillet": "path fillet path.csv --radius-m 0.005 -o new.csv",
    "paths.offset": "path offset path.csv --by-m -0.01 -o new.csv",
    "paths.angle": "path angle path.csv --travel-deg 15 -o new.csv",
    "paths.reverse": "path reverse path.csv -o new.csv",
    "paths.join": "path join first.csv second.csv -o new.csv",
    "paths.check": "path check path.csv --arm webcam/arm.yaml --limits limits.yaml -o new.html",
    "paths.export": "path export path.csv --to krl --arm webcam/arm.yaml --tool 1 -o new.src",
    "paths.from_picks": "path from-picks --left plane/left.png --right plane/right.png --rig plane/rig.yaml "
    "--picks picks.csv --world webcam/world.yaml --skip -o new.csv",
    "teach.teach": "teach --from poses.csv --tip tip.yaml -o new",
    "verify.verify": "verify --measured poses.csv --arm irb120 --joints joints.csv -o new",
    "verify.plan_verification": "verify --plan --arm irb120 -o new",
    "mastering.propose_mastering_poses": "verify --mastering --arm webcam/arm.yaml --rig webcam/rig.yaml "
    "--target webcam/target.yaml --world webcam/world.yaml --around=0,-1.07,1.63,-0.57,1.73,0.16 -o new",
}
"""By module and function of armsight.ops: a good call in the folder of `make_files`; what it writes is called new."""
COSTLY = {
    "calibrate_cell.calibrate_cell": "calibrate cell --robot-log cell/joints.csv --left-spots cell/left.csv "
    "--right-spots cell/right.csv --size 1280x720 --target cell/target.yaml --model cell/arm.yaml -o new",
    "machine.reproduce": "reproduce kapucu2005 -o new",
}
"""Which take ten seconds and more: what they refuse is tried; tests/unit/cli/test_cell.py and tests/truth run them."""
ON_DEVICES = {
    "calibrate_rig.calibrate_noise": "Python's; its command is calibrate camera --noise: tests/unit/cli/test_noise.py",
    "identify.identify_arm_live": "moves a robot before cameras: tests/unit/app/test_identify_live.py",
    "motion.play": "moves a robot: tests/unit/control/test_play.py, tests/unit/cli/test_teach_play.py",
    "motion.servo": "moves a robot before cameras: tests/unit/control/test_servo.py",
    "robots.check_robot": "reads a robot: tests/unit/cli/test_robot.py",
    "robots.jog": "moves a robot: tests/unit/cli/test_robot.py",
    "robots.run_motion": "moves a robot: tests/unit/app/test_run_motion_cameras.py",
    "verify.supervise": "watches a robot before cameras: tests/unit/app/test_verify_live.py",
    "mastering.check_mastering": "judges poses that an arm went to as it was told: tests/unit/verify/test_mastering.py",
}
"""Actions without a case, and which tests run them."""


def run(words: str) -> Any:
    """Run a command with --json in this process."""
    from armsight.cli.commands import app

    return CliRunner().invoke(app, [*shlex.split(words), "--json"])


def make_files(folder: Path, drawn: Path, boards: Path, mirrors: Path) -> None:
    """Make the files that CASES name, in a new `folder`, which becomes the working folder."""
    folder.mkdir()
    os.chdir(folder)
    shutil.copytree(drawn, folder / "lit")
    shutil.copytree(boards, folder / "boards")
    shutil.copytree(mirrors, folder / "complex")
    (folder / "some").mkdir()
    for path in sorted(mirrors.iterdir())[:2]:
        shutil.copy(path, folder / "some")
    shutil.copytree(simulated("webcam-cell", frames=3, room="dark"), folder / "webcam")
    for name, scenario, frames in (("points", "arm-points", 40), ("pivot", "pivot", 16), ("cell", "cell", 600)):
        shutil.copytree(simulated(scenario, frames=frames), folder / name)
    make_tables()
    make_plane(folder / "plane")
    make_paths("webcam")
    for words in (
        "kinematics fk --arm irb120 --joints joints.csv -o poses.csv",
        f"calibrate camera boards/left {BOARD} -o camera.yaml",
        f"calibrate mirrors --image complex {BOARD} -o mirrors.yaml",
        "calibrate tooltip --poses pivot/flange.csv -o tip.yaml",
        "convert arm webcam/arm.yaml -o robot.urdf",
        "record --left lit/left --right lit/right --frames 3 -o lit.mcap",
    ):
        done = run(words)
        assert done.exit_code == 0, done.output
    make_zoom()


def make_tables() -> None:
    """Write joints of an arm that moves, sweeps of another, a controller's log, and spots of a waved target."""
    t_s = np.arange(0.0, 4.0, 0.1)
    q = 0.1 + 0.3 * np.sin(np.outer(t_s, [0.7, 1.1, 0.9, 1.7, 1.3, 2.1]) + np.arange(6))
    write_rows("joints.csv", "t_s,q1,q2,q3,q4,q5,q6", np.column_stack([t_s, q]))
    write_sweep()
    write_pairs(Path("pairs.csv"))
    Path("log.txt").write_text("X,Y,Z,A,B,C\n" + "500.0,20.0,300.0,10.0,20.0,170.0\n" * 3)
    Path("picks.csv").write_text("u_px,v_px,edge\n60,40,label\n100,40,label\n3,40,\n")
    Path("limits.yaml").write_text("format: armsight/limits\nversion: 1\nspeed_m_s: 0.2\n")
    lights = np.array([[-0.04, 0.0, 0.0], [0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])  # of the drawn scene, as its rig
    rng = np.random.default_rng(1)
    for side, name in enumerate(("left", "right")):
        t = (np.arange(180) + 0.37 * side) / 30.0
        a = 0.4 * np.sin(3.7 * t) + 0.2
        turned = np.stack([np.cos(a), -np.sin(a), np.sin(a), np.cos(a)], 1).reshape(-1, 2, 2) @ lights[:, :2].T
        x = turned[:, 0] + (0.05 + 0.05 * np.sin(4.1 * t) + 0.03 * np.sin(6.7 * t + 1.0))[:, None] - 0.1 * side
        y = turned[:, 1] + (0.05 * np.sin(3.3 * t + 0.4) + 0.04 * np.sin(7.3 * t + 2.0))[:, None]
        z = (0.6 + 0.04 * np.sin(2.9 * t + 0.7))[:, None]
        uv_px = 400.0 * np.stack([x / z, y / z], 2) + [160.3, 119.6] + rng.normal(0.0, 0.03, (180, 3, 2))
        rows = [
            f"{at!r},{u!r},{v!r},0.03,0.03,{light}"
            for at, seen in zip(t.tolist(), uv_px.tolist(), strict=True)
            for light, (u, v) in zip("ABC", seen, strict=True)
        ]
        Path(f"waved-{name}.csv").write_text("\n".join(["t_s,u_px,v_px,su_px,sv_px,spot", *rows]) + "\n")


PLANE_RIG = """\
format: armsight/rig
version: 1
kind: stereo
cameras:
  left:
    {width: 200, height: 120, fx: 300, fy: 300, cx: 99.5, cy: 59.5, distortion: [0, 0, 0, 0, 0],
     T_rig_camera: {xyz_m: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}}
  right:
    {width: 200, height: 120, fx: 300, fy: 300, cx: 99.5, cy: 59.5, distortion: [0, 0, 0, 0, 0],
     T_rig_camera: {xyz_m: [0.05, 0, 0], quat_xyzw: [0, 0, 0, 1]}}
"""


def make_plane(folder: Path) -> None:
    """Draw a textured plane at 0.5 m that faces a pair: in the right view all is 300 * 0.05 / 0.5 = 30 px left."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text(PLANE_RIG)
    for name, shift_px in (("left", 0), ("right", 30)):
        rng = np.random.default_rng(3)
        waves, phase = rng.normal(0, 0.25, (30, 2)), rng.uniform(0, 2 * np.pi, 30)
        u, v = np.meshgrid(np.arange(200.0) + shift_px, np.arange(120.0))
        grey = 128 + 14 * np.sum(np.cos(u[..., None] * waves[:, 0] + v[..., None] * waves[:, 1] + phase), axis=2)
        noise = np.random.default_rng(shift_px).normal(0, 1, grey.shape)
        cv2.imwrite(str(folder / f"{name}.png"), np.clip(grey + noise, 0, 255).astype(np.uint8))


def write_sweep() -> None:
    """Write sweeps of an arm of two turns and a slide."""
    q, joint = np.tile([0.0, 1.5, 0.7], (30, 1)), np.repeat([1, 2, 3], 10)
    q[np.arange(30), joint - 1] = np.concatenate([np.linspace(*ends, 10) for ends in ((0, 4), (0.5, 1.8), (0.6, 1.1))])
    xyz_m = preset("stanford-rrp").fk(q)[:, :3, 3] + np.random.default_rng(0).normal(0.0, 2e-4, (30, 3))
    write_rows("sweep.csv", "joint,q1,q2,q3,x_m,y_m,z_m", np.column_stack([joint, q, xyz_m]))


def write_pairs(path: Path) -> Path:
    """Write 16 pose pairs of a camera on a hand."""
    rng = np.random.default_rng(0)
    T_flange_camera = RigidTransform.from_components([0.03, 0.01, 0.08], Rotation.from_rotvec([0.1, -0.2, 1.5]))
    T_base_target = RigidTransform.from_components([0.6, 0.1, 0.0], Rotation.from_rotvec([0.0, 3.0, 0.3]))
    xyz_m = rng.uniform([0.3, -0.2, 0.3], [0.7, 0.2, 0.7], (16, 3))
    T_base_flange = RigidTransform.from_components(xyz_m, Rotation.random(16, rng=rng))
    seen = T_flange_camera.inv() * T_base_flange.inv() * T_base_target
    turned = Rotation.from_rotvec(rng.normal(0.0, 2e-4, (16, 3))) * seen.rotation
    moved = seen.translation + rng.normal(0.0, 2e-4, (16, 3))
    head = [f"{who}_{name}" for who in ("base_flange", "camera_target") for name in POSE.split(",")]
    columns = [T_base_flange.translation, T_base_flange.rotation.as_quat(), moved, turned.as_quat()]
    write_rows(str(path), ",".join(head), np.hstack(columns))
    return path


def write_rows(name: str, head: str, rows: np.ndarray) -> None:
    """Write a table."""
    Path(name).write_text("\n".join([head, *(",".join(f"{value:.12g}" for value in row) for row in rows)]) + "\n")


def make_paths(cell: str) -> None:
    """Write a path with a corner that the arm of a cell reaches, and its two halves."""
    q = np.loadtxt(f"{cell}/joints.csv", delimiter=",", skiprows=1)[0, 1:]
    T = np.repeat(read_arm(Path(f"{cell}/arm.yaml")).fk(q)[None], 41, axis=0)
    step = 0.002 * np.arange(41)
    T[:, 1, 3] += np.minimum(step, 0.04)
    T[:, 2, 3] += np.maximum(step - 0.04, 0.0)
    for name, part in (("path", T), ("first", T[:21]), ("second", T[20:])):
        write_path(Path(f"{name}.csv"), TaughtPath.of_poses(RigidTransform.from_matrix(part), speed_m_s=0.02))


def make_zoom() -> None:
    """Calibrate a rig, and its left camera at a setting of its lens."""
    Path("zoom").mkdir()
    for words in (
        f"calibrate stereo {PAIRS} -o zoom/rig.yaml",
        f"calibrate camera boards/left {BOARD} --zoom 35 -o zoom/left.yaml",
    ):
        done = run(words)
        assert done.exit_code == 0, done.output
    shutil.copy("zoom/rig.yaml", "zoom/again.yaml")


def lend(given: Path, folder: Path) -> None:
    """Put the given files into a folder of a test's own: real files, for one that is written over must be seen."""
    shutil.copytree(given, folder, copy_function=os.link, dirs_exist_ok=True)
