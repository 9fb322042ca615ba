"""C3D as two public libraries write and read it; and public files of laboratories, where they are on the machine.

The libraries' own readers are no truth for lost points: one gives the cameras of a point as its residual, the other
writes a lost point where it was last.
"""

import csv
import io
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import Inconsistent
from armsight.store.interpret import TableFormat
from armsight.store.interpret.trackers.formats import tracker_of
from armsight.store.verify_files import read_measured
from public_files import public_file
from refusals import refuses
from tracker_writers import Take
from tracker_writers import c3d as c3d_of

N, RATE = 60, 100.0
SHAPE = np.array([[0.0, 0, 0], [80, 0, 0], [0, 60, 0], [10, 20, 50]])  # mm
NAMES = ["Tool:A", "Tool:B", "Tool:C", "Tool:D"]
LOST = {(7, 0), (8, 0), (30, 2)}  # frame, marker


def world():
    """Return the truth: R (n), t (n, 3) in mm, markers (n, 4, 3) as single floats, and where they are lost."""
    s = np.linspace(0.0, 3.0, N)
    R = Rotation.from_rotvec(np.stack([0.8 * np.sin(s), s / 2, 0.5 * np.cos(2 * s)], axis=1))
    t = np.stack([1000 + 300 * np.sin(s), 200 * np.cos(s), 700 + 50 * s], axis=1)
    points = np.stack([R.apply(p) + t for p in SHAPE], axis=1).astype(np.float32)
    lost = np.zeros((N, 4), bool)
    for frame, marker in LOST:
        lost[frame, marker] = True
    return R, t, points.astype(float), lost


def by_ezc3d(path, points, lost, unit="mm"):
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    file["parameters"]["POINT"]["LABELS"]["value"] = NAMES
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["data"]["points"] = np.concatenate(
        [np.where(lost[..., None], np.nan, points).transpose(2, 1, 0), np.ones((1, 4, N))]
    )
    file.write(str(path))


def by_c3d(path, points, lost):
    c3d = pytest.importorskip("c3d")
    writer = c3d.Writer(point_rate=RATE, point_scale=-1.0)
    for frame, gone in zip(points, lost, strict=True):
        rows = np.zeros((4, 5), np.float32)
        rows[:, :3] = frame
        rows[gone, 3] = -1.0
        writer.add_frames([(rows, np.empty((0, 0)))])
    writer.set_point_labels(NAMES)
    held = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of analog data, which there are none
        writer.write(held)
    path.write_bytes(held.getvalue())


@pytest.mark.parametrize("write", [by_ezc3d, by_c3d])
def test_what_the_libraries_write_is_read_to_the_last_bit(tmp_path, write):
    _, _, points, lost = world()
    path = tmp_path / "a.c3d"
    write(path, points, lost)
    tracks = tracker_of(path.read_bytes()).read(path.read_bytes(), "a.c3d", TableFormat(units="mm"))
    assert [marker.name for marker in tracks.markers] == NAMES
    got = 1e3 * np.stack([marker.xyz_m for marker in tracks.markers], axis=1)
    np.testing.assert_array_equal(np.isnan(got).any(axis=2), lost)
    np.testing.assert_allclose(got[~lost], points[~lost], rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.diff(tracks.t_s), 1.0 / RATE, atol=1e-12)


@pytest.mark.parametrize("write", [by_ezc3d, by_c3d])
def test_a_cloud_with_lost_markers_is_a_body(tmp_path, write):
    R, t, points, lost = world()
    path = tmp_path / "a.c3d"
    write(path, points, lost)
    found = read_measured(path, TableFormat(units="mm")).measured
    assert len(found.xyz_m) == N  # three of four are enough
    middle = R.apply(SHAPE.mean(axis=0)) + t
    assert np.abs(found.xyz_m - 1e-3 * middle).max() < 1e-6
    assert (R.inv() * Rotation.from_matrix(found.rotation)).magnitude().max() < 1e-5  # single floats of metres, 80 mm


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize("scale", [-0.1, 0.05])
def test_the_numbers_of_all_processors_are_read(tmp_path, processor, scale):
    c3d = pytest.importorskip("c3d")
    _, _, points, lost = world()
    seen = np.where(lost[..., None], np.nan, 1e-3 * points)
    data = c3d_of(Take(rate=RATE, markers=dict(zip(NAMES, seen.transpose(1, 0, 2), strict=True))), processor, scale)
    tracks = tracker_of(data).read(data, "a.c3d", TableFormat())
    got = 1e3 * np.stack([marker.xyz_m for marker in tracks.markers], axis=1)
    np.testing.assert_array_equal(np.isnan(got).any(axis=2), lost)
    assert np.abs(got[~lost] - points[~lost]).max() <= (1e-9 if scale < 0.0 else scale / 2 + 5e-5)  # a single float
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = np.array([frame[1] for frame in c3d.Reader(io.BytesIO(data)).read_frames()])[..., :3]
    np.testing.assert_allclose(got[~lost], peer[~lost], rtol=0, atol=1e-4 if scale > 0.0 else 1e-9)


