"""Writes the files of this folder as other programs' documentation says they write theirs; armsight is not imported.

python tests/golden/data/tables/make.py
"""

import json
from pathlib import Path

import numpy as np
from scipy.io import savemat
from scipy.spatial.transform import RigidTransform, Rotation

HERE = Path(__file__).parent
N = 12


def turn(axis, angle):
    """One rotation about x, y or z, written out."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def write(name, *lines):
    path = HERE / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def numbers(values, by=" ", form=".12g"):
    return by.join(format(float(value), form) for value in values)


def main():
    rng = np.random.default_rng(18)
    X = RigidTransform.from_components([0.03, -0.05, 0.11], Rotation.from_rotvec([0.1, -0.2, 1.5]))  # flange_camera
    Y = RigidTransform.from_components([0.6, 0.1, 0.02], Rotation.from_rotvec([0.02, 3.1, 0.1]))  # base_target
    flange = RigidTransform.from_components(
        rng.uniform([0.4, -0.2, 0.4], [0.7, 0.2, 0.7], (N, 3)), Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (N, 3)))
    )
    target = (flange * X).inv() * Y  # camera_target
    q = rng.uniform(-1.5, 1.5, (N, 6))
    t = 1403636579.763555527 + 0.05 * np.arange(N)
    M, C = flange.as_matrix(), target.as_matrix()
    truth = {
        "T_base_flange": M.tolist(),
        "T_camera_target": C.tolist(),
        "T_flange_camera": X.as_matrix().tolist(),
        "q": q.tolist(),
        "t_s": t.tolist(),
    }
    write("truth.json", json.dumps(truth))

    trajectories(t, flange, q)
    samples(M, C, flange, target)
    lists(rng, t, M, q)


def trajectories(t, flange, q):
    """Files 1 to 3."""
    xyz, quat = np.asarray(flange.translation), flange.rotation.as_quat(canonical=True)
    # 1. TUM RGB-D benchmark, "file formats": ground truth trajectories
    rows = [f"{t[k]:.4f} {numbers([*xyz[k], *quat[k]])}" for k in range(N)]
    write("tum/groundtruth.txt", "# ground truth trajectory", "# timestamp tx ty tz qx qy qz qw", *rows)
    # 2. EuRoC MAV dataset, state_groundtruth_estimate0/data.csv
    names = ["#timestamp", *(f"p_RS_R_{a} [m]" for a in "xyz"), *(f"q_RS_{a} []" for a in "wxyz")]
    names += [f"v_RS_R_{a} [m s^-1]" for a in "xyz"]
    rows = [f"{round(t[k] * 1e9)},{numbers([*xyz[k], *np.roll(quat[k], 1), 0.1, 0.2, 0.3], ',')}" for k in range(N)]
    write("euroc/data.csv", ", ".join(names), *rows)
    # 3. Universal Robots' RTDE client library, record.py: one header line, blanks between
    names = ["timestamp", *(f"{who}_q_{i}" for who in ("target", "actual") for i in range(6))]
    names += [f"actual_TCP_pose_{i}" for i in range(6)] + [f"actual_TCP_speed_{i}" for i in range(6)]
    rotvec = flange.rotation.as_rotvec()
    rows = [numbers([t[k], *(q[k] + 1e-3), *q[k], *xyz[k], *rotvec[k], *np.zeros(6)], form=".15g") for k in range(N)]
    write("rtde/robot_data.csv", " ".join(names), *rows)


def samples(M, C, flange, target):
    """Files 4 to 6, 8 and 9."""
    # 4. MoveIt Calibration, "Save samples": a list of two matrices, row by row
    rows = []
    for k in range(N):
        rows.append(f"- effector_wrt_world:\n    [{numbers(M[k].ravel(), ', ')}]")
        rows.append(f"  object_wrt_sensor:\n    [{numbers(C[k].ravel(), ', ')}]")
    write("moveit/samples.yaml", *rows)
    # 5. easy_handeye2, ~/.ros2/easy_handeye2/samples: message_to_yaml of its SampleList
    rows = ["samples:"]
    for k in range(N):
        for lead, name, pose in (("- ", "robot", flange[k]), ("  ", "tracking", target[k])):
            p, r = pose.translation, pose.rotation.as_quat()
            rows.append(f"{lead}{name}:")
            rows.append("    translation:")
            rows += [f"      {a}: {v:.12g}" for a, v in zip("xyz", p, strict=True)]
            rows.append("    rotation:")
            rows += [f"      {a}: {v:.12g}" for a, v in zip("xyzw", r, strict=True)]
    write("easy_handeye2/cell.samples", *rows)
    # 6. Tabb and Ahmad Yousef, robot-world hand-eye data: robot_cali.txt, the count, then matrices in mm
    rows = [str(N)]
    for k in range(N):
        mm = M[k].copy()
        mm[:3, 3] *= 1e3
        rows += [*(numbers(row) for row in mm), ""]
    write("robot_cali/robot_cali.txt", *rows)
    # 8. RGB-D dataset 7-Scenes: one text file with a 4 x 4 for each frame
    for k in range(N):
        write(f"seven_scenes/frame-{k:06d}.pose.txt", *(numbers(row, "\t ") for row in M[k]))
    # 9. MATLAB: rigid transformations stacked along the third dimension
    savemat(HERE / "poses.mat", {"T_base_flange": np.moveaxis(M, 0, 2), "T_camera_target": np.moveaxis(C, 0, 2)})


def lists(rng, t, M, q):
    """Files 7, 10 and 11."""
    xyz = M[:, :3, 3]
    # 7. ROS 1, rostopic echo -p /joint_states > file: names in cells, alphabetical as ros_control publishes them
    joints = ["elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3"]
    order = [2, 1, 0, 3, 4, 5]  # of q1 .. q6 in the message
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += [f"field.name{i}" for i in range(6)] + [f"field.position{i}" for i in range(6)]
    names += [f"field.velocity{i}" for i in range(6)]
    rows = []
    for k in range(N):
        stamp = round(t[k] * 1e9)
        cells = [str(stamp + 700000), str(k), str(stamp), "", *(f"{joint}_joint" for joint in joints)]
        rows.append(",".join([*cells, *(f"{q[k, i]:.12g}" for i in order), *["0.0"] * 6]))
    write("rostopic/joint_states.csv", ",".join(names), *rows)
    # 10. KUKA, position list: X, Y, Z in mm, A, B, C in degrees; R = Rz(A) Ry(B) Rx(C) of angles chosen here
    angles = rng.uniform([-170, -80, -170], [170, 80, 170], (N, 3))
    rows = [numbers([*(1e3 * xyz[k]), *angles[k]], ";") for k in range(N)]
    write("kuka/points.csv", "X;Y;Z;A;B;C", *(row.replace(".", ",") for row in rows))
    R = [turn("z", a) @ turn("y", b) @ turn("x", c) for a, b, c in np.radians(angles)]
    write("kuka/truth.json", json.dumps(np.array(R).tolist()))
    # 11. calibration of an arm by a laser tracker, as supplements of papers give it: degrees, mm, no header
    rows = [numbers([*np.degrees(q[k]), *(1e3 * xyz[k])], "\t") for k in range(N)]
    write("tracker/data.txt", *rows)


if __name__ == "__main__":
    main()
