"""The headline figures beside their peers, in ten minutes: ours, the peer's, and the peer's over ours.

    python benchmarks/summary.py | tee summary.txt
    python tools/benchmark_results.py summary summary.txt

keeps them and writes the first table of docs/benchmarks.md. Each figure is a cell of a table that another benchmark of
this folder prints; its function is called here with fewer repeats, in a process of its own. What is not installed or
not beside the repository is left out, and the table says so.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from bench import DATA, machine, table

HERE = Path(__file__).resolve()
PATIENCE_S = 180.0
"""For each benchmark: on a busy machine some are left out, and the table is ready all the same."""
Table = list[list[str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A cell of a printed table: what its row begins with, and its column."""

    row: tuple[str, ...]
    column: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A headline: the run and the beginning of the table's title that it is taken from, ours and the peer's cell."""

    work: str
    run: str
    title: str
    ours: Cell
    peer: Cell
    peer_name: str


def _kinematics() -> None:
    import kinematics

    kinematics.batches(20_000, 9)


def _spots() -> None:
    import spots

    spots.warm_up()
    spots.speed(100)


def _pose() -> None:
    import pose

    pose.warm_up()
    pose.time(400)


def _handeye() -> None:
    import handeye

    handeye.timing(30)


def _checkerboards() -> None:
    import real_boards

    if not (DATA / "opencv_stereo").exists():
        print("opencv_stereo: not here, skipped")
        return
    real_boards.speed(list(real_boards.images().values()), most=1)


def _circle_boards() -> None:
    import circle_boards

    if not circle_boards.scene.photographs():
        print("the photographs are not beside the repository, skipped")
        return
    circle_boards.warm_up()
    circle_boards.boards(60, 0, None)


def _stereo() -> None:
    import calibration

    board = calibration.board_target(calibration.TargetKind.CHECKERBOARD, 9, 6, 0.03)
    calibration.peers(4, board, board.xyz_m)


def _reading() -> None:
    import reading

    options = {"kinds": ["video", "png"], "minutes": 0.5, "pairs": 200, "repeats": 1, "scene": "webcam-cell"}
    reading.compare(argparse.Namespace(**options))


def _start() -> None:
    import cold_start

    table("With everything compiled", ("command", "processor s", "wall s"), cold_start.compiled())


RUNS: Mapping[str, Callable[[], None]] = {
    "kinematics": _kinematics,
    "spots": _spots,
    "pose": _pose,
    "handeye": _handeye,
    "real_boards": _checkerboards,
    "circle_boards": _circle_boards,
    "calibration": _stereo,
    "reading": _reading,
    "cold_start": _start,
}
"""What is run, by the benchmark that has it."""

FIGURES = (
    Figure(
        work="forward kinematics of six joints, us",
        run="kinematics",
        title="korayem6r",
        ours=Cell(row=("FK",), column="median"),
        peer=Cell(row=("Pinocchio FK",), column="median"),
        peer_name="Pinocchio",
    ),
    Figure(
        work="all inverse solutions in closed form, us",
        run="kinematics",
        title="korayem6r",
        ours=Cell(row=("IK closed form, all solutions",), column="median"),
        peer=Cell(row=("EAIK closed form",), column="median"),
        peer_name="EAIK",
    ),
    Figure(
        work="numeric inverse from 0.1 rad off, us",
        run="kinematics",
        title="korayem6r",
        ours=Cell(row=("IK numeric, warm start",), column="median"),
        peer=Cell(row=("Pinocchio IK, warm start",), column="median"),
        peer_name="Pinocchio, a loop in Python",
    ),
    Figure(
        work="six lights found in 1280x720, ms",
        run="spots",
        title="Six lights",
        ours=Cell(row=("find_spots",), column="median ms"),
        peer=Cell(row=("cv2.SimpleBlobDetector",), column="median ms"),
        peer_name="OpenCV's blob detector",
    ),
    Figure(
        work="lights found to a pose, ours with covariance, ms",
        run="pose",
        title="Time in ms",
        ours=Cell(row=("match and pose of spots found",), column="median"),
        peer=Cell(row=("peer: OpenCV triangulation + Kabsch (matched, no covariance)",), column="median"),
        peer_name="OpenCV and Kabsch, lights named",
    ),
    Figure(
        work="hand-eye of 20 poses, ms",
        run="handeye",
        title="Time of one calibration",
        ours=Cell(row=("20", "armsight fit with both noises"), column="median ms"),
        peer=Cell(row=("20", "OpenCV SHAH"), column="median ms"),
        peer_name="OpenCV, Shah's closed form",
    ),
    Figure(
        work="checkerboard in a photograph of 640x480, ms",
        run="real_boards",
        title="checkerboards",
        ours=Cell(row=("boards, 640 x 480", "armsight"), column="ms median"),
        peer=Cell(row=("boards, 640 x 480", "OpenCV, findChessboardCorners and cornerSubPix"), column="ms median"),
        peer_name="OpenCV with cornerSubPix",
    ),
    Figure(
        work="circle board in a photograph, ms",
        run="circle_boards",
        title="",
        ours=Cell(row=("armsight",), column="ms median"),
        peer=Cell(row=("OpenCV",), column="ms median"),
        peer_name="OpenCV's findCirclesGrid",
    ),
    Figure(
        work="stereo calibration of 20 boards, ms",
        run="calibration",
        title="Stereo calibration",
        ours=Cell(row=("armsight.calibrate_stereo",), column="median ms"),
        peer=Cell(row=("cv2 4.14, its defaults (30 it, 1e-6)",), column="median ms"),
        peer_name="OpenCV",
    ),
    Figure(
        work="two H.264 videos of 1280x720, half a minute, s",
        run="reading",
        title="armsight measure",
        ours=Cell(row=("video",), column="measure, s"),
        peer=Cell(row=("video",), column="alone, s"),
        peer_name="only decoding both with OpenCV, a thread each",
    ),
    Figure(
        work="200 PNG pairs of 1280x720, s",
        run="reading",
        title="armsight measure",
        ours=Cell(row=("png",), column="measure, s"),
        peer=Cell(row=("png",), column="alone, s"),
        peer_name="only reading them with OpenCV, a thread a core",
    ),
    Figure(
        work="`armsight measure` of ten pairs, processor s",
        run="cold_start",
        title="With everything compiled",
        ours=Cell(row=("armsight measure, 10 pairs",), column="processor s"),
        peer=Cell(row=("importing numpy, scipy, numba, OpenCV",), column="processor s"),
        peer_name="only importing what it is built on",
    ),
)


def number(tables: Sequence[tuple[str, Table]], title: str, cell: Cell) -> float | None:
    """Return the number that a cell begins with; None where no table has such a row. Raises KeyError for a column."""
    for head, (columns, *rows) in tables:
        for row in rows if head.startswith(title) else ():
            if tuple(row[: len(cell.row)]) == cell.row:
                if cell.column not in columns:
                    raise KeyError(f"{head}: no column {cell.column}, but {', '.join(columns)}")
                found = re.match(r"[-+\d.e]+", row[columns.index(cell.column)])
                return float(found[0]) if found else None
    return None


def row_of(figure: Figure, tables: Sequence[tuple[str, Table]]) -> list[object]:
    """Return work, ours, the peer's, how many times quicker ours is, and the peer's name."""
    ours, peer = (number(tables, figure.title, cell) for cell in (figure.ours, figure.peer))
    if ours is None or peer is None:
        missing = "not run here" if ours is None else "not installed"
        return [figure.work, "" if ours is None else ours, "", "", f"{figure.peer_name}: {missing}"]
    return [figure.work, ours, peer, f"{peer / ours:.2g}", figure.peer_name]


def printed(run: str) -> str:
    """Return what a benchmark prints, run in a process of its own; what it says goes to the error output as well."""
    command = [sys.executable, str(HERE), "--run", run]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        sys.stderr.write(f"{run} was stopped after {PATIENCE_S:g} s\n")
        return ""
    sys.stderr.write(done.stdout + (f"{run} failed\n" if done.returncode else ""))
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", choices=tuple(RUNS), help="only this benchmark's own tables")
    run = parser.parse_args().run
    if run:
        cv2.setNumThreads(1)
        RUNS[run]()
        return
    spec = importlib.util.spec_from_file_location("results", HERE.parents[1] / "tools" / "benchmark_results.py")
    if spec is None or spec.loader is None:
        raise SystemExit("tools/benchmark_results.py is not there")
    results = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(results)
    print(machine(), f"OpenCV {cv2.__version__}", f"load {os.getloadavg()[0]:.0f}", sep=", ")
    tables = {run: list(results.printed_tables(printed(run))) for run in RUNS}
    header = ["work, on two cores", "armsight", "peer", "times quicker", "the peer"]
    table("Headlines beside their peers", header, [row_of(figure, tables[figure.run]) for figure in FIGURES])


if __name__ == "__main__":
    main()
