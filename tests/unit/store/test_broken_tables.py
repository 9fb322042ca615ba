"""Every reader of a table against files as they come broken: read, or refused with cause, consequence and cure."""

import numpy as np
import pytest

from armsight.errors import BadFile, DataRefused
from armsight.store.arm_points import read_arm_points, read_sweep_joints, read_sweeps
from armsight.store.handeye_file import read_pairs, read_robot_poses
from armsight.store.interpret.raw import parse_text
from armsight.store.path_file import read_path
from armsight.store.spots_csv import read_spot_track
from armsight.store.tables import parse_table
from armsight.store.tracks import read_joints, read_poses, read_times
from armsight.store.verify_files import read_commanded, read_measured, read_reported_joints
from refusals import refuses

POSE = "x_m,y_m,z_m,qx,qy,qz,qw"
Q = "q1,q2,q3"
PAIR = ",".join(f"{who}_{cell}" for who in ("base_flange", "camera_target") for cell in POSE.split(","))
READERS = {
    "measured": (read_measured, f"t_s,{POSE}"),
    "commanded": (read_commanded, f"t_s,{POSE}"),
    "reported": (read_reported_joints, f"t_s,{Q}"),
    "joints": (read_joints, f"t_s,{Q}"),
    "poses": (read_poses, f"t_s,{POSE}"),
    "times": (read_times, "t_s"),
    "points": (read_arm_points, f"{Q},{POSE}"),
    "pairs": (read_pairs, PAIR),
    "robot poses": (read_robot_poses, f"file,{POSE}"),
    "sweeps": (read_sweeps, f"joint,{Q},x_m,y_m,z_m"),
    "sweep joints": (read_sweep_joints, f"frame,joint,{Q}"),
    "spots": (read_spot_track, "t_s,u_px,v_px"),
    "path": (read_path, f"index,t_s,{POSE},speed_m_s,tag"),
}
SIZES = {"joint": lambda k: "1", "frame": str, "index": str, "file": lambda k: f"{k}.png", "tag": lambda k: ""}


def table(header, n=6):
    """Rows in which all moves, with a rotation of length one."""
    rng, rows = np.random.default_rng(4), []
    for k in range(n):
        quat = rng.normal(size=4)
        cells = dict(zip(("qx", "qy", "qz", "qw"), quat / np.linalg.norm(quat), strict=True)) | {
            "t_s": 0.1 * k,
            "speed_m_s": 0.1,
        }
        names = header.split(",")
        rows.append(
            ",".join(
                SIZES[n](k)
                if n in SIZES
                else f"{cells.get(n[n.find('q') :] if '_q' in n else n, rng.uniform(0.1, 0.9)):.9f}"
                for n in names
            )
        )
    return "\n".join([header, *rows]) + "\n"


def answer(reader, path):
    """What a reader says of a file: None where it refuses, whole."""
    before = sorted(path.parent.iterdir())
    try:
        return reader(path)
    except DataRefused as error:
        assert error.cause and error.consequence and error.cure, error
    finally:
        assert sorted(path.parent.iterdir()) == before
    return None


@pytest.fixture(params=READERS)
def case(request, tmp_path):
    reader, header = READERS[request.param]
    return reader, header, tmp_path / "table.csv"


def test_a_good_table_is_read_with_a_mark_and_other_line_ends_too(case):
    reader, header, path = case
    for data in (
        table(header),
        "\ufeff" + table(header),
        table(header).replace("\n", "\r\n"),
        table(header).rstrip("\n"),
    ):
        path.write_text(data, newline="")
        assert answer(reader, path) is not None


def test_nothing_in_a_file_is_refused(case):
    reader, header, path = case
    for data in ("", "\n\n", "\ufeff", header, f"{header}\n", f"{header}\n\n", f"\ufeff{header}\n"):
        path.write_text(data)
        assert answer(reader, path) is None, data


def test_a_column_that_stands_twice_is_refused(case):
    reader, header, path = case
    first, *rows = table(header).splitlines()
    name = first.split(",")[-1]
    path.write_text("\n".join([f"{first},{name}", *(f"{row},{row.split(',')[-1]}" for row in rows)]) + "\n")
    assert answer(reader, path) is None


def test_one_row_and_lines_cut_anywhere_are_read_or_refused(case):
    reader, header, path = case
    whole = table(header)
    path.write_text(table(header, n=1))
    answer(reader, path)
    for at in range(1, len(whole), 29):  # the end is lost
        path.write_text(whole[:at])
        answer(reader, path)
    for at in range(len(header) + 2, len(whole), 67):  # some bytes in the middle are
        path.write_text(whole[:at] + whole[at + 9 :])
        answer(reader, path)


@pytest.mark.parametrize(
    "read", [lambda data: parse_table(data, "a.csv", ("a",)), lambda data: parse_text(data, "a.csv")]
)
def test_ten_million_rows_are_refused_before_they_fill_the_memory(read):
    with refuses(BadFile, "10,000,001 lines", "a.csv") as caught:
        read(b"a\n" + b"1\n" * 10_000_000)
    assert caught.value.consequence and caught.value.cure
