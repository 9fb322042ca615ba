"""A first-time user's whole way in the browser, on the simulated cell, one step resting on the one before."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.store import read_rig
from armsight.store.handeye_file import read_handeye
from armsight_sim.boards import Board, random_board_pose
from armsight_sim.cell import BoardCell

BOARDS = 17
"""Two more than are accepted, whichever these are: nearly all of what they cover together is covered."""

pytestmark = [pytest.mark.alone, pytest.mark.timeout(900)]


def draw_boards(world: Any, folder: Path) -> str:
    """Write what the cell's cameras see of a board at many places; return the board's name."""
    cameras, printed, rng = world.cameras, Board(columns=8, rows=6, square_m=0.03), np.random.default_rng(2)
    rig = {side: (camera.lens, camera.T_world_camera) for side, camera in cameras.items()}
    tried = [random_board_pose(printed, rig, rng) for _ in range(10 * BOARDS)]
    poses = spread(
        tried, [[lens.project((T.inv() * one).apply(printed.corners_m())) for one in tried] for lens, T in rig.values()]
    )
    shown = BoardCell(name="b", seed=1, fps=2.0, cameras=cameras, printed=printed, poses=poses, assumptions=())
    for number, pair in enumerate(shown.frames()):
        for side, frame in zip(("left", "right"), pair, strict=True):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{number:03d}.png"), np.asarray(frame.image))
    return shown.board


def spread(poses: list[Any], seen_px: list[list[Any]]) -> tuple[Any, ...]:
    """Return BOARDS of the poses, each the one that most widens what those before it cover in a camera."""
    chosen: list[int] = []
    for _ in range(BOARDS):
        chosen.append(
            max(
                set(range(len(poses))) - set(chosen),
                key=lambda one: min(hull_px2(of, [*chosen, one]) for of in seen_px),
            )
        )
    return tuple(poses[one] for one in chosen)


def hull_px2(corners_px: list[Any], chosen: list[int]) -> float:
    return float(
        cv2.contourArea(cv2.convexHull(np.concatenate([corners_px[one] for one in chosen]).astype(np.float32)))
    )


@pytest.fixture(scope="module")
def calibrated(browser: Any, console: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, str, Path]]:
    """The cell after the way's first half: cameras from boards, hand-eye with them; its world, address and folder."""
    home = tmp_path_factory.mktemp("way")
    world, folder = console.small_cell(home / "small.yaml"), home / "cell"
    board = draw_boards(world, home / "boards")
    address, process = console.begin(folder, "--robot", f"sim:{home / 'small.yaml'}")
    try:
        page = console.opened(browser, f"{address}/settings")
        cameras = page.input_value("[data-testid=field-left]"), page.input_value("[data-testid=field-right]")
        calibrate_cameras(page, address, board, home / "boards")
        settings(page, address, left=cameras[0], right=cameras[1], rig="rig.yaml", target="target.yaml")
        hand_eye(page, console, address)
        page.close()
        yield world, address, folder
    finally:
        console.end(process)


def test_a_first_time_user_calibrates_cameras_and_hand_eye(calibrated: tuple[Any, str, Path]) -> None:
    world, _, folder = calibrated
    assert abs(read_rig(folder / "rig.yaml").baseline_m - world_baseline(world)) < 0.002
    placed = read_handeye(folder / "handeye-calibrated.yaml").T_parent_camera
    assert np.linalg.norm(placed.translation - world.T_base_rig.translation) < 0.01


def test_a_first_time_user_identifies_with_what_was_calibrated(
    browser: Any, console: Any, calibrated: tuple[Any, str, Path]
) -> None:
    """And finds the reports of it all; test_paths_view.py teaches, checks and plays."""
    _, address, folder = calibrated
    page = console.opened(browser, f"{address}/live")
    identify(page, console, address)
    assert (folder / "identify" / "arm.yaml").exists()
    page.goto(f"{address}/verify")
    for name in ("identify/arm.report.html", "handeye-calibrated.report.html"):
        page.wait_for_selector(f"text={name}")
    page.close()


