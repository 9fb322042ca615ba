"""Commands that read what was measured and what the robot says: units and columns of each table by themselves."""

import csv

import numpy as np

import armsight
from armsight.errors import BadFile, UsageError
from armsight.ops.files import join
from armsight.ops.flags import TwoTableFlags
from refusals import refuses


def written(path, header, rows):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([*([header] if header else []), *rows])
    return path


def test_each_table_has_units_and_columns_of_its_own(tmp_path):
    """A tracker in mm without a header, and a log in degrees with one: neither flag is for both."""
    arm = armsight.presets.ur10()
    t = np.arange(0.0, 20.0, 0.05)
    phases = np.outer(t, [0.31, 0.47, 0.59, 0.41, 0.53, 0.67])
    q = 0.4 * np.sin(phases) + [0.0, -1.2, 1.4, -0.3, 1.5, 0.0]
    xyz_m = arm.fk(q)[:, :3, 3]
    measured = written(tmp_path / "tracker.csv", None, np.column_stack([t, 1e3 * xyz_m]).tolist())
    joints = written(
        tmp_path / "log.csv", ["t_s", *(f"q{k}" for k in range(1, 7))], np.column_stack([t, np.rad2deg(q)])
    )
    told = []
    flags = TwoTableFlags(columns="measured:t_s,xyz", units="measured:mm;robot:deg")
    known = {"joints": joints, "arm": "ur10", "out": tmp_path / "points.csv"}
    join(measured, **known, table=flags.made(told.append))
    with known["out"].open() as file:
        rows = list(csv.DictReader(file))
    got = np.array([[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in rows])
    readings = np.array([[float(row[f"q{k}"]) for k in range(1, 7)] for row in rows])
    assert len(rows) > 300
    assert np.abs(arm.fk(readings)[:, :3, 3] - got).max() < 2e-4
    both = TwoTableFlags(columns="t_s,xyz", units="mm").made(told.append)
    with refuses(BadFile, "7 columns"):
        join(measured, **known, table=both)


def test_a_table_that_is_not_there_is_refused():
    for text in ("tracker:mm", "measured:mm;measured:deg"):
        with refuses(UsageError, "measured", "robot"):
            TwoTableFlags(units=text).made(print)
