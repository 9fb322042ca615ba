"""The page Cell on simulated pictures: mount, move, result; reloaded on the way, refused where something is missing."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from armsight.store import read_rig
from armsight.store.cell_file import CellFile, read_cell, write_cell
from drawn_cell import FPS, SIDES, drawn_cell

FRAMES_OF_SET = 1500
"""50 s, at the pace of which the pictures are played: 20 s are the least, and the browser has to open first."""
SECONDS = 21

pytestmark = [pytest.mark.alone, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell without a rig, whose cameras see the moving lights once."""
    home = tmp_path_factory.mktemp("cell")
    drawn, folder = drawn_cell(home / "set", frames=FRAMES_OF_SET), home / "cell"
    for side in SIDES:
        (home / side).mkdir()
        for k, image in enumerate(drawn.images(side)):
            cv2.imwrite(str(home / side / f"{k:04d}.bmp"), image)  # PNG takes a dozen times as long
    folder.mkdir()
    for name in ("target.yaml", "arm.yaml", "joints.csv"):
        shutil.copy(drawn.folder / name, folder / name)
    left, right = (str(home / side) for side in SIDES)
    write_cell(folder, CellFile(left=left, right=right, target="target.yaml", arm="arm.yaml", fps=FPS))
    return folder


@pytest.fixture(scope="module")
def address(console: Any, folder: Path) -> Iterator[str]:
    address, process = console.begin(folder)
    yield address
    console.end(process)


def lamp(page: Any, name: str, level: str) -> None:
    """Wait for the level of a lamp."""
    page.wait_for_selector(f"[data-testid=lamp-{name}][data-level={level}]")


def here(page: Any, n: int) -> None:
    """Wait until the page marks a step as the one that the person is at."""
    page.wait_for_selector(f"[data-testid=place-{n}][aria-current=step]")


def seconds(page: Any, wanted: int) -> None:
    """Wait until so many seconds are recorded."""
    page.wait_for_function(
        "n => Number(document.querySelector('[data-testid=recorded]')?.textContent.match(/(\\d+) s/)?.[1] || 0) >= n",
        arg=wanted,
    )


def calibrated(page: Any) -> str:
    """Calibrate; return the verdict and what stands below it."""
    page.click("[data-testid=calibrate]:not([disabled])")
    page.wait_for_selector("[data-testid=verdict]", timeout=240_000)
    return str(page.inner_text("section:has(> [data-testid=verdict])"))


def test_one_recording_leads_from_bare_cameras_to_a_cell_that_measures(
    browser: Any, console: Any, address: str, folder: Path
) -> None:
    page = console.opened(browser, f"{address}/cell")
    for name in ("cameras", "lights", "target", "arm"):
        lamp(page, name, "good")
    lamp(page, "joints", "idle")
    here(page, 2)
    page.dblclick("[data-testid=record-cell]")
    seconds(page, 3)
    page.reload()
    seconds(page, SECONDS)
    page.click("[data-testid=end-cell]:not([disabled])")
    page.wait_for_selector("[data-testid=sample]")
    here(page, 3)
    assert "log" in page.inner_text("[data-testid=hint]")
    covered = page.locator(".coverage span[data-level=good]")
    assert covered.count() >= 6, "the lights went through both pictures"
    refused = calibrated(page)
    assert "log" in refused and "missing" in refused and not list(folder.glob("cell-*/rig.yaml"))
    page.fill("[data-testid=log]", "joints.csv")
    page.click("[data-testid=calibrate]:not([disabled])")
    page.wait_for_selector("[data-testid=verdict][data-level=good]", timeout=240_000)
    words = page.inner_text("section:has(> [data-testid=verdict])")
    assert (
        words.index("The tip, as both cameras measure it") < words.index("Scale") < words.index("What it cannot tell")
    )
    with page.expect_popup() as opened:
        page.click("text=Report")
    opened.value.wait_for_selector("text=How well the tip is known, where")
    page.click("[data-testid=use]")
    page.wait_for_selector("text=In use")
    cell = read_cell(folder)
    (made,) = folder.glob("cell-*")
    used = {name: getattr(cell, name) for name in ("rig", "world", "target", "arm", "handeye")}
    assert used == {name: f"{made.name}/{name}.yaml" for name in used}
    assert abs(read_rig(made / "rig.yaml").baseline_m - 0.55) < 0.005, "the cameras stand 550 mm apart"
    page.goto(f"{address}/live")
    console.measuring(page)
    page.close()


def test_its_page_has_no_serious_fault_and_fits_a_phone(browser: Any, console: Any, address: str) -> None:
    page = console.opened(browser, f"{address}/cell")
    page.wait_for_selector("[data-testid=lamp-target][data-level=good]")
    for width in (1400, 390):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_function("width => document.documentElement.scrollWidth <= width", arg=width)
        for scheme in ("light", "dark"):
            assert console.faults(page, scheme) == [], (width, scheme)
    page.close()