def test_a_file_that_is_cut_off_is_refused(tmp_path):
    _, _, points, lost = world()
    path = tmp_path / "a.c3d"
    by_ezc3d(path, points, lost)
    path.write_bytes(path.read_bytes()[:-2000])
    with refuses(Inconsistent, "60 frames", "are there"):
        read_measured(path)


PUBLIC = {
    "nexus": ("pyomeca/pyomeca", "3594512b142e4fa029902cc0ea3e74e4f1ef783e", "tests/data/markers.csv"),
    "c3d": ("pyomeca/pyomeca", "3594512b142e4fa029902cc0ea3e74e4f1ef783e", "tests/data/markers_analogs.c3d"),
    "trc": ("pyomeca/pyomeca", "3594512b142e4fa029902cc0ea3e74e4f1ef783e", "tests/data/markers.trc"),
    "motive": (
        "cmuphyscomp/hmv-s16",
        "7863c66ed645b463b72aef98a5c484a18cc9f396",
        "python/rhinoscripts/sample_optitrack_take.csv",
    ),
    "qtm": (
        "shiplab/dt_cv",
        "7bb6c1065c9cabc3f938e35505ef31b1188a3589",
        "data/basin/raw/M510A-IRR-EKFPID-020019_6D.tsv",
    ),
    "motive_123": ("neuma-script/pool-experiment", "5257c717", "optitrack.csv"),
    "qtm_old_6d": ("martinling/imusim", "294e171a", "imusim/tests/system/swing_6D.tsv"),
    "qtm_old_3d": ("martinling/imusim", "294e171a", "imusim/tests/system/swing_3D.tsv"),
    "trc_opensim": ("opensim-org/opensim-models", "20a888b9", "Pipelines/Gait2354_Simbody/subject01_walk1.trc"),
    "trc_blanks": ("opensim-org/opensim-models", "20a888b9", "Pipelines/Rajagopal/ExpData/static_walk_1.trc"),
    "c3d_lost": ("HansUniVie/MuscleLength", "30461f0b", "test.c3d"),
    "c3d_late": ("CelineSchreiber/Toolbox_Septembre2016", "27eb4a63", "test.c3d"),
}
"""Files of laboratories: repository, commit, path."""


def public(name, tmp_path):
    """A public file's path; the test is skipped where it is not on the machine."""
    path = tmp_path / Path(PUBLIC[name][2]).name
    path.write_bytes(public_file(*PUBLIC[name]))
    return path


def test_one_recording_as_csv_of_nexus_and_as_c3d(tmp_path):
    csv, c3d = (read_measured(public(one, tmp_path), TableFormat(body="boite")) for one in ("nexus", "c3d"))
    assert len(csv.measured.xyz_m) == len(c3d.measured.xyz_m) == 580
    assert np.abs(csv.measured.xyz_m - c3d.measured.xyz_m).max() < 3e-6  # the CSV has six digits
    assert np.abs(csv.measured.rotation - c3d.measured.rotation).max() < 3e-5
    np.testing.assert_allclose(csv.measured.t_s, c3d.measured.t_s, atol=1e-9)


def test_skin_is_no_body(tmp_path):
    with refuses(Inconsistent, "keep their distances"):
        read_measured(public("c3d", tmp_path), TableFormat(body="Daphnee"))


def test_a_trc_of_which_a_part_is_kept_is_refused_by_its_own_header(tmp_path):
    path = public("trc", tmp_path)
    with refuses(Inconsistent, "652 frames, there are 93", "correct the number"):
        read_measured(path, TableFormat(body="boite*"))
    path.write_text(path.read_text().replace("100,100,652,", "100,100,93,"))
    assert len(read_measured(path, TableFormat(body="boite*")).measured.xyz_m) == 93


