"""The guided step Mirrors in a real browser: which mirror to turn, a sample, and a page that anybody can use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from armsight.optics import Camera
from armsight.store import write_camera
from armsight.store.cell_file import CellFile, CellMirrors, write_cell

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def cell(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The console of one camera with mirrors, of which mirror 2 is off."""
    made, folder = request.getfixturevalue("mirror_boards"), tmp_path_factory.mktemp("mirrors")
    write_camera(folder / "camera.yaml", Camera.pinhole(640, 480, *made.camera))
    built = CellMirrors(baseline_m=made.baseline_m)
    write_cell(folder, CellFile(left=str(made.off), board=made.board, camera="camera.yaml", mirrors=built, fps=2.0))
    console = request.getfixturevalue("console")
    address, process = console.begin(folder, "--play-again")
    yield address
    console.end(process)


def test_a_mirror_that_is_off_is_named_and_a_sample_is_taken(browser: Any, console: Any, cell: str) -> None:
    page = console.opened(browser, f"{cell}/calibrate")
    page.wait_for_selector("canvas[data-side=complex][data-shown]")
    page.wait_for_function("document.querySelector('[data-testid=turn-0]').textContent.startsWith('Mirror 2: turn')")
    assert "anticlockwise" in page.inner_text("[data-testid=turn-0]")
    page.click("[data-testid=accept]:not([disabled])")
    page.wait_for_selector("td button")
    page.click("td button")
    page.wait_for_function("document.querySelectorAll('td button').length === 0")
    assert "Hold the board" in page.inner_text("[data-testid=hint]")
    page.fill("[data-testid=mirrors-baseline_m]", "")
    page.click("[data-testid=mirrors-keep]")
    page.wait_for_function(
        "document.querySelector('[data-testid=alignment]').textContent.includes('Which way to turn')"
    )
    page.fill("[data-testid=mirrors-baseline_m]", "160")
    page.click("[data-testid=mirrors-keep]")
    page.wait_for_function("document.querySelector('[data-testid=turn-0]').textContent.startsWith('Mirror 2: turn')")
    page.close()


def test_its_page_has_no_serious_fault_and_fits_a_phone(browser: Any, console: Any, cell: str) -> None:
    page = console.opened(browser, f"{cell}/calibrate", width=390)
    page.wait_for_selector("[data-testid=alignment]:not(:empty)")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for scheme in ("light", "dark"):
        assert console.faults(page, scheme) == [], scheme
    page.goto(f"{cell}/live")
    page.wait_for_selector("[data-testid=camera-complex]")
    assert page.locator("[data-testid=camera-left]").count() == 0
    page.close()
