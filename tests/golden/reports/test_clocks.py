"""Logs whose stamps or angles are written as drivers write them, joined with a tracker on another clock."""

import csv

import numpy as np
import pytest

from armsight.ops.files import join
from reports import case

ROWS_S = 12.0
"""Of the tracker's run, which lasts half a minute: all that is told here shows in it."""
OFFSET_S = -0.350


def columns(path):
    with path.open() as file:
        rows = list(csv.reader(file))
    return {name: np.array(cells, float) for name, cells in zip(rows[0], zip(*rows[1:], strict=True), strict=True)}


def beginning(path, out):
    lines = path.read_text().splitlines()
    kept = [line for line in lines[1:] if float(line.split(",")[0]) < float(lines[1].split(",")[0]) + ROWS_S]
    out.write_text("\n".join([lines[0], *kept]) + "\n")
    return out


@pytest.mark.parametrize(
    ("name", "log", "true"), [("arms-04", "joints-360", "joints"), ("arms-17", "joints", "joints-steady")]
)
def test_joints_are_those_of_the_moment_across_seams_and_stalls(tmp_path, name, log, true):
    folder = case(name)
    measured = beginning(folder / "tracker.csv", tmp_path / "tracker.csv")
    found = join(measured, arm="ur10", joints=folder / f"{log}.csv", kind="points", out=tmp_path / "points.csv")
    assert abs(found.offset_s - OFFSET_S) < 4 * found.offset_std_s + (2e-3 if name == "arms-17" else 0.0)  # as stamped
    points, tracker, truth = columns(tmp_path / "points.csv"), columns(measured), columns(folder / f"{true}.csv")
    at = np.array([int(np.argmin(np.abs(tracker["x_m"] - x))) for x in points["x_m"]])
    for k in range(1, 7):
        unit = 1.0 if f"q{k}" in truth else np.pi / 180.0
        want = unit * np.interp(tracker["t_s"][at] + OFFSET_S, truth["t_s"], truth.get(f"q{k}", truth.get(f"q{k}_deg")))
        off = np.angle(np.exp(1j * (points[f"q{k}"] - want)))
        assert np.abs(off).max() < np.deg2rad(0.06)  # of which the straight line between rows of 10 Hz is 0.04
        assert points[f"q{k}"].min() > -np.pi and points[f"q{k}"].max() < 2.1 * np.pi  # in the turn that was written
