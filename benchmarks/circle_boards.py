"""Circle boards laid into real photographs: found, wrong and missed, on each picture beside OpenCV's findCirclesGrid.

Also photographs without any board, and boards of another size than the one asked for: all of them must be refused.
Reads ../shared/data (opencv_stereo, dots_10x10_handeye, rooms) and says so where it is not there.
`--boards N` composites (200), `--first SEED`, `--write FOLDER` keeps the pictures that were missed or wrong.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from armsight.errors import BadImage
from armsight.measure.boards import find_board, warm_up
from armsight.records import Target, TargetKind, board_target
from armsight.records.views import symmetries
from bench import machine, table, test_scene

scene = test_scene("circle_composites")

RIGHT_PX = 1.0
"""A board whose dots are all this near to the truth is right; OpenCV's centres are not compared more finely."""
ENOUGH = 0.9
"""Share of the dots that a board found must have."""
OTHER_SIZES = ((1, 0), (0, 1), (-1, 0), (0, -1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What became of one picture: ours and OpenCV's are 'found', 'missed' or 'wrong', with the RMS error in px."""

    seed: int
    size: str
    photograph: str
    ours: str
    why: str
    rms_px: float
    opencv: str
    opencv_rms_px: float
    ours_ms: float
    opencv_ms: float


def judged(uv: np.ndarray, index: np.ndarray, board: Target, truth: np.ndarray) -> tuple[str, float]:
    """Return 'found' or 'wrong' and the RMS error per axis, whichever of the print's own turns was chosen."""
    errors = [uv - truth[turn[index]] for turn in symmetries(board)]
    best = min(errors, key=lambda error: float(np.abs(error).max()))
    right = bool(np.linalg.norm(best, axis=1).max() < RIGHT_PX) and len(index) >= ENOUGH * len(truth)
    return ("found" if right else "wrong"), float(np.sqrt(np.mean(best**2)))


def ours(image: np.ndarray, board: Target, truth: np.ndarray) -> tuple[str, str, float]:
    """Return the outcome, the reason of a refusal and the RMS error."""
    try:
        view = find_board(image, board, source="picture")
    except BadImage as error:
        return "missed", error.cause.removeprefix("picture: "), np.nan
    outcome, rms = judged(view.uv_px, view.index, board, truth)
    return outcome, "", rms


def opencv(image: np.ndarray, board: Target, truth: np.ndarray, *, light_dots: bool) -> tuple[str, float]:
    """Return the outcome of findCirclesGrid, with either of its searches; light dots are given to it inverted."""
    shown = 255 - image if light_dots else image
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.kind is TargetKind.ACIRCLES else cv2.CALIB_CB_SYMMETRIC_GRID
    outcome, rms = "missed", np.nan
    for extra in (0, cv2.CALIB_CB_CLUSTERING):
        found, centres = cv2.findCirclesGrid(shown, (board.columns, board.rows), flags=kind | extra)
        if not found:
            continue
        at = np.asarray(centres, float).reshape(-1, 2)
        outcome, rms = judged(at, np.arange(len(at)), board, truth)
        if outcome == "wrong" and board.kind is TargetKind.CIRCLES:  # it may count from any corner, or mirrored
            mirrored = at.reshape(board.rows, board.columns, 2)[:, ::-1].reshape(-1, 2)
            outcome, rms = judged(mirrored, np.arange(len(at)), board, truth)
        if outcome == "found":
            break
    return outcome, rms


def run(seed: int, keep: Path | None) -> Case:
    """Judge one composite."""
    made = scene.composite(seed)
    start = time.thread_time()  # other work on the machine does not count
    outcome, why, rms = ours(made.image, made.board, made.uv_px)
    middle = time.thread_time()
    peer, peer_rms = opencv(made.image, made.board, made.uv_px, light_dots=made.light_dots)
    end = time.thread_time()
    if keep is not None and outcome != "found":
        keep.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(keep / f"{seed:05d}_{outcome}.png"), made.image)
    return Case(
        seed=seed,
        size=f"{made.board.kind.value} {made.board.columns}x{made.board.rows}",
        photograph=made.photograph,
        ours=outcome,
        why=why,
        rms_px=rms,
        opencv=peer,
        opencv_rms_px=peer_rms,
        ours_ms=1e3 * (middle - start),
        opencv_ms=1e3 * (end - middle),
    )


def two_alike(seed: int) -> bool:
    """Tell whether the photograph shows a board of the same kind and size, so that either would be right."""
    made = scene.composite(seed)
    return has_such_board(made.photograph, made.board)


def has_such_board(photograph: str, board: Target) -> bool:
    """Tell whether a photograph by itself shows this board: one folder holds a sheet of 10x10 dots."""
    there = "dots_10x10" in photograph or photograph.startswith("images/")
    return there and board.kind is TargetKind.CIRCLES and (board.columns, board.rows) == (10, 10)


def boards(n: int, first: int, keep: Path | None) -> None:
    """Print what became of n composites."""
    seeds = [seed for seed in range(first, first + n) if not two_alike(seed)]
    if len(seeds) < n:
        print(f"{n - len(seeds)} left out: the photograph itself shows such a board as well")
    n = len(seeds)
    cases = [run(seed, keep) for seed in seeds]
    rows = []
    for name, outcomes, errors, ms in (
        ("armsight", [c.ours for c in cases], [c.rms_px for c in cases], [c.ours_ms for c in cases]),
        ("OpenCV", [c.opencv for c in cases], [c.opencv_rms_px for c in cases], [c.opencv_ms for c in cases]),
    ):
        count = Counter(outcomes)
        good = [e for e, o in zip(errors, outcomes, strict=True) if o == "found"]
        spread = np.percentile(ms, [50, 99])
        row = [name, count["found"], count["wrong"], count["missed"], f"{100 * count['found'] / n:.1f}"]
        row += [f"{np.median(good):.4f}" if good else "", f"{max(good):.3f}" if good else ""]
        ratio = spread / np.percentile([c.opencv_ms for c in cases], [50, 99])
        rows.append([*row, *(f"{one:.1f}" for one in spread), " and ".join(f"{one:.2f}" for one in ratio)])
    table(
        f"{n} boards in photographs, seeds {first} to {first + n - 1}",
        [
            "",
            "found",
            "wrong",
            "missed",
            "found %",
            "centre px RMS, median",
            "worst picture",
            "ms median",
            "ms 99 %",
            "of OpenCV's",
        ],
        rows,
    )
    both = [c for c in cases if c.ours == c.opencv == "found"]
    worse = [c for c in both if c.rms_px > c.opencv_rms_px]
    lost = [c for c in cases if c.opencv == "found" and c.ours != "found"]
    print(f"\npictures where OpenCV finds the board and armsight does not: {len(lost)} of {n}")
    print(f"pictures found by both: {len(both)}, OpenCV's centres nearer to the truth in {len(worse)} of them")
    for c in cases:
        if c.ours != "found" or c in worse:
            print(
                f"  seed {c.seed}, {c.size}, {c.photograph}: {c.ours} {c.rms_px:.3f} px, {c.why or 'no reason'};",
                end="",
            )
            print(f" OpenCV {c.opencv} {c.opencv_rms_px:.3f} px")


def strangers(n: int, first: int) -> None:
    """Print what is said of photographs without a board, and of boards of another size."""
    rng = np.random.default_rng(first)
    bare = Counter[str]()
    for name, photograph in scene.photographs():
        board = scene.draw_board(rng)
        if has_such_board(name, board):
            continue
        bare[answer(photograph, board, name)] += 1
    other = Counter[str]()
    for seed in range(first, first + n):
        made = scene.composite(seed)
        dc, dr = OTHER_SIZES[seed % 4]
        columns, rows = max(made.board.columns + dc, 3), max(made.board.rows + dr, 3)
        if (columns, rows) == (made.board.columns, made.board.rows):
            continue
        asked = board_target(made.board.kind, columns, rows, made.board.pitch_m)
        other[answer(made.image, asked, f"seed {seed}")] += 1
    table(
        "What must be refused",
        ["", "pictures", "refused", "taken for the board"],
        [
            ["photographs without the board", bare.total(), bare["refused"], bare["taken"]],
            ["a board of one column or row more or less", other.total(), other["refused"], other["taken"]],
        ],
    )


def answer(image: np.ndarray, board: Target, name: str) -> str:
    """Return 'refused' or 'taken'."""
    try:
        find_board(image, board, source=name)
    except BadImage:
        return "refused"
    print(f"taken: {name}, asked for {board.kind.value} {board.columns}x{board.rows}")
    return "taken"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--write", type=Path, default=None)
    asked = parser.parse_args()
    if not scene.photographs():
        print("the photographs are not beside the repository, skipped")
        return
    cv2.setNumThreads(1)
    warm_up()
    print(machine(), f"OpenCV {cv2.__version__}", sep=", ")
    boards(asked.boards, asked.first, asked.write)
    strangers(max(asked.boards // 4, 4), asked.first)


if __name__ == "__main__":
    main()
