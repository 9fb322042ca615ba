"""Cures of trackers' files: which body is meant, of which markers, in which unit and order of angles."""

from collections.abc import Sequence

import numpy as np
from cures_of_runs import by_chance, over_time
from scipy.spatial.transform import Rotation

from armsight.kinematics import preset
from armsight.units import DEG

ARM = preset("irb120")
AXES = Rotation.from_euler("xyz", [20.0, -10.0, 100.0], degrees=True)
BASE_MM = np.array([1500.0, -300.0, 200.0])
"""The tracker's axes: T_tracker_base."""
MARKERS_MM = {"A": (0, 0, 30), "B": (60, 0, 30), "C": (120, 0, 30), "D": (20, 70, 10)}
"""On the flange; A, B and C stand on a line."""
LAB_MM = {"P": (100, 0, 0), "Q": (900, 0, 0), "R": (0, 800, 100)}
"""On the wall."""
RATE = 25.0


def flange_of(table: str) -> tuple[Rotation, np.ndarray]:
    """Return R (n), t (n, 3) mm: where a tracker sees the flange for a table's joints, the last six columns."""
    q = np.array([[float(cell) for cell in line.split(",")[-6:]] for line in table.splitlines()[1:]])
    T = np.array([ARM.fk(row) for row in q])
    return AXES * Rotation.from_matrix(T[:, :3, :3]), AXES.apply(1e3 * T[:, :3, 3]) + BASE_MM


R, T_MM = flange_of(over_time())
N = len(T_MM)
SEEN = {name: R.apply(place) + T_MM for name, place in MARKERS_MM.items()}
WALL = {name: np.tile(AXES.apply(place), (N, 1)) for name, place in LAB_MM.items()}
LATE = np.arange(N)[:, None] >= N // 2
HALVES = {name: np.where(LATE, SEEN[name], np.nan) for name in "BCD"} | {
    name: np.where(LATE, np.nan, SEEN["A"] + 20.0 * k) for k, name in enumerate("EF")
}
"""B, C and D are seen when E and F no longer are."""


def cells(values: Sequence[float]) -> list[str]:
    return ["" if value != value else f"{value:.6f}" for value in values]


def text(lines: Sequence[Sequence[str]], by: str) -> str:
    return "\n".join(by.join(line) for line in lines) + "\n"


def trc(markers: dict[str, np.ndarray], unit: str = "mm") -> str:
    """Return markers (n, 3) mm as a TRC."""
    return text(
        [
            ["PathFileType", "4", "(X/Y/Z)", "a.trc"],
            ["DataRate", "NumFrames", "NumMarkers", "Units"],
            [f"{RATE:g}", str(N), str(len(markers)), unit],
            ["Frame#", "Time", *(cell for name in markers for cell in (name, "", ""))],
            ["", "", *(f"{axis}{k + 1}" for k in range(len(markers)) for axis in "XYZ")],
            [],
            *([str(k + 1), *cells([k / RATE, *np.ravel([xyz[k] for xyz in markers.values()])])] for k in range(N)),
        ],
        "\t",
    )


def qtm(bodies: Sequence[str], angles: str, order: str, *, matrix: bool) -> str:
    """Return a 6D export of QTM: the flange, and what else is named, still; angles as called, of an order."""
    lines = [["NO_OF_FRAMES", str(N)], ["FREQUENCY", f"{RATE:g}"], ["DATA_INCLUDED", "6D"], ["BODY_NAMES", *bodies]]
    rot = [f"Rot[{i}]" for i in range(9)] if matrix else []
    lines.append(["Frame", "Time"])
    for name in bodies:
        lines[-1] += [f"{name} X", "Y", "Z", *angles.split(), "Residual", *rot]
    for k in range(N):
        lines.append([str(k + 1), *cells([k / RATE])])
        for one in (k, *[0] * (len(bodies) - 1)):
            turned = R[one].as_matrix().T.ravel() if matrix else []
            lines[-1] += cells([*T_MM[one], *R[one].as_euler(order, degrees=True), 0.2, *turned])
    return text(lines, "\t")


def vicon(turns: np.ndarray, *more: Sequence[str]) -> str:
    """Return an export of Vicon's: the flange with its turns, of three numbers in rad or as quaternions, and more."""
    names = ["RX", "RY", "RZ", "RW"][: turns.shape[1]]
    head = [["Objects"], [f"{RATE:g}"], ["", "", "Global Angle Flange:Flange"]]
    head += [["Frame", "Sub Frame", *names, "TX", "TY", "TZ"], ["", "", *["rad"] * len(names), *["mm"] * 3]]
    rows = [[str(k + 1), "0", *cells([*turns[k], *T_MM[k]])] for k in range(N)]
    return text([*head, *rows, *more], ",")


def trajectories() -> list[list[str]]:
    """Return the section of the flange's markers."""
    named = [cell for name in SEEN for cell in (name, "", "")]
    head = [[], ["Trajectories"], [f"{RATE:g}"], ["", "", *named], ["Frame", "Sub Frame", *list("XYZ") * len(SEEN)]]
    rows = [[str(k + 1), "0", *cells(np.ravel([xyz[k] for xyz in SEEN.values()]))] for k in range(N)]
    return [*head, ["", "", *["mm"] * 3 * len(SEEN)], *rows]


