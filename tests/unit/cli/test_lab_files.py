"""Trackers' files through each command that takes what was measured, and robots' programs beside them, against a
laboratory that is known: tests/tracker_lab.py, which shares no code with what is tested."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight as product
import tracker_lab as lab
from armsight.store.handeye_file import read_handeye
from program_writers import PULSES, fanuc, jbi, rapid, rows_of
from tracker_writers import OF_BODIES, OF_MARKERS, written

BODY = ["--body", "Flange"]
NO_JOINTS = "A tracker knows no joints"


def rows(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def arm_file(path, place):
    """The true arm, its tool's point there in the body's axes."""
    tool = RigidTransform.from_matrix(lab.FLANGE_BODY) * RigidTransform.from_translation(place)
    arm = product.presets.ur10().moved({"j2.theta_rad": lab.ZERO[1]})
    assert np.abs(arm.fk(lab.rests()[0]) - lab.flange(lab.rests()[0])).max() < 1e-9
    replace(arm, T_flange_tool=tool).save(path)
    return path


def base_off(world):
    """How far a world.yaml is from T_tracker_base, m or share of a rotation."""
    return np.abs(product.read_world(world).T_parent_rig.as_matrix() @ lab.TRACKER_BASE - np.eye(4)).max()


READ = ("qtm-6d", "qtm-3d", "trc", "vicon-trajectories")
"""Kinds whose files go through commands below, and are read in tests/unit/store/test_marker_bodies.py."""


@pytest.mark.parametrize("kind", [kind for kind in (*OF_BODIES, *OF_MARKERS) if kind not in READ])
def test_a_trackers_file_goes_through_every_command(armsight, tmp_path, kind):
    log, stream, take = tmp_path / "log.csv", tmp_path / "robot.csv", written(tmp_path, "run", kind, lab.moving())
    log.write_text(lab.log())
    stream.write_text(lab.robot_poses())
    place = np.zeros(3) if kind in OF_BODIES else lab.MIDDLE
    true = arm_file(tmp_path / "true.yaml", place)
    seen = ["--measured", take, *BODY, "--joints", log]

    done = armsight("verify", *seen, "--arm", "ur10", "-o", tmp_path / "v").json
    assert done["n"] == lab.N - len(lab.LOST) and "joint 2" in done["verdict"].lower()
    assert done["cause"] in ("joint 2", "undecided") and done["verdict_"]["level"] != "good"
    assert abs(done["time"]["offset_s"] - lab.LATE_S) < 2e-3
    assert abs(np.rad2deg(done["joints"][1]["offset_rad"]) - 0.3) < 0.05

    offset: list[object] = []  # found once
    for name in ("points", "observed", "pairs"):
        words = ["--as", name, "--setup", "eye-to-hand", *offset, "-o", tmp_path / f"{name}.csv"]
        joined = armsight("join", *seen, "--arm", true, *words).json
        assert joined["n"] == lab.N - len(lab.LOST) and abs(joined["offset_s"] - lab.LATE_S) < 2e-4
        offset = ["--offset", joined["offset_s"]]
    points = rows(tmp_path / "points.csv")
    q = lab.motion(points["t_s"] - lab.LATE_S)
    T = lab.TRACKER_BASE @ lab.flange(q) @ lab.FLANGE_BODY
    xyz = np.stack([points[name] for name in ("x_m", "y_m", "z_m")], axis=1)
    assert np.abs(np.stack([points[f"q{k + 1}"] for k in range(6)], axis=1) - q).max() < 1e-4
    assert np.abs(xyz - T[:, :3, :3] @ place - T[:, :3, 3]).max() < 1e-3

    world, hand, streams, tip = (tmp_path / f"{name}.yaml" for name in ("world", "hand", "streams", "tip"))
    observed = ["--arm", true, "--points", tmp_path / "observed.csv"]
    assert armsight("calibrate", "robot-world", *observed, "-o", world).code == 0
    assert base_off(world) < 5e-4
    at = ["--setup", "eye-to-hand", "-o"]
    assert armsight("calibrate", "handeye", "--pairs", tmp_path / "pairs.csv", *at, hand).code == 0
    of = ["--robot-stream", stream, "--robot-format", "kuka", "--camera-stream", take, *BODY]
    assert armsight("calibrate", "handeye", *of, *at, streams).code == 0
    for path in (hand, streams):
        found = read_handeye(path).T_parent_camera.as_matrix()
        assert np.abs(found @ lab.TRACKER_BASE - np.eye(4)).max() < 1e-3

    pivot = written(tmp_path, "pivot", kind, lab.pivoting())
    found = armsight("calibrate", "tooltip", "--poses", pivot, *BODY, "-o", tip).json["tip_m"]
    wanted = np.linalg.norm(lab.TIP - place)  # a body of markers has axes of its own
    assert abs(np.linalg.norm(found) - wanted) < 1e-4

    for words in (("arm", "--model", "ur10"), ("robot-world", "--arm", true)):
        refused = armsight("calibrate", *words, "--points", take, *BODY, "-o", tmp_path / "x.yaml")
        assert refused.code == 3 and NO_JOINTS in refused.text
    refused = armsight("calibrate", "handeye", "--pairs", take, *BODY, "-o", tmp_path / "x.yaml")
    assert refused.code == 3 and "--camera-stream" in refused.text


def test_a_stream_that_is_too_short_names_no_joint_and_says_what_motion_would():
    """Four seconds over little of the arm's range: a tenth of a millimetre beside the tracker's half of that."""
    t = 30.0 + np.arange(100) / lab.RATE
    middle = np.array([0.2, -1.1, 1.2, -0.4, 1.0, 0.3])
    q = middle + 0.4 * (lab.motion(t) - middle)
    R, xyz = lab.take_of(lab.TRACKER_BASE @ lab.flange(q) @ lab.FLANGE_BODY, seed=3).bodies["Flange"]
    T = np.array([lab.pose(p, r) for p, r in zip(xyz, R, strict=True)])
    found = product.verify((t, T), arm="ur10", joints=(t, q))
    assert found.cause == "undecided" and "joint 2" in found.verdict.lower() and len(found.decide_by) > 3
    assert found.verdict_.level == "care"


@pytest.mark.parametrize("kind", ["qtm-6d", "c3d"])
def test_visits_of_poses_in_a_take_give_the_figures_of_iso_9283(armsight, tmp_path, kind):
    take, there = lab.visited()
    (tmp_path / "log.csv").write_text(lab.log(seconds=take.n / lab.RATE, of=lab.visiting))
    place = np.zeros(3) if kind in OF_BODIES else lab.MIDDLE
    true, visits = arm_file(tmp_path / "true.yaml", place), tmp_path / "visits.csv"
    seen = ["--measured", written(tmp_path, "run", kind, take), *BODY, "--joints", tmp_path / "log.csv"]
    assert armsight("join", *seen, "--arm", true, "--as", "visits", "-o", visits).json["n"] == 3 * lab.CYCLES
    figures = armsight("verify", "--measured", visits, "--arm", true, "-o", tmp_path / "iso").json["iso9283"]
    xyz = there[:, :3, :3] @ place + there[:, :3, 3]
    for k in range(3):
        apart = np.linalg.norm(xyz[k::3] - xyz[k::3].mean(axis=0), axis=1)
        found = figures[f"RP_m rest{k + 1}"]
        assert found["n"] == lab.CYCLES
        assert abs(found["value"] - apart.mean() - 3.0 * apart.std(ddof=1)) < 4e-5  # of the tracker's own scatter


PROGRAMS = {"fanuc": fanuc, "jbi": jbi, "rapid": rapid}
"""With joints that count together, in pulses, as quaternions; the others: tests/unit/store/test_programs.py."""


def programs(folder, kind):
    """Return a maker's program of joint values and one of the flange's poses, and what has to be said of them."""
    q, _ = lab.rests()
    T = lab.flange(q)
    R, mm, deg = Rotation.from_matrix(T[:, :3, :3]), 1e3 * T[:, :3, 3], np.rad2deg(q).tolist()
    files = folder / "joints.prg", folder / "poses.prg"
    if kind == "rapid":
        texts = rapid([], R[:0], deg), rapid(mm, R)
    else:
        pulses = {"pulses": PULSES} if kind == "jbi" else {}
        texts = PROGRAMS[kind]([], deg, **pulses), PROGRAMS[kind](rows_of(kind, mm, R))
    for path, text in zip(files, texts, strict=True):
        path.write_text(text)
    return *files, ["--pulses-per-degree", ",".join(map(str, PULSES))] if kind == "jbi" else []


@pytest.mark.parametrize("kind", PROGRAMS)
def test_a_robots_program_is_the_commanded_side(armsight, tmp_path, kind):
    q, marker = lab.rests()
    joints, poses, said = programs(tmp_path, kind)
    points = written(tmp_path, "points", "spatialanalyzer", marker)
    body = written(tmp_path, "body", "qtm-6d", lab.take_of(lab.TRACKER_BASE @ lab.flange(q) @ lab.FLANGE_BODY, rate=1))
    of_joints = ["--measured", points, *BODY, "--joints", joints, *said]
    done = armsight("verify", *of_joints, "--arm", "ur10", "-o", tmp_path / "v").json
    assert done["cause"] == "joint 2" and abs(np.rad2deg(done["joints"][1]["offset_rad"]) - 0.3) < 0.01
    commanded = armsight("verify", "--measured", body, *BODY, "--commanded", poses, "-o", tmp_path / "c").json
    assert commanded["n"] == len(q) and commanded["after"]["rms_m"] < 1.5e-4
    observed, world = tmp_path / "observed.csv", tmp_path / "world.yaml"
    true = arm_file(tmp_path / "true.yaml", np.array(lab.SHAPE["Flange:A"]))
    assert armsight("join", *of_joints, "--arm", true, "--as", "observed", "-o", observed).code == 0
    assert armsight("calibrate", "robot-world", "--arm", true, "--points", observed, "-o", world).code == 0
    assert base_off(world) < 5e-4
    robot = ["--robot-stream", poses, "--setup", "eye-to-hand"]
    pairs = ["join", "--measured", body, *BODY, *robot, "--as", "pairs", "-o", tmp_path / "pairs.csv"]
    assert armsight(*pairs).json["by"] == "order"
    refused = armsight("calibrate", "handeye", *robot, "--camera-stream", body, *BODY, "-o", tmp_path / "x.yaml")
    assert refused.code == 3 and "--robot-stream PROGRAM" in refused.text


def test_an_arm_is_calibrated_by_a_program_and_a_take_of_its_rests(armsight, tmp_path):
    """A take in which the arm rests at each of a program's points, and no log of the robot's at all."""
    q, _ = lab.rests()
    joints, _, _ = programs(tmp_path, "fanuc")
    take = written(tmp_path, "run", "motive", lab.rested(q))
    seen = ["--measured", take, *BODY, "--joints", joints, "--arm", "ur10"]
    refused = armsight("verify", *seen, "-o", tmp_path / "v")
    assert refused.code == 3 and "join --still" in refused.text
    points, out = tmp_path / "points.csv", tmp_path / "arm.yaml"
    assert armsight("join", *seen, "--still", "-o", points).json["n"] == len(q)  # the cure
    assert armsight("calibrate", "arm", "--model", "ur10", "--points", points, "-o", out).json["gain"]
    fresh = np.random.default_rng(8).uniform(-1.2, 1.2, (20, 6))
    T = lab.TRACKER_BASE @ lab.flange(fresh) @ lab.FLANGE_BODY
    assert np.abs(product.read_arm(out).fk(fresh)[:, :3, 3] - T[:, :3, 3]).max() < 4e-4
    short = written(tmp_path, "short", "motive", lab.rested(q[:-1]))
    refused = armsight("join", "--measured", short, *seen[2:], "--still", "-o", tmp_path / "x.csv")
    assert refused.code == 3 and "39" in refused.text and "40" in refused.text
