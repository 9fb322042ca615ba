"""Which rows say that nothing was measured: every fill of trackers and loggers, and what looks like one and is none."""

import numpy as np
import pytest

from armsight.errors import NotEnoughData
from armsight.store.interpret import TableFormat
from armsight.store.lost import AGAIN, lost_rows, without_lost
from armsight.store.tables import parse_table
from armsight.store.tracks import read_joints, read_poses
from armsight.store.verify_files import read_commanded, read_reported_joints
from refusals import refuses

N = 80
T_S = np.arange(N) / 50
WAVES = np.array([0.31, 0.47, 0.73, 0.23, 0.59, 0.37])
JOINTS = 0.6 * np.sin(2 * np.pi * np.outer(T_S, WAVES) + np.arange(6))
XYZ = np.array([0.4, 0.1, 0.3]) + 0.2 * np.sin(2 * np.pi * np.outer(T_S, WAVES[:3]) + [0, 1, 2])
HALF = 0.2 * np.sin(2 * np.pi * np.outer(T_S, WAVES[3:]))
QUAT = np.column_stack([HALF, np.sqrt(1 - (HALF**2).sum(axis=1))])
LOST = [20, 21, 22, 50]


def table(values, names, cells="{:.6f}"):
    rows = [
        [f"{t:.3f}", *(v if isinstance(v, str) else cells.format(v) for v in row)]
        for t, row in zip(T_S, values, strict=True)
    ]
    return "\n".join(",".join(row) for row in [["t_s", *names], *rows]) + "\n"


POSE_NAMES = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
JOINT_NAMES = [f"q{k}" for k in range(1, 7)]


def filled(values, fill):
    """The rows of values (n, k) with those lost filled as a program does."""
    rows = [list(row) for row in values]
    for i in LOST:
        rows[i] = fill(rows, i)
    return rows


POSES = np.hstack([XYZ, QUAT])
FILLS = {
    "empty": lambda rows, i: [""] * 7,
    "zeros": lambda rows, i: ["0"] * 7,
    "identity": lambda rows, i: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    "one cell": lambda rows, i: [*rows[i][:1], "", *rows[i][2:]],
    "-9999": lambda rows, i: ["-9999"] * 7,
    "the last pose": lambda rows, i: rows[i - 1],
}


@pytest.mark.parametrize("name", FILLS)
def test_a_lost_frame_is_lost_and_named(tmp_path, name):
    path, notes = tmp_path / "a.csv", []
    path.write_text(table(filled(POSES, FILLS[name]), POSE_NAMES))
    poses = read_poses(path, format_=TableFormat(notify=notes.append))
    assert [i for i, pose in enumerate(poses) if pose.status != "ok"] == LOST
    assert any("4 of 80 rows are lost" in note and "lines 22-24, 52" in note for note in notes)


JOINT_FILLS = {
    "empty": lambda rows, i: [""] * 6,
    "one cell": lambda rows, i: [*rows[i][:5], "nan"],
    "one joint zero": lambda rows, i: [*rows[i][:1], 0.0, *rows[i][2:]],
    "the last reading": lambda rows, i: rows[i - 1],
}


@pytest.mark.parametrize("name", JOINT_FILLS)
def test_a_lost_reading_of_the_joints_is_lost_too(tmp_path, name):
    path = tmp_path / "joints.csv"
    path.write_text(table(filled(JOINTS, JOINT_FILLS[name]), JOINT_NAMES))
    notes = []
    format_ = TableFormat(notify=notes.append)
    assert np.flatnonzero(np.isnan(read_reported_joints(path, format_).q).any(axis=1)).tolist() == LOST
    assert len(read_joints(path, format_, measured=True).t_s) == N - len(LOST)
    assert len(notes) == 2 and all("lines 22-24, 52" in note for note in notes)


def rests(values, still):
    """A motion that slows down, stands for some rows, and goes on, as a controller reports it."""
    s = np.clip(np.concatenate([np.linspace(-1, 0, N // 2 - still // 2), np.zeros(still), np.linspace(0, 1, N)]), -1, 1)
    return np.outer(np.sign(s) * s**2, np.ones(values.shape[1]))[:N] + values[0]


RIGHT = {
    "a rest to the last digit": (rests(XYZ, 12), ("x_m", "y_m", "z_m")),
    "a rest of the joints": (rests(JOINTS, 12), JOINT_NAMES),
    "joints that pass zero": (np.outer(T_S - T_S[40], np.ones(6)), JOINT_NAMES),
    "joints that begin at zero": (np.outer(T_S**2, np.ones(6)), JOINT_NAMES),
    "joints swept one by one from 0.5": (
        np.where(T_S[:, None] // 0.27 == np.arange(6), T_S[:, None] % 0.27 // 0.02 / 5 - 1, 0.5),
        JOINT_NAMES,
    ),
    "joints at a few values": (np.stack([(np.arange(N) * 7 % (k + 3) - 1) * 0.7 for k in range(6)], 1), JOINT_NAMES),
    "a diagonal": (np.outer(0.5 + T_S, np.ones(3)), ("x_m", "y_m", "z_m")),
    "slow, in tenths of a mm": (np.round(np.outer(T_S, [1e-3, 0.7e-3, 0.3e-3]), 4) + 0.5, ("x_m", "y_m", "z_m")),
    "along an axis": (np.column_stack([XYZ[:, 0], np.zeros(N), np.zeros(N)]), ("x_m", "y_m", "z_m")),
    "turning where it stands": (np.hstack([np.zeros((N, 3)), QUAT]), POSE_NAMES),
}


@pytest.mark.parametrize("name", RIGHT)
def test_what_only_looks_lost_is_kept(name):
    values, names = RIGHT[name]
    read = parse_table(table(values, names).encode(), "a.csv", ("t_s",), optional=names, blank=("q",), series="q")
    assert lost_rows(read) == {}


def test_a_log_polled_faster_than_there_are_values_keeps_the_first_of_each():
    slow = np.repeat(POSES[::2], 2, axis=0)
    read = parse_table(table(slow, POSE_NAMES).encode(), "a.csv", ("t_s", *POSE_NAMES))
    lost = lost_rows(read)
    assert set(lost.values()) == {AGAIN} and len(lost) > 0.7 * N / 2 and all(row % 2 for row in lost)


def test_what_is_asked_for_may_be_zero_or_the_same_again(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(table(filled(POSES, FILLS["identity"]), POSE_NAMES))
    assert np.isfinite(read_commanded(path).reported.T).all()
    assert all(pose.status == "ok" for pose in read_poses(path, measured=False))


def test_a_table_of_lost_rows_alone_says_what_stands_there():
    read = parse_table(b"t_s,x_m,y_m,z_m\n0,,,\n1,nan,,\n", "a.csv", ("t_s",), optional=POSE_NAMES, blank=POSE_NAMES)
    with refuses(NotEnoughData, "a.csv", "2 of 2", "lines 2-3"):
        without_lost(read, lambda text: None)