def world_baseline(world: Any) -> float:
    left, right = (world.cameras[side].T_world_camera.translation for side in ("left", "right"))
    return float(np.linalg.norm(right - left))


def settings(page: Any, address: str, **fields: str) -> None:
    """Use other cameras and files."""
    page.goto(f"{address}/settings")
    for name, value in fields.items():
        page.fill(f"[data-testid=field-{name}]", value)
    page.click("[data-testid=apply]")
    page.wait_for_selector("text=In use")


def calibrate_cameras(page: Any, address: str, board: str, pictures: Path) -> None:
    page.get_by_text("Files begin anew at their end").click()
    sides = {side: str(pictures / side) for side in ("left", "right")}
    settings_with = {**sides, "board": board, "rig": "", "target": ""}
    for name, value in settings_with.items():
        page.fill(f"[data-testid=field-{name}]", value)
    page.click("[data-testid=apply]")
    page.wait_for_selector("text=In use")
    page.goto(f"{address}/calibrate")
    page.wait_for_selector("canvas[data-shown]")
    while page.locator("td button").count() < 15:  # a board that was accepted before is refused, and told
        accept(page)
    trusted(page)


def accept(page: Any) -> None:
    """Press Accept, and wait for what comes of it."""
    said = page.locator("[data-testid=step-said]")
    before = said.get_attribute("data-count")
    page.click("[data-testid=accept]:not([disabled])")
    page.wait_for_function("n => document.querySelector('[data-testid=step-said]').dataset.count !== n", arg=before)


def trusted(page: Any) -> None:
    """Calibrate; the verdict must be good."""
    page.click("[data-testid=calibrate]:not([disabled])")
    page.wait_for_selector("[data-testid=verdict]")
    assert page.get_attribute("[data-testid=verdict]", "data-level") == "good", page.inner_text("main")


TURNS = (
    ("3:1", 1000), ("3:1", 700), ("3:-1", 2400), ("3:-1", 900), ("3:1", 1600), ("4:1", 1000), ("4:1", 700),
    ("4:-1", 2400), ("4:-1", 900), ("4:1", 1600), ("5:1", 1000), ("5:-1", 2000),
)  # fmt: skip
"""Of the tool about its own axes, both ways, and how long the key is held in ms."""


def hand_eye(page: Any, console: Any, address: str) -> None:
    page.goto(f"{address}/calibrate")
    console.measuring(page)
    console.rests(page)
    page.locator("[data-testid=override]").fill("100")
    page.click("[data-testid=step-handeye]")
    page.click("[data-testid=jog-tool]")
    accept(page)
    for axis, for_ms in TURNS:
        console.jog(page, f"tool:{axis}", for_ms)
        accept(page)
    trusted(page)
    page.click("[data-testid=use]")
    page.wait_for_selector("text=In use")


def identify(page: Any, console: Any, address: str) -> None:
    """Sweep the first three joints: the others are as the page says of those left out, and take as long again."""
    page.goto(f"{address}/identify")
    console.measuring(page)
    page.get_by_label("Readings per joint").fill("4")
    for label, inwards in (("From (deg)", 5.0), ("To (deg)", -5.0)):  # half the range goes twice as fast
        for field in page.get_by_label(label).all()[:3]:
            field.fill(f"{float(field.input_value()) + inwards:.1f}")
    for joint in (6, 5, 4):
        page.click(f"[data-testid=sweep-{joint}]")
    page.click("[data-testid=expect]")
    page.wait_for_selector("text=What these ranges will tell")
    for _ in range(3):
        page.click("[data-testid=identify-run]")
        page.click("[data-testid=yes]:visible")
        if console.held(page, "The arm is kept in"):
            return
    raise AssertionError(page.inner_text("[data-testid=work]"))