def test_a_take_of_motive_is_where_its_markers_are(tmp_path):
    path = public("motive", tmp_path)
    body, markers = read_measured(path).measured, read_measured(path, TableFormat(body="Rigid Body 1:*")).measured
    apart = np.einsum("nji,nj->ni", body.rotation, markers.xyz_m - body.xyz_m)  # the middle in the body's axes
    assert np.abs(apart - apart.mean(axis=0)).max() < 5e-5
    turned = Rotation.from_matrix(np.einsum("nji,njk->nik", body.rotation, markers.rotation))
    assert (turned[0].inv() * turned).magnitude().max() < 1e-3


def test_a_body_of_qtm_by_its_matrix_and_by_its_angles(tmp_path):
    path = public("qtm", tmp_path)
    matrices = read_measured(path).measured
    lines = [line.split("\t") for line in path.read_text().splitlines()]
    head = next(k for k, line in enumerate(lines) if line[0] == "Frame")
    kept = [line if k < head else line[:8] for k, line in enumerate(lines)]
    path.write_text("\n".join("\t".join(line) for line in kept) + "\n")
    angles = read_measured(path).measured
    assert len(matrices.xyz_m) == len(angles.xyz_m) == 22245
    assert np.abs(matrices.rotation - angles.rotation).max() < 2e-5


def test_a_body_of_an_older_qtm_is_where_its_markers_are(tmp_path):
    """Angles are called Yaw, Pitch, Roll there, and the columns are named once for three bodies."""
    bodies, cloud = public("qtm_old_6d", tmp_path), public("qtm_old_3d", tmp_path)
    for name in ("Foot IMU", "Lower Leg IMU"):
        body = read_measured(bodies, TableFormat(body=name)).measured
        markers = read_measured(cloud, TableFormat(body=f"{name} - *")).measured
        both = np.intersect1d(body.t_s, markers.t_s, return_indices=True)[1:]
        assert len(both[0]) > 800
        apart = np.einsum("nji,nj->ni", body.rotation[both[0]], markers.xyz_m[both[1]] - body.xyz_m[both[0]])
        assert np.abs(apart - np.median(apart, axis=0)).max() < 2e-6
        assert np.ptp(body.xyz_m, axis=0).max() > 0.1  # it swings


def test_markers_of_opensims_files(tmp_path):
    for name, marker, frames in (("trc_opensim", "Sternum", 151), ("trc_blanks", "S2", 287)):
        path = public(name, tmp_path)
        cells = [line.split("\t") for line in path.read_text().splitlines()]
        at = cells[3].index(marker)
        want = 1e-3 * np.array([row[at : at + 3] for row in cells[6:] if len(row) > at], float)
        found = read_measured(path, TableFormat(body=marker)).measured
        assert len(found.xyz_m) == frames
        np.testing.assert_allclose(found.xyz_m, want, rtol=0.0, atol=1e-12)


def test_public_c3d_by_a_public_library(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    for name, lost in (("c3d_lost", 12878), ("c3d_late", 0)):
        path = public(name, tmp_path)
        tracks = tracker_of(path.read_bytes()).read(path.read_bytes(), name, TableFormat())
        got = 1e3 * np.stack([marker.xyz_m for marker in tracks.markers], axis=1)
        peer = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
        gone = np.isnan(got).any(axis=2)
        assert gone.sum() == lost
        assert np.abs(got - peer)[~gone].max() < 1e-9


def test_bodies_of_a_motive_of_another_version_by_their_columns(tmp_path):
    path = public("motive_123", tmp_path)
    rows = list(csv.reader(path.read_text().splitlines()))
    at = next(k for k, row in enumerate(rows) if row[:1] == ["Frame"])
    times = {round(float(row[1]), 6): row for row in rows[at + 1 :]}
    for name in sorted(set(rows[3][2:])):
        k = rows[3].index(name)
        found = read_measured(path, TableFormat(body=name)).measured
        want = np.array([times[round(t, 6)][k : k + 7] for t in found.t_s], float)
        assert len(want) > 800  # frames in which a body is frozen where it was last are left out
        np.testing.assert_allclose(found.xyz_m, 1e-3 * want[:, 4:], rtol=0.0, atol=1e-12)
        apart = Rotation.from_matrix(found.rotation).inv() * Rotation.from_quat(want[:, :4])
        assert apart.magnitude().max() < 1e-7