def points(remark: str, *groups: str) -> str:
    """Return a list of SpatialAnalyzer: groups of a point for each row of j.csv, of which the last is the flange's."""
    _, flange = flange_of(by_chance(1, 30))
    places = {name: flange + 100.0 * (len(groups) - 1 - i) for i, name in enumerate(groups)}
    rows = [["cell", name, f"p{k + 1}", *cells(place)] for name, at in places.items() for k, place in enumerate(at)]
    return f"// {remark}\n" + text(rows, ", ")


def franka() -> str:
    """Return a log as libfranka writes one."""
    names = ["time", "success_rate", *(f"state.q[{k}]" for k in range(7))]
    return text([names, *([str(10 * k), "1", *cells(0.1 * np.sin(0.1 * k + np.arange(7)))] for k in range(40))], ",")


FILES = {
    "flange.tsv": qtm(["Flange"], "Roll Pitch Yaw", "XYZ", matrix=True),
    "two-bodies.tsv": qtm(["Flange", "Wand"], "Roll Pitch Yaw", "XYZ", matrix=True),
    "own-angles.tsv": qtm(["Flange"], "Heading Attitude Bank", "ZYX", matrix=False),
    "own-angles-matrix.tsv": qtm(["Flange"], "Heading Attitude Bank", "ZYX", matrix=True),
    "line.trc": trc(SEEN),
    "mixed.trc": trc(SEEN | WALL),
    "halves.trc": trc(HALVES),
    "no-unit.trc": trc(SEEN, unit=""),
    "helical.csv": vicon(0.5 * (R[0].inv() * R).as_rotvec()),
    "euler-xyz.csv": vicon(DEG * R.as_euler("XYZ", degrees=True)),
    "nexus.csv": vicon(R.as_quat(), *trajectories()),
    "groups.csv": points("in Millimeters", "wall", "flange"),
    "franka.csv": franka(),
}

TABLE = "convert table --as poses -o x.csv"
JOIN = "join --joints moving.csv --arm irb120 -o points.csv"
FLANGE = "kinematics fk --arm irb120 --joints moving.csv -o robot.csv"

TRIED = {
    ("store/interpret/read.py", "A tracker knows no joints"): (
        "calibrate robot-world --arm irb120 --points flange.tsv -o w.yaml",
        f"{JOIN} --measured flange.tsv && "
        "join --joints moving.csv --arm irb120 --measured flange.tsv --as observed -o observed.csv && "
        "calibrate robot-world --arm irb120 --points observed.csv -o w.yaml",
    ),
    ("store/interpret/read.py", "A tracker's file is one of the two"): (
        "calibrate handeye --setup eye-to-hand -o h.yaml --pairs flange.tsv",
        f"{FLANGE} && "
        "calibrate handeye --setup eye-to-hand -o h.yaml --robot-stream robot.csv --camera-stream flange.tsv",
    ),
    ("store/interpret/trackers/clouds.py", "Name a marker off the line with --body too"): (
        f"{JOIN} --measured line.trc --body A,B,C",
        f"{JOIN} --measured line.trc --body A,B,C,D && {JOIN} --measured line.trc --body A",
    ),
    ("store/interpret/trackers/clouds.py", "Name the markers of one body with --body"): (
        f"{TABLE} mixed.trc",
        "{} --body A,B,C,D",
    ),
    ("store/interpret/trackers/clouds.py", "Name markers that are seen together with --body"): (
        f"{TABLE} halves.trc --body B,E,F",
        f"{TABLE} halves.trc --body B,C,D",
    ),
    ("store/interpret/trackers/clouds.py", "Leave them out of --body"): (
        f"{TABLE} halves.trc --body B,C,D,E",
        f"{TABLE} halves.trc --body B,C,D",
    ),
    ("store/interpret/trackers/formats.py", "Leave --body out"): (
        "convert table --as joints -o x.csv franka.csv --body Flange",
        "convert table --as joints -o x.csv franka.csv",
    ),
    ("store/interpret/trackers/lists.py", "Name one with --body"): (
        "verify --measured groups.csv --arm irb120 --joints j.csv -o v",
        "{} --body 'cell flange'",
    ),
    ("store/interpret/trackers/qtm.py", "or give --euler with their order"): (
        f"{TABLE} own-angles.tsv",
        f"{TABLE} own-angles-matrix.tsv && {{}} --euler zyx",
    ),
    ("store/interpret/trackers/tracks.py", "Give --units mm"): (f"{TABLE} no-unit.trc", "{} --units mm"),
    ("store/interpret/trackers/tracks.py", "Name it with --body"): (f"{TABLE} two-bodies.tsv", "{} --body Flange"),
    ("store/interpret/trackers/tracks.py", "Give --body with one of these"): (
        f"{TABLE} nexus.csv --body Hand",
        f"{TABLE} nexus.csv --body Flange && {TABLE} nexus.csv --body A,B,C,D",
    ),
    ("store/interpret/trackers/vicon.py", "--euler rotvec for Helical"): (
        f"{TABLE} helical.csv",
        f"{{}} --euler rotvec && {TABLE} euler-xyz.csv --euler xyz",
    ),
}
