"""Frames that a tracker lost, as six programs fill them: no row of them reaches a clock, a fit or a file."""

import numpy as np
import pytest

from armsight.ops.files import join
from armsight.ops.verify import verify
from armsight.store.arm_points import read_arm_points
from armsight.store.handeye_file import read_pairs
from armsight.store.interpret import TableFormat
from armsight.store.tracks import read_poses
from armsight.store.verify_files import read_measured
from refusals import names_it
from reports import case

LINES = "lines 32-34, 79-80, 103"
FILLS = [f"{lead}_{fill}" for lead in ("poses", "foreign") for fill in ("zeros", "nan", "blank", "norot")]


@pytest.mark.parametrize("file", [*FILLS, "poses_ident", "xyz_zero", "xyz_blank"])
def test_six_lost_frames_are_left_out_of_what_is_measured_and_named(file):
    folder = case("trackers")
    found = read_measured(folder / f"{file}.csv")
    whole = read_measured(folder / ("xyz_full.csv" if file.startswith("xyz") else "poses_full.csv"))
    lost = [31, 32, 33, 78, 79, 102]
    rows = np.delete(np.arange(120), np.array(lost) - 1)
    assert found.n == 120 and (found.measured.rows - 1 == rows).all()
    np.testing.assert_allclose(found.measured.xyz_m, whole.measured.xyz_m[rows], atol=1e-9)
    assert [note for note in found.notes if names_it(note, "6 of 120", LINES)]


def told_of(read, *args):
    notes = []
    return read(*args, TableFormat(notify=notes.append)), notes


PAIRS = ("pr_blank", "pr_blankf", "pr_zero", "pr_zerof", "pr_norot")


@pytest.mark.parametrize("file", PAIRS)
def test_a_pair_of_which_one_pose_is_lost_is_none(file):
    pairs, notes = told_of(read_pairs, case("trackers") / f"{file}.csv")
    assert len(pairs.T_base_flange) == 36 and "row 4" not in pairs.names and "row 5" in pairs.names
    assert names_it(notes[-1], "3 of 39", "lines 5, 19, 31")


@pytest.mark.parametrize("file", ["piv_zero3", "piv_zero10", "piv_zero40", "piv_norot10", "st_cam_lost25"])
def test_poses_that_were_lost_come_back_as_lost(file):
    poses = read_poses(case("trackers") / f"{file}.csv", timed=False)
    count = {"piv_norot10": 10, "st_cam_lost25": 103}.get(file) or int(file.removeprefix("piv_zero"))
    assert sum(pose.status == "lost" for pose in poses) == count
    assert all(pose.T_parent_target is None for pose in poses if pose.status == "lost")


def test_rotations_that_most_rows_lack_are_left_out_instead_of_the_rows():
    folder = case("trackers")
    few, notes = told_of(read_arm_points, folder / "pts_few.csv")
    assert few.q.shape == (117, 6) and few.rotation is not None and names_it(notes[-1], "3 of 120", "lines 22, 30, 106")
    for file, missing in (("pts_half", 68), ("pts_all_but5", 117)):
        points, notes = told_of(read_arm_points, folder / f"{file}.csv")
        assert points.q.shape == (120, 6) and points.rotation is None and names_it(notes[-1], f"{missing} of 120")


def test_a_point_touched_again_and_again_at_zero_was_not_lost():
    for file, n in (("touch", 50), ("one", 25)):
        assert len(read_arm_points(case("arms-13") / f"{file}.csv").q) == n


def test_zeros_do_not_turn_the_verdict_and_reach_no_table(tmp_path):
    folder = case("trackers")
    files = {"measured": folder / "xyz_zero.csv", "arm": "ur10", "joints": folder / "joints_off.csv"}
    found = verify(**files, out=tmp_path / "v")
    full = verify(**{**files, "measured": folder / "xyz_full.csv"}, out=tmp_path / "full")
    assert found.cause == full.cause and found.n >= 110 and abs(found.time.offset_s) < 3 * found.time.std_s
    off_rad, std_rad = found.joints[2].offset_rad, found.joints[2].std_rad
    assert (
        off_rad is not None and std_rad is not None and abs(abs(np.degrees(off_rad)) - 0.3) < 3.0 * np.degrees(std_rad)
    )
    done = join(**files, kind="points", out=tmp_path / "points.csv")
    assert any(names_it(note, LINES) for note in done.notes)
    assert np.linalg.norm(read_arm_points(tmp_path / "points.csv").xyz_m, axis=1).min() > 0.1
