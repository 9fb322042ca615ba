"""The console in a real browser (Debian's Chromium): what a person sees and does, on simulated pictures."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armsight.errors import NotEnoughData
from armsight.store.recording import Recording

COUNT = 12
"""Pairs of the scene that is played."""
CUT = """() => [...document.querySelectorAll(".q-field__label")]
  .filter((label) => label.scrollWidth > label.clientWidth + 1).map((label) => label.textContent)"""

pytestmark = pytest.mark.timeout(300)


def serve(console: Any, folder: Path, left: Path, right: Path, *more: str) -> tuple[str, Any]:
    """Start the console on files that are played again and again; return its address."""
    return console.begin(folder, "--left", str(left), "--right", str(right), "--play-again", *more)


@pytest.fixture(scope="module")
def cell_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cell")


@pytest.fixture(scope="module")
def lights(request: pytest.FixtureRequest, cell_folder: Path) -> Iterator[str]:
    """The console of a cell whose cameras see a lit target."""
    scene, folder = request.getfixturevalue("scene"), cell_folder
    for name in ("rig.yaml", "target.yaml"):
        shutil.copy(scene.folder / name, folder / name)
    more = ("--rig", "rig.yaml", "--target", "target.yaml")
    address, process = serve(
        request.getfixturevalue("console"), folder, scene.folder / "left", scene.folder / "right", *more
    )
    yield address
    request.getfixturevalue("console").end(process)


def shown(page: Any, more_than: int = 0) -> None:
    """Wait until both cameras have shown more pictures than this."""
    for side in ("left", "right"):
        page.wait_for_function(
            "([side, n]) => Number(document.querySelector(`[data-testid=camera-${side}]`)?.dataset.shown || 0) > n",
            arg=[side, more_than],
        )


def test_live_shows_pictures_and_the_pose_with_its_uncertainty_and_nothing_from_elsewhere(
    browser: Any, console: Any, lights: str
) -> None:
    """A cell is often offline: every file the page asks for is the console's own."""
    page = console.opened(browser, f"{lights}/live")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.reload(wait_until="domcontentloaded")
    shown(page, 10)
    page.wait_for_function("document.querySelector('[data-testid=state]').textContent.includes('Measuring')")
    page.wait_for_function("document.querySelector('[data-testid=pose-z]').textContent.includes(' ')")
    z_mm = float(page.inner_text("[data-testid=pose-z]").split()[0])
    assert 599.0 < z_mm < 612.5, "the target moves from 600 to 611 mm"
    for name in ("pose-x", "pose-y", "pose-rx", "pose-ry", "pose-rz", "fps", "latency", "scene", "record"):
        assert page.locator(f"[data-testid={name}]").count() == 1
    assert "1 σ" in page.inner_text("main")
    own = (lights, lights.replace("http", "ws", 1), "blob:", "data:")
    assert len(asked) > 2 and [url for url in asked if not url.startswith(own)] == []
    page.close()


def recorded(page: Any) -> int:
    """Return how many pairs are in the recording that runs."""
    words = page.wait_for_selector("text=/Recording recording-.*: [1-9]/").inner_text()
    return int(words.split(": ")[1].split()[0])


def dropped(recording: Recording) -> int:
    """Return how many pairs a recording says that it had no time for."""
    try:
        told = [re.match(r"(\d+) pairs dropped", event.message) for event in recording.events()]
    except NotEnoughData:  # nothing happened
        return 0
    return sum(int(one[1]) for one in told if one)


def test_a_reload_in_the_middle_of_a_recording_loses_nothing(
    browser: Any, console: Any, lights: str, cell_folder: Path
) -> None:
    """Every pair of files of COUNT that are played again and again is in it, in turn, in both cameras.

    But those that a machine with other work had no time for, which the recording tells itself.
    """
    page = console.opened(browser, f"{lights}/live")
    shown(page)
    page.click("[data-testid=record]")
    before = recorded(page)
    for _ in range(2):
        page.reload()
        page.wait_for_function(
            "n => Number(document.body.innerText.match(/Recording recording-.*: (\\d+) of each/)?.[1] || 0) > n",
            arg=before + COUNT,
        )
        before = recorded(page)
    page.click("[data-testid=record]")
    page.wait_for_selector("text=/Recorded .*mcap/")
    page.close()
    (file,) = cell_folder.glob("recording-*.mcap")
    with Recording(file) as recording:
        for side in ("left", "right"):
            numbers = np.array([frame.sequence for frame in recording.frames(side)])
            assert len(numbers) > before
            missing = int(((np.diff(numbers) - 1) % COUNT).sum())
            assert missing <= dropped(recording), f"{side}: {missing} frames are missing"


def test_pages_have_no_serious_fault_of_accessibility(browser: Any, console: Any, lights: str) -> None:
    """And a phone shows each without scrolling sideways, and names of fields in full."""
    page = console.opened(browser, f"{lights}/live")
    shown(page)
    for name in ("live", "calibrate", "verify", "settings"):
        page.set_viewport_size({"width": 1400, "height": 900})
        page.goto(f"{lights}/{name}", wait_until="domcontentloaded")
        page.wait_for_selector("[data-testid=state]")
        for scheme in ("light", "dark"):
            assert console.faults(page, scheme) == [], (name, scheme)
        page.set_viewport_size({"width": 390, "height": 900})
        page.wait_for_function("document.documentElement.scrollWidth <= 390")
        assert page.evaluate(CUT) == [], name
    page.close()
