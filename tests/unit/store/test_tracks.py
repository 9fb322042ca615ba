"""The CSV kinds and TUM: full precision, and errors that name line and column."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight import store
from armsight.errors import BadFile, NotEnoughData
from armsight.geometry import is_close
from armsight.records import Motion, Points, PoseStatus, Spots, TargetPose
from armsight.store.covariances import COVARIANCE, POINT_COVARIANCE, POSE_COLUMNS
from armsight.store.interpret import TableFormat
from armsight.store.tables import Table, read_table
from armsight.store.tracks import (
    POINT_COLUMNS,
    SPOT_COLUMNS,
    parse_joints,
    parse_poses,
    parse_times,
    read_joints,
    read_poses,
)
from refusals import refuses


def make_poses(n=20, seed=2):
    rng = np.random.default_rng(seed)
    poses = []
    for i in range(n):
        A = rng.standard_normal((6, 6)) * 1e-4
        pose = RigidTransform.from_components(rng.standard_normal(3), Rotation.random(rng=rng))
        poses.append(
            TargetPose(
                t_s=i / 30,
                status=PoseStatus.OK,
                parent="rig",
                spots=("A", "B", "C"),
                T_parent_target=pose.as_matrix(),
                covariance=A @ A.T,
            )
        )
    position = RigidTransform.from_translation([0.1, 1 / 3, 2.0])
    poses.append(
        TargetPose(
            t_s=n / 30,
            status=PoseStatus.POSITION_ONLY,
            parent="rig",
            spots=("A",),
            T_parent_target=position.as_matrix(),
            covariance=np.diag([1e-8, 2e-8, 3e-8]),
        )
    )
    poses.append(TargetPose(t_s=(n + 1) / 30, status=PoseStatus.LOST, parent="rig", why="no spot"))
    return poses


def assert_same(back, poses):
    for got, want in zip(back, poses, strict=True):
        assert (got.t_s, got.status, got.spots, got.parent) == (want.t_s, want.status, want.spots, "rig")
        if want.pose is not None:
            assert np.array_equal(got.pose.translation, want.pose.translation)
            assert is_close(got.pose, want.pose, tol_m=0.0, tol_rad=1e-14)
            scale = np.sqrt(np.diag(want.covariance))
            assert np.abs((got.covariance - want.covariance) / np.outer(scale, scale)).max() < 1e-12


def test_poses_come_back(tmp_path):
    poses = make_poses()
    store.write_poses(tmp_path / "poses.csv", poses)
    assert_same(store.read_poses(tmp_path / "poses.csv"), poses)
    with store.PosesWriter(tmp_path / "rows.csv") as writer:
        for pose in poses:
            writer.write(pose)
    assert (tmp_path / "rows.csv").read_bytes() == (tmp_path / "poses.csv").read_bytes()
    header, first = (tmp_path / "poses.csv").read_text().splitlines()[:2]
    assert header == "t_s,x_m,y_m,z_m,qx,qy,qz,qw,sx_m,sy_m,sz_m,srx_rad,sry_rad,srz_rad,status,spots," + (
        "sys_sx_m,sys_sy_m,sys_sz_m,sys_srx_rad,sys_sry_rad,sys_srz_rad,"
        "lights_x_m,lights_y_m,lights_z_m,slights_x_m,slights_y_m,slights_z_m,"
        "cov_x_y,cov_x_z,cov_x_rx,cov_x_ry,cov_x_rz,cov_y_z,cov_y_rx,cov_y_ry,cov_y_rz,"
        "cov_z_rx,cov_z_ry,cov_z_rz,cov_rx_ry,cov_rx_rz,cov_ry_rz,"
        "sys_cov_x_y,sys_cov_x_z,sys_cov_x_rx,sys_cov_x_ry,sys_cov_x_rz,sys_cov_y_z,sys_cov_y_rx,sys_cov_y_ry,"
        "sys_cov_y_rz,sys_cov_z_rx,sys_cov_z_ry,sys_cov_z_rz,sys_cov_rx_ry,sys_cov_rx_rz,sys_cov_ry_rz"
    )
    assert ",ok,A B C,,,,,,,,,,,,," in first and first.endswith(15 * ",")


def test_cells_that_mean_nothing_are_empty(tmp_path):
    store.write_poses(tmp_path / "poses.csv", make_poses(1))
    _, _, position, lost = (tmp_path / "poses.csv").read_text().splitlines()
    cells = position.split(",")
    assert cells[1:14] == [""] * 13  # nobody knows where the target's origin is
    assert cells[14:22] == ["position_only", "A", *[""] * 6]
    assert [float(cell) for cell in cells[22:25]] == [0.1, 1 / 3, 2.0]
    np.testing.assert_allclose([float(cell) for cell in cells[25:28]], np.sqrt([1e-8, 2e-8, 3e-8]))
    assert lost.split(",")[1:] == [""] * 13 + ["lost", "", *[""] * 42]


def test_a_position_of_the_origin_stays_in_the_columns_of_the_pose(tmp_path):
    known = replace(make_poses(1)[1], origin_known=True)
    store.write_poses(tmp_path / "poses.csv", [known])
    cells = (tmp_path / "poses.csv").read_text().splitlines()[1].split(",")
    assert [float(cell) for cell in cells[1:4]] == [0.1, 1 / 3, 2.0] and cells[22:28] == [""] * 6
    assert store.read_poses(tmp_path / "poses.csv")[0].origin_known


def test_the_positions_of_earlier_files_are_those_of_the_lights():
    data = b"t_s,x_m,y_m,z_m,qx,qy,qz,qw,status\n0,1,2,3,,,,,position_only\n"
    pose = parse_poses(data, "old.csv")[0]
    assert pose.pose.translation.tolist() == [1.0, 2.0, 3.0] and not pose.origin_known


def correlated(rng, scale):
    """A covariance whose axes go almost together: correlations up to 0.99."""
    A = rng.standard_normal((6, 2)) @ rng.standard_normal((2, 6)) + 0.05 * rng.standard_normal((6, 6))
    return scale[:, None] * (A @ A.T) * scale


def test_strong_correlations_come_back_with_the_part_that_repeats(tmp_path):
    rng, scale = np.random.default_rng(8), np.array([1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 3e-3])
    poses = []
    for pose in make_poses(20)[:20]:
        shared = correlated(rng, 0.3 * scale)
        poses.append(replace(pose, covariance=correlated(rng, scale) + shared, systematic_covariance=shared))
    R = np.linalg.cholesky(poses[0].covariance[:3, :3])
    poses.append(replace(make_poses(0)[0], covariance=R @ R.T))
    poses.append(replace(poses[-1], origin_known=True, systematic_covariance=0.1 * (R @ R.T)))
    store.write_poses(tmp_path / "poses.csv", poses)
    for got, want in zip(store.read_poses(tmp_path / "poses.csv"), poses, strict=True):
        for name in ("covariance", "systematic_covariance"):
            C, back = getattr(want, name), getattr(got, name)
            if C is None:
                assert back is None
                continue
            s = np.sqrt(np.diag(C))
            assert np.abs((back - C) / np.outer(s, s)).max() < 1e-12
    assert max(abs(p.covariance[i, j]) / np.sqrt(p.covariance[i, i] * p.covariance[j, j])
               for p in poses[:20] for i in range(6) for j in range(i)) > 0.9  # fmt: skip


def test_a_doubtful_pose_comes_back_as_one(tmp_path):
    pose = replace(make_poses(1)[0], status=PoseStatus.DOUBTFUL)
    store.write_poses(tmp_path / "poses.csv", [pose])
    assert_same(store.read_poses(tmp_path / "poses.csv"), [pose])
    assert store.write_tum(tmp_path / "poses.tum", [pose]) == 0


@pytest.mark.parametrize(
    ("columns", "cells"),
    [
        ("cov_x_y,cov_x_z", "0,0"),
        (",".join(COVARIANCE), ",".join(["1.1e-6", *["0"] * 14])),
        (",".join(COVARIANCE), ",".join(["9e-7", "9e-7", "0", "0", "0", "-9e-7", *["0"] * 9])),
    ],
    ids=["in part", "beyond one", "not positive"],
)
def test_what_is_no_covariance_is_refused_by_its_line(columns, cells):
    head = "t_s,x_m,y_m,z_m,qx,qy,qz,qw,sx_m,sy_m,sz_m,srx_rad,sry_rad,srz_rad"
    text = f"{head},{columns}\n0,1,2,3,0,0,0,1,1e-3,1e-3,1e-3,1e-3,1e-3,1e-3,{cells}\n"
    with pytest.raises(BadFile, match="line 2"):
        parse_poses(text.encode(), "poses.csv")


def points_in(path) -> Table:
    more = (*POINT_COVARIANCE, "status")
    return read_table(path, POINT_COLUMNS, optional=more, text=("spot", "status"), need_rows=False)


def test_points_and_spots_come_back(tmp_path):
    rng = np.random.default_rng(3)
    C = np.array([[1.0, 0.5, 0.2], [0.5, 1.0, -0.3], [0.2, -0.3, 1.0]]) / 9
    points = Points(names=("A", "B"), xyz_m=rng.standard_normal((2, 3)), covariance_m2=np.stack([C] * 2))
    spots = Spots(
        uv_px=rng.standard_normal((2, 2)),
        covariance_px2=np.stack([np.diag([0.04, 0.09])] * 2),
        peak=np.ones(2),
        size_px=np.ones(2),
        model=("gaussian",) * 2,
    )
    with store.PointsWriter(tmp_path / "points.csv") as writer:
        writer.write(0.1, points)
    with store.SpotsWriter(tmp_path / "spots.csv") as writer:
        writer.write(0.1, "left", ("A", "B"), spots)
        writer.write(0.1, "right", (), Spots.none())
    table = points_in(tmp_path / "points.csv")
    assert table.text["spot"] == ("A", "B")
    assert np.array_equal(table.stacked(("x_m", "y_m", "z_m")), points.xyz_m)
    assert table.numbers["sx_m"][0] == 1 / 3 and table.text["status"] == ("ok", "ok")
    assert np.allclose(table.stacked(("cov_x_y", "cov_x_z", "cov_y_z")), C[(0, 0, 1), (1, 2, 2)], rtol=1e-15)
    store.restate_points(tmp_path / "points.csv", {0.1: PoseStatus.DOUBTFUL})
    assert points_in(tmp_path / "points.csv").text["status"] == ("doubtful", "doubtful")
    table = read_table(tmp_path / "spots.csv", SPOT_COLUMNS, text=("spot", "camera"))
    assert table.text["camera"] == ("left", "left")
    assert np.array_equal(table.stacked(("u_px", "v_px")), spots.uv_px)
    assert (tmp_path / "spots.csv").read_text().startswith("t_s,camera,spot,u_px,v_px,su_px,sv_px\n")


def test_joints_and_times_come_back(tmp_path):
    motion = Motion(t_s=np.arange(5) / 3, q=np.random.default_rng(0).standard_normal((5, 6)))
    store.write_joints(tmp_path / "joints.csv", motion)
    back = store.read_joints(tmp_path / "joints.csv")
    assert np.array_equal(back.t_s, motion.t_s)
    assert np.array_equal(back.q, motion.q)
    assert parse_times(b"frame,t_s\n0,0.5\n1,0.75\n", "times.csv").tolist() == [0.5, 0.75]
    shuffled = parse_joints(b"q2,t_s,q1\n2,0,1\n", "joints.csv")
    assert shuffled.q.tolist() == [[1.0, 2.0]]


def test_times_that_can_be_no_seconds_are_refused():
    for counted in (b"1.7e12\n1.8e12", b"0\n16666666000000", b"-1e298\n0"):
        with refuses(BadFile, "time", "seconds"):
            parse_times(b"t_s\n" + counted + b"\n", "times.csv")
    assert parse_times(b"t_s\n1.7e9\n1.8e9\n", "times.csv").tolist() == [1.7e9, 1.8e9]


def test_tum_comes_back(tmp_path):
    poses = make_poses()
    assert store.write_tum(tmp_path / "track.tum", poses) == 20
    track = store.read_tum(tmp_path / "track.tum")
    assert [pose.t_s for pose in track] == [pose.t_s for pose in poses[:20]]
    for got, want in zip(track, poses[:20], strict=True):
        assert is_close(got.pose, want.pose, tol_m=0.0, tol_rad=1e-14)


POSES = ",".join(POSE_COLUMNS)
REFUSED = {
    "empty": (parse_times, b"", BadFile, "empty"),
    "header only": (parse_times, b"t_s\n", NotEnoughData, "no row"),
    "binary": (parse_times, b"t_s\n\xff\xfe", BadFile, ("byte 4", "UTF-8")),
    "no header": (parse_times, b"0.0\n0.1\n", BadFile, ("first line", "t_s")),
    "missing column": (parse_joints, b"t_s,x\n0,1\n", BadFile, ("q1", "t_s, x")),
    "column twice": (parse_joints, b"t_s,q1,q1\n0,1,2\n", BadFile, ("q1", "twice")),
    "gap in the numbering": (parse_joints, b"t_s,q1,q3\n0,1,2\n", BadFile, ("q1, q3", "counted")),
    "long row": (parse_joints, b"t_s,q1\n0,1,2\n", BadFile, ("line 2", "3 cells")),
    "word": (parse_joints, b"t_s,q1\n0,one\n", BadFile, ("line 2", "q1", "one", "finite")),
    "nan": (parse_joints, b"t_s,q1\n0,1\n\n1,NaN\n", BadFile, ("line 4", "q1", "NaN")),
    "python's own numbers": (parse_joints, b"t_s,q1\n0,1_000\n", BadFile, "'1_000'"),
    "semicolons": (parse_joints, b"t_s;q1\n0,5;1,5\n", BadFile, "semicolons"),
    "time backwards": (parse_times, b"t_s\n0\n1\n0.5\n", BadFile, ("line 4", "t_s", "increase")),
    "status": (parse_poses, POSES.encode() + b"\n" + b"0," * 14 + b"fine,A\n", BadFile, ("status", "fine", "lost")),
    "negative deviation": (
        parse_poses,
        POSES.encode() + b"\n0,0,0,0,0,0,0,1,-1,0,0,0,0,0,ok,\n",
        BadFile,
        ("line 2", "standard deviation", "negative"),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_table_is_refused_with_its_place(case):
    read, data, kind, message = REFUSED[case]
    where = "joints.csv" if read is parse_joints else "file"
    with refuses(kind, message) as caught:
        read(data, where)
    assert caught.value.cause.startswith(where)
    assert caught.value.consequence


STREAMS = {
    "joints": ("t_s,q1,q2", "0.5,1.0", "0.6,1.0", lambda path, format_: read_joints(path, format_).t_s),
    "poses": (
        "t_s,x_m,y_m,z_m,qx,qy,qz,qw",
        "0.5,0.0,1.0,0,0,0,1",
        "0.6,0.0,1.0,0,0,0,1",
        lambda path, format_: [pose.t_s for pose in read_poses(path, format_=format_, stream=True)],
    ),
}


@pytest.mark.parametrize("kind", STREAMS)
def test_rows_that_repeat_the_row_before_are_merged_and_told(tmp_path, kind):
    header, first, second, times = STREAMS[kind]
    path, told = tmp_path / f"{kind}.csv", []
    path.write_text(f"{header}\n0.1,{first}\n0.1,{first}\n\n0.2,{first}\n0.3,{second}\n0.3,{second}\n")
    assert list(times(path, TableFormat(notify=told.append))) == [0.1, 0.2, 0.3]
    assert "2 of 5 rows" in told[0]


@pytest.mark.parametrize("kind", STREAMS)
@pytest.mark.parametrize(("stamps", "said"), [((0.1, 0.2, 0.2), "other values"), ((0.1, 0.2, 0.15), "order of time")])
def test_a_stamp_with_two_values_or_going_back_is_refused_by_its_line(tmp_path, kind, stamps, said):
    header, first, second, times = STREAMS[kind]
    path = tmp_path / f"{kind}.csv"
    path.write_text("\n".join([header, *(f"{t},{row}" for t, row in zip(stamps, (first, first, second), strict=True))]))
    with pytest.raises(BadFile, match="line 4") as caught:
        times(path, TableFormat())
    assert said in str(caught.value) + caught.value.cure
