"""A rig by way of the programs whose files these are, where they are installed (no dependency): we write, the program
reads and writes, we read.

aniposelib 0.8.0, caliscope 0.11.8, pycolmap 4.2.1 and multical 0.4.0 with OpenCV 4.14 hold 1e-9 in all numbers and
pixels; depthai 3.12.0 has single precision. OpenCV 4.14 and 5.0 are the same to 1e-15 (test_foreign_files).
"""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import foreign_cameras as f
from armsight.ops.conversion import load_rig
from armsight.store.foreign import FORMATS, Asked

T = np.vstack([np.column_stack([f.RIGHT.R, f.RIGHT.t]), [0.0, 0.0, 0.0, 1.0]])
"""Right's axes from left's, which are the world's."""


def pixels(R, t, K, D):
    return cv2.projectPoints(f.POINTS, cv2.Rodrigues(np.asarray(R))[0], np.ravel(t), np.asarray(K), np.ravel(D))[0]


def joined(R, t):
    return np.vstack([np.column_stack([R, np.ravel(t)]), [0.0, 0.0, 0.0, 1.0]])


def by_aniposelib(ours, theirs):
    group = pytest.importorskip("aniposelib.cameras").CameraGroup.load(str(ours[0]))
    group.dump(str(theirs[0]))
    one, two = (camera.get_extrinsics_mat() for camera in group.cameras)
    return two @ np.linalg.inv(one), group.project(f.POINTS)


def by_caliscope(ours, theirs):
    rig = pytest.importorskip("caliscope.cameras.camera_array").CameraArray.from_toml(ours[0])
    rig.to_toml(theirs[0])
    cameras = [rig.cameras[k] for k in sorted(rig.cameras)]
    one, two = (joined(camera.rotation, camera.translation) for camera in cameras)
    return two @ np.linalg.inv(one), [pixels(x.rotation, x.translation, x.matrix, x.distortions) for x in cameras]


def by_multical(ours, theirs):
    reader = pytest.importorskip("multical.io.import_calib")
    writer = pytest.importorskip("multical.io.export_calib")
    structs = pytest.importorskip("structs.struct")
    data = structs.to_structs(json.loads(ours[0].read_text()))
    names = list(data.cameras)
    cameras = [reader.import_camera(data.cameras[name]) for name in names]
    graph = reader.import_pose_graph(data.camera_poses, names)
    poses = np.array([graph[name] for name in names])
    table = SimpleNamespace(poses=poses, valid=np.ones(len(names), bool))
    content = structs.struct(
        cameras=writer.export_cameras(names, cameras), camera_poses=writer.export_relative(names, table, names[0])
    )
    theirs[0].write_text(json.dumps(structs.to_dicts(content)))
    seen = [pixels(p[:3, :3], p[:3, 3], c.intrinsic, c.dist) for p, c in zip(poses, cameras, strict=True)]
    return poses[1] @ np.linalg.inv(poses[0]), seen


def by_pycolmap(ours, theirs):
    reconstruction = pytest.importorskip("pycolmap").Reconstruction()
    for name in ("images", "points3D", "frames"):
        (ours[0].parent / f"{name}.txt").write_text("")
    reconstruction.read_text(ours[0].parent)
    reconstruction.write_text(theirs[0].parent)
    left, right = (reconstruction.cameras[k] for k in sorted(reconstruction.cameras))
    (rig,) = reconstruction.rigs.values()
    (pose,) = rig.non_ref_sensors.values()
    step = np.vstack([pose.matrix(), [0.0, 0.0, 0.0, 1.0]])
    seen = [[left.img_from_cam(x) for x in f.POINTS], [right.img_from_cam(pose * x) for x in f.POINTS]]
    return step, np.array(seen) - 0.5  # its pixels begin at their corner


PROGRAMS = {
    "aniposelib": (by_aniposelib, ("calibration.toml",)),
    "caliscope": (by_caliscope, ("camera_array.toml",)),
    "multical": (by_multical, ("calibration.json",)),
    "colmap": (by_pycolmap, ("cameras.txt", "rigs.txt")),
}


def check(step, seen, tolerance=1e-9):
    assert np.abs(step - T).max() < tolerance
    for got, view in zip(seen, (f.LEFT, f.RIGHT), strict=True):
        assert np.abs(np.reshape(got, (-1, 2)) - view.sees(f.POINTS)).max() < 1e3 * tolerance


@pytest.mark.parametrize("kind", PROGRAMS)
def test_a_rig_goes_through_the_program_whose_kind_it_is(tmp_path, kind):
    by, names = PROGRAMS[kind]
    asked = Asked(unit_m=1.0)
    f.aniposelib(tmp_path / "made.toml", (f.LEFT, f.RIGHT))
    rig = load_rig([tmp_path / "made.toml"], asked)
    ours, theirs = ([tmp_path / side / name for name in names] for side in ("ours", "theirs"))
    for files in (ours, theirs):
        files[0].parent.mkdir()
    FORMATS[kind].write_rig(ours, rig)
    check(*by(ours, theirs))
    back = load_rig(theirs, asked)
    check(np.linalg.inv(back.T_rig_right.as_matrix()) @ back.T_rig_left.as_matrix(), back.project(f.POINTS))


def test_a_depthai_boards_file_is_read_as_its_program_reads_it(tmp_path):
    depthai = pytest.importorskip("depthai")
    path = f.depthai(tmp_path / "made.json")
    content = json.loads(path.read_text())
    for _, camera in content["cameraData"]:
        camera |= {"specHfovDeg": 70.0, "lensPosition": 0}
    del content["cameraData"][3]  # a socket without a camera, as a board has it
    path.write_text(json.dumps(content))
    board, sockets = depthai.CalibrationHandler(str(path)), depthai.CameraBoardSocket
    step = np.array(board.getCameraExtrinsics(sockets.CAM_B, sockets.CAM_C))
    step[:3, 3] *= 0.01
    board.eepromToJsonFile(tmp_path / "theirs.json")
    back = load_rig([tmp_path / "theirs.json"], Asked(names=("CAM_B", "CAM_C")))
    check(step, back.project(f.POINTS), tolerance=1e-7)
