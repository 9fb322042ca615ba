"""A hundred files of trackers with a fault each, seeded: refused, or what is read is true. Where numbers are exchanged
that nothing in the file contradicts, `verify` contradicts them. None is wrong and called good."""

import struct
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.errors import Ambiguous, DataRefused, UsageError
from armsight.ops.verify import verify
from armsight.store.interpret import TableFormat
from armsight.store.verify_files import read_measured
from refusals import refuses

N, RATE = 40, 50.0
SHAPE = np.array([[0.0, 0, 0], [90, 0, 0], [0, 70, 0], [10, 20, 60]])  # mm


@cache
def world():
    """Return R (n), t (n, 3) mm: of a body that goes about and turns by up to 100 degrees."""
    s = np.linspace(0.0, 2.5, N)
    R = Rotation.from_euler("ZYX", np.stack([100 * np.sin(s), 40 * np.cos(s), 30 * s], axis=1), degrees=True)
    return R, np.stack([900 + 250 * np.sin(s), 300 * np.cos(1.7 * s), 500 + 80 * s], axis=1)


def row(*cells):
    return [cell if isinstance(cell, str) else f"{cell:.6f}" for cell in cells]


def motive():
    R, t = world()
    bodies = ("Flange", "Base")
    head = ["Format Version", "1.25", "Total Exported Frames", str(N), "Rotation Type", "Quaternion"]
    lines = [[*head, "Length Units", "Millimeters", "Coordinate Space", "Global"], []]
    lines.append(["", "Type", *["Rigid Body"] * 16])
    lines.append(["", "Name", *[name for name in bodies for _ in range(8)]])
    lines.append(["", "ID", *[name for name in "ab" for _ in range(8)]])
    lines.append(["", "", *(["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]) * 2])
    lines.append(["Frame", "Time (Seconds)", *("X", "Y", "Z", "W", "X", "Y", "Z", "") * 2])
    still = row(0.5, 0.5, 0.5, 0.5, 10.0, 20.0, 30.0, 0.1)
    lines += [[str(k), *row(k / RATE, *R[k].as_quat(), *t[k], 0.1), *still] for k in range(N)]
    return lines, ",", {"body": "Flange"}


def qtm():
    R, t = world()
    lines = [["NO_OF_FRAMES", str(N)], ["FREQUENCY", "50"], ["DATA_INCLUDED", "6D"], ["BODY_NAMES", "Flange"]]
    rot = [f"Rot[{i}]" for i in range(9)]
    lines.append(["Frame", "Time", "Flange X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *rot])
    for k in range(N):
        angles = R[k].as_euler("XYZ", degrees=True)
        lines.append([str(k + 1), *row(k / RATE, *t[k], *angles, 0.2, *R[k].as_matrix().T.ravel())])
    return lines, "\t", {}


def vicon():
    R, t = world()
    lines = [["Objects"], ["50"], ["", "", "Global Angle Flange:Flange"]]
    lines.append(["Frame", "Sub Frame", "RX", "RY", "RZ", "TX", "TY", "TZ"])
    lines.append(["", "", *["rad"] * 3, *["mm"] * 3])
    lines += [[str(k + 1), "0", *row(*R[k].as_rotvec(), *t[k])] for k in range(N)]
    return lines, ",", {"euler": "rotvec"}


def trc():
    R, t = world()
    lines = [["PathFileType", "4", "(X/Y/Z)", "a.trc"], ["DataRate", "NumFrames", "NumMarkers", "Units"]]
    lines += [["50", str(N), "4", "mm"], ["Frame#", "Time", "A", "", "", "B", "", "", "C", "", "", "D", "", ""]]
    lines += [["", "", *[f"{axis}{k}" for k in (1, 2, 3, 4) for axis in "XYZ"]], []]
    lines += [[str(k + 1), *row(k / RATE, *(R[k].apply(SHAPE) + t[k]).ravel())] for k in range(N)]
    return lines, "\t", {}


FORMATS = (motive, qtm, vicon, trc)


def data_rows(lines):
    return [k for k, line in enumerate(lines) if line and line[0].isdecimal() and len(line) > 6]


def exchanged(lines, rng, by):
    """Exchange two columns of coordinates in the header's names and units alike, so that only the numbers move."""
    wide = len(lines[-1])
    a, b = rng.choice(np.arange(2, min(wide, 9)), 2, replace=False)
    for k in data_rows(lines):
        lines[k][a], lines[k][b] = lines[k][b], lines[k][a]
    return by


def names_exchanged(lines, rng, by):
    head = data_rows(lines)[0] - 1
    while len(lines[head]) < 6 or not any(cell.strip() for cell in lines[head]):
        head -= 1
    a, b = rng.choice(np.arange(2, min(len(lines[head]), 8)), 2, replace=False)
    lines[head][a], lines[head][b] = lines[head][b], lines[head][a]
    return by


def cut_row(lines, rng, by):
    k = int(rng.choice(data_rows(lines)))
    lines[k] = lines[k][: int(rng.integers(1, len(lines[k])))]
    return by


def cut_file(lines, rng, by):
    del lines[int(rng.choice(data_rows(lines)[1:])) :]
    return by


def no_head(lines, rng, by):
    del lines[: int(rng.integers(1, data_rows(lines)[0] + 1))]
    return by


def commas(lines, rng, by):
    for k in data_rows(lines):
        lines[k] = [cell.replace(".", ",") for cell in lines[k]]
    return by


def locale(lines, rng, by):
    commas(lines, rng, by)
    return ";"


def no_unit(lines, rng, by):
    for line in lines[: data_rows(lines)[0]]:
        for k, cell in enumerate(line):
            line[k] = "" if cell.lower() in ("mm", "millimeters") else cell
    return by


def other_unit(lines, rng, by):
    for line in lines[: data_rows(lines)[0]]:
        for k, cell in enumerate(line):
            line[k] = "furlongs" if cell.lower() in ("mm", "millimeters") else cell
    return by


def two_alike(lines, rng, by):
    for line in lines[: data_rows(lines)[0]]:
        for k, cell in enumerate(line):
            line[k] = {"Base": "Flange", "B": "A", "Flange X": "Flange X"}.get(cell, cell)
    return by


def words_inside(lines, rng, by):
    k = int(rng.choice(data_rows(lines)))
    lines[k][int(rng.integers(1, len(lines[k])))] = str(rng.choice(["n/a", "inf", "1.2.3", "--", "1e999"]))
    return by


def order(lines, rng, by):
    rows = data_rows(lines)
    a, b = rng.choice(rows, 2, replace=False)
    lines[a], lines[b] = lines[b], lines[a]
    return by


def gaps(lines, rng, by):
    for k in rng.choice(data_rows(lines), 6, replace=False):
        lines[k][2:] = [""] * (len(lines[k]) - 2)
    return by


def doubled(lines, rng, by):
    k = int(rng.choice(data_rows(lines)))
    lines.insert(k, list(lines[k]))
    return by


def two_marks(lines, rng, by):
    lines[0][0] = f"\ufeff\ufeff{lines[0][0]}"
    return by


def underscore(lines, rng, by):
    k = int(rng.choice(data_rows(lines)))
    lines[k] = [cell.replace(".", "_") for cell in lines[k]]
    return by


FAULTS = (
    *(exchanged, names_exchanged, cut_row, cut_file, no_head, commas, locale, no_unit, other_unit, two_alike),
    *(words_inside, order, gaps, doubled, two_marks, underscore),
)


def is_true(found):
    """Whether every row that is read is where the body was then; a body of markers up to its own axes."""
    R, t = world()
    frames = np.round(found.t_s * RATE).astype(int)
    if frames.min() < 0 or frames.max() >= N or np.abs(found.t_s - frames / RATE).max() > 1e-6:
        return False
    inside = R[frames].inv().apply(1e3 * found.xyz_m - t[frames])  # mm, in the body's axes
    turned = R[frames].inv() * Rotation.from_matrix(found.rotation)
    still = np.abs(inside - inside[0]).max() < 0.01 and (turned[0].inv() * turned).magnitude().max() < 1e-4
    return still and (np.abs(inside).max() < 0.01 or np.abs(inside - SHAPE.mean(axis=0)).max() < 0.01)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_without_a_fault_is_true(tmp_path, kind):
    lines, by, stated = kind()
    path = tmp_path / "a.csv"
    path.write_text("\n".join(by.join(line) for line in lines) + "\n")
    assert is_true(read_measured(path, TableFormat(**stated)).measured)


def outcome(path, stated):
    try:
        found = read_measured(path, TableFormat(**stated)).measured
    except (DataRefused, UsageError) as error:
        assert error.cause
        return "refused"
    if found.rotation is not None and is_true(found):
        return "true"
    R, t = world()
    commanded = path.with_name("commanded.csv")
    rows = [",".join(map(str, (k / RATE, *(1e-3 * t[k]), *R[k].as_quat()))) for k in range(N)]
    commanded.write_text("\n".join(["t_s,x_m,y_m,z_m,qx,qy,qz,qw", *rows]) + "\n")
    try:
        done = verify(path, commanded=commanded, table=TableFormat(**stated))
    except (DataRefused, UsageError):
        return "refused"
    return "called good" if done.verdict_.level == "good" else "contradicted"


def test_no_file_with_a_fault_is_wrong_and_called_good(tmp_path):
    seen, path = {}, tmp_path / "a.csv"
    for seed in range(128):
        rng = np.random.default_rng(seed)
        kind, fault = FORMATS[seed % 4], FAULTS[seed // 4 % len(FAULTS)]
        lines, by, stated = kind()
        before = [list(line) for line in lines]
        by_now = fault(lines, rng, by)
        if lines == before and by_now == by:
            continue
        path.write_text("\n".join(by_now.join(line) for line in lines) + "\n")
        seen[seed, kind.__name__, fault.__name__] = outcome(path, stated)
    assert not [key for key, what in seen.items() if what == "called good"]
    contradicted = [fault for (_, _, fault), what in seen.items() if what == "contradicted"]
    assert set(contradicted) <= {"exchanged", "names_exchanged"}
    assert len(seen) >= 100
    assert sum(what == "true" for what in seen.values()) >= 8  # gaps and other locales are read


def test_c3d_cut_or_damaged_is_refused_or_true(tmp_path):
    R, t = world()
    points = np.stack([R.apply(p) + t for p in SHAPE], axis=1)  # (n, 4, 3) mm
    values = {
        b"USED": struct.pack("<bBhB", 2, 0, 4, 0),
        b"SCALE": struct.pack("<bBfB", 4, 0, -0.1, 0),
        b"RATE": struct.pack("<bBfB", 4, 0, RATE, 0),
        b"DATA_START": struct.pack("<bBhB", 2, 0, 3, 0),
        b"UNITS": struct.pack("<bBB2sB", -1, 1, 2, b"mm", 0),
        b"LABELS": struct.pack("<bBBB4sB", -1, 2, 1, 4, b"ABCD", 0),
    }
    parameters = b"\x01\x50\x01\x54" + struct.pack("<bb5shB", 5, -1, b"POINT", 3, 0)
    for name, value in values.items():
        parameters += struct.pack("<bb", len(name), 1) + name + struct.pack("<h", 2 + len(value)) + value
    head = struct.pack("<BBhhHHhfhhf", 2, 0x50, 4, 0, 1, N, 0, -0.1, 3, 0, RATE)
    rows = np.concatenate([points, np.ones((N, 4, 1))], axis=2).astype("<f4").tobytes()
    whole = head.ljust(512, b"\0") + parameters.ljust(512, b"\0") + rows
    path = tmp_path / "a.c3d"
    path.write_bytes(whole)
    assert outcome(path, {}) == "true"
    seen = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        data = bytearray(whole)
        if seed % 2:
            data = data[: int(rng.integers(600, len(whole) - 1))]
        else:
            data[int(rng.integers(512, 640))] = int(rng.integers(0, 256))
        path.write_bytes(bytes(data))
        seen.append(outcome(path, {}))
    assert "called good" not in seen
    assert set(seen[1::2]) == {"refused"}  # what is cut off


def test_groups_of_one_last_word_are_asked_for_and_one_is_taken_by_it(tmp_path):
    points = "".join(f"{cell} flange, P{k}, {k}.5, {k * k}.0, 7.0\n" for cell in ("cell", "room") for k in range(4))
    path = tmp_path / "sa.txt"
    path.write_text(points)
    with refuses(Ambiguous, ("cell flange", "room flange", "--body")):
        read_measured(path, TableFormat(units="mm", body="flange"))
    path.write_text(points.replace("room flange", "room base"))
    assert len(read_measured(path, TableFormat(units="mm", body="flange")).measured.xyz_m) == 4
