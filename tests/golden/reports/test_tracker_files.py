"""Trackers' and controllers' tables as their programs write them: whose order, unit, time and body is meant."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import Ambiguous, BadFile, Inconsistent, UsageError
from armsight.ops.tables import convert_table
from armsight.store.interpret import TableFormat
from armsight.store.tracks import read_joints, read_poses
from armsight.store.verify_files import read_measured
from refusals import refuses
from reports import case

LOST = [30, 31, 32, 77, 78, 101]


def measured(file, **stated):
    return read_measured(case("trackers") / file, TableFormat(**stated)).measured


def poses(file):
    found = measured(file)
    return found.xyz_m, found.rotation


@pytest.mark.parametrize(
    "file", ["qtm_6D.tsv", "qtm_cut.tsv", "qtm_cut_nolost.tsv", "qtm_euler.tsv", "qtm_othername.tsv", "q2.tsv"]
)
def test_qtm_is_read_as_qtm_means_it(file):
    xyz, R = poses(file)
    true_xyz, true_R = poses("poses_full.csv")
    kept = np.delete(np.arange(120), LOST)
    assert len(xyz) == len(kept)
    np.testing.assert_allclose(xyz, true_xyz[kept], atol=1e-6)
    np.testing.assert_allclose(R, true_R[kept], atol=2e-5)


def test_a_time_in_words_is_a_time_and_units_in_words_are_units():
    t, full = measured("tw_full.csv"), measured("poses_full.csv")
    np.testing.assert_allclose(t.t_s, full.t_s + 3.0, atol=1e-9)
    words, plain = measured("units_words.csv"), measured("time_words.csv")
    np.testing.assert_allclose(words.xyz_m, plain.xyz_m, atol=2e-6)
    np.testing.assert_allclose(words.t_s, plain.t_s)


def test_decimal_commas_stand_between_tabs_too():
    folder = case("trackers")
    commas = read_poses(folder / "tabs_comma.txt", format_=TableFormat(robot="kuka"), timed=False)
    points = read_poses(folder / "kuka_e6.csv", format_=TableFormat(robot="kuka"), timed=False)
    for a, b in zip(commas, points, strict=True):
        np.testing.assert_allclose(a.T_parent_target, b.T_parent_target, atol=3e-6)


def test_whole_milliseconds_are_none_of_them_seconds(tmp_path):
    notes = []
    folder = case("trackers")
    true_s = read_joints(folder / "joints.csv").t_s
    np.testing.assert_allclose(read_joints(folder / "franka6.csv").t_s, true_s, atol=1e-9)  # libfranka means ms
    path = tmp_path / "log.csv"
    path.write_text((folder / "franka6.csv").read_text().replace("time,success_rate", "time,rate"))
    found = read_joints(path, TableFormat(notify=notes.append))
    np.testing.assert_allclose(found.t_s, true_s, atol=1e-9)
    assert any("taken as ms" in note and "--units s" in note for note in notes)
    assert read_joints(path, TableFormat(units="s")).t_s[-1] == 5950.0  # what the note says works


@pytest.mark.parametrize(
    ("file", "stated"),
    [
        ("motive_m.csv", {"body": "Flange"}),
        ("motive_mm.csv", {"body": "Flange"}),
        ("motive_one.csv", {}),
        ("vicon_nexus.csv", {"euler": "rotvec"}),
        ("vicon_tracker.csv", {"euler": "rotvec"}),
    ],
)
def test_a_body_is_read_as_its_tracker_means_it(file, stated):
    found, full = measured(file, **stated), measured("poses_full.csv")
    kept = np.delete(np.arange(120), LOST)
    np.testing.assert_allclose(found.t_s, full.t_s[kept], atol=1e-6)
    np.testing.assert_allclose(found.xyz_m, full.xyz_m[kept], atol=6e-7)
    np.testing.assert_allclose(found.rotation, full.rotation[kept], atol=1e-5)


def test_markers_become_a_body_by_their_own_geometry():
    found, full = measured("run.trc"), measured("poses_full.csv")
    kept = np.delete(np.arange(120), LOST)
    R, true_R = Rotation.from_matrix(found.rotation), Rotation.from_matrix(full.rotation[kept])
    apart = true_R.inv() * R  # T_flange_body is one and the same
    assert (apart[0].inv() * apart).magnitude().max() < 3e-6  # of markers written to 0.1 um, 40 mm apart
    inside = true_R.inv().apply(found.xyz_m - full.xyz_m[kept])
    np.testing.assert_allclose(inside, np.tile(inside[0], (len(inside), 1)), atol=2e-6)  # the truth has seven digits


@pytest.mark.parametrize("file", ["sa.csv", "sa.txt"])
def test_a_list_of_points_is_in_the_unit_of_its_remark(file):
    np.testing.assert_allclose(measured(file).xyz_m, measured("poses_full.csv").xyz_m[:40], atol=6e-7)


@pytest.mark.parametrize(
    ("file", "stated", "kind", "words"),
    [
        ("motive_m.csv", {}, Ambiguous, ("Flange, BaseRef", "--body")),
        ("motive_m.csv", {"body": "Hand"}, UsageError, ("'Hand'", "Flange, BaseRef")),
        ("run.trc", {"body": "A,X"}, UsageError, ("'X'", "A, B, C")),
        ("motive_one_cut.csv", {}, BadFile, ("header",)),
        ("vicon_cut.csv", {}, BadFile, ("frames a second",)),
        ("vicon_tracker.csv", {}, Ambiguous, ("Helical", "--euler rotvec")),
        ("poses_full.csv", {"body": "Flange"}, UsageError, ("bodies by name",)),
    ],
)
def test_what_a_file_leaves_open_is_asked_for(file, stated, kind, words):
    with refuses(kind, *words):
        measured(file, **stated)


@pytest.mark.parametrize("file", ["two_robot_target.csv", "two_base_target.csv", "two_base_flange.csv"])
def test_of_two_bodies_nobody_chooses_by_a_name(file):
    path = case("trackers") / file
    with refuses(Ambiguous, "--columns"):
        read_measured(path)
    names = "t_s," + ",".join(["-"] * 7) + ",xyz_m,quat_xyzw"  # the cure: - for those that are not used
    found = read_measured(path, TableFormat(columns=names)).measured
    true_xyz, true_R = poses("poses_full.csv")
    np.testing.assert_allclose(found.xyz_m, true_xyz, atol=2e-6)
    np.testing.assert_allclose(found.rotation, true_R, atol=1e-5)


def test_a_table_of_no_kind_says_what_is_missing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("alpha,beta\n1,2\n3,4\n")
    with refuses(UsageError, "alpha", "t_s", "missing"):
        convert_table(path)


def test_a_controllers_target_is_asked_for_where_the_actual_one_stands_beside_it():
    folder = case("trackers")
    found = read_joints(folder / "robot_data.csv").q
    np.testing.assert_allclose(found, read_joints(folder / "joints.csv").q, atol=1e-6)


def test_orders_of_qtm_by_a_rotation_of_our_own(tmp_path):
    angles = np.array([[10.0, -20.0, 30.0], [60.0, 25.0, -140.0], [-5.0, 70.0, 15.0]])
    path = tmp_path / "a.tsv"
    rows = [f"{k}\t{k / 10}\t10\t20\t30\t" + "\t".join(map(str, row)) for k, row in enumerate(angles)]
    path.write_text("\n".join(["Frame\tTime\tWand X\tY\tZ\tRoll\tPitch\tYaw", *rows]) + "\n")
    want = Rotation.from_euler("XYZ", angles, degrees=True)
    for pose, R in zip(read_poses(path), want, strict=True):
        np.testing.assert_allclose(pose.T_parent_target[:3, :3], R.as_matrix(), atol=1e-12)


def test_a_table_of_pandas_with_its_index_and_a_matrix_of_nine_cells(tmp_path):
    """to_csv writes the index under no name; nine cells are rows or columns, and no rotation tells which."""
    path, R = tmp_path / "a.csv", Rotation.from_rotvec([[0.1, 0.2, 0.3 * k] for k in range(4)]).as_matrix()
    rows = [f"{k},{k / 10},{k}.5,2.0,3.0,{','.join(map(str, R[k].ravel()))}" for k in range(4)]
    path.write_text("\n".join([",time,x_m,y_m,z_m," + ",".join(f"r{k}" for k in range(9)), *rows]) + "\n")
    with refuses(BadFile, "r11"):
        read_measured(path)
    cells = ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    path.write_text("\n".join([f",time,x_m,y_m,z_m,{cells}", *rows]) + "\n")  # the cure
    np.testing.assert_allclose(read_measured(path).measured.rotation, R, atol=1e-12)
    quat = [
        f"{k},{k / 10},{k}.5,2.0,3.0,{','.join(map(str, q))}" for k, q in enumerate(Rotation.from_matrix(R).as_quat())
    ]
    path.write_text("\n".join([",time,pos_x,pos_y,pos_z,rot_x,rot_y,rot_z,rot_w", *quat]) + "\n")  # no angles: rot_w
    np.testing.assert_allclose(read_measured(path).measured.rotation, R, atol=1e-12)


@pytest.mark.parametrize("matrices", [True, False])
def test_angles_of_qtm_turn_in_the_order_of_their_columns_which_older_files_name_once_for_all_bodies(
    tmp_path, matrices
):
    turned = Rotation.from_euler("ZYX", [[-55.6, 78.1, -156.9], [5.5, -12.4, -35.1]], degrees=True)
    path = tmp_path / "stand_6D.tsv"
    cells = [
        [f"{900 + 7 * k}.5", "-143.25", "61.5", *(f"{a:.5f}" for a in R.as_euler("ZYX", degrees=True)), "0.2"]
        + [f"{x:.5f}" for x in R.as_matrix().T.ravel()] * matrices
        for k, R in enumerate(turned)
    ]
    head = ["X", "Y", "Z", "Yaw", "Pitch", "Roll", "Residual", *[f"Rot[{i}]" for i in range(9)] * matrices]
    rows = ["\t".join([*one, "", *cells[1], ""]) for one in cells]
    keys = ["NO_OF_FRAMES\t2", "FREQUENCY\t256", "DATA_INCLUDED\t6D", "BODY_NAMES\tFoot IMU\tShin"]
    text = "\n".join([*keys, "\t".join(f" {cell}" for cell in head), *rows, ""])
    path.write_text(text)
    found = read_measured(path, TableFormat(body="Foot IMU")).measured
    assert np.abs(found.rotation - turned.as_matrix()).max() < 2e-5
    np.testing.assert_allclose(found.xyz_m, [[0.9005, -0.14325, 0.0615], [0.9075, -0.14325, 0.0615]])
    np.testing.assert_allclose(found.t_s, [0.0, 1.0 / 256.0])
    path.write_text(text.replace("\t\t", "\t7\t"))
    with refuses(BadFile, "stand_6D.tsv", "name"):
        read_measured(path, TableFormat(body="Shin"))
    path.write_text(text.replace(" Yaw\t Pitch\t Roll", " Roll\t Pitch\t Yaw"))
    if matrices:
        with refuses(Inconsistent, "Foot IMU", "matrix"):
            read_measured(path, TableFormat(body="Shin"))
