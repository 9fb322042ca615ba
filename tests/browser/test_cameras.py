"""A cell of four cameras in a real browser: a grid of named pictures, one that is unplugged, a phone, the steps."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from tests.truth.camera_ring import SIZE, pose, ring
from tests.truth.test_views import draw, setup_of

from armsight.console import texts
from armsight.store import write_rig, write_target

NAMES = ("c0", "c1", "c2", "c3")
UNPLUGGED, GONE, FRAMES, FPS = "c2", 8, 28, 4.0

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def cell(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The console of four films, one of which ends before the others."""
    folder, world, rng = tmp_path_factory.mktemp("cell"), ring(4), np.random.default_rng(4)
    setup, T = setup_of(world), pose(rng, tilt_rad=0.1)
    write_rig(folder / "rig.yaml", setup.rig)
    write_target(folder / "target.yaml", setup.target)
    films = {
        name: cv2.VideoWriter(str(folder / f"{name}.avi"), cv2.VideoWriter.fourcc(*"FFV1"), FPS, SIZE) for name in NAMES
    }
    for k in range(FRAMES):
        T[0, 3] += 0.004
        for name, frame in zip(NAMES, draw(world, T, rng), strict=True):
            if name != UNPLUGGED or k < GONE:
                films[name].write(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
    for film in films.values():
        film.release()
    kept = {"format": "armsight/cell", "version": 1, "rig": "rig.yaml", "target": "target.yaml", "fps": FPS}
    kept["cameras"] = {name: str(folder / f"{name}.avi") for name in NAMES}
    (folder / "cell.yaml").write_text(yaml.safe_dump(kept))
    console = request.getfixturevalue("console")
    address, process = console.begin(folder)
    yield address
    console.end(process)


def test_four_cameras_each_tell_what_they_see_and_one_that_is_lost_stops_no_other(
    browser: Any, console: Any, cell: str
) -> None:
    page = console.opened(browser, f"{cell}/live")
    for name in NAMES:
        page.wait_for_selector(f"[data-testid=camera-{name}][data-shown]")
    found = page.evaluate("[...document.querySelectorAll('canvas[data-side]')].map((c) => c.dataset.testid)")
    assert found == [f"camera-{name}" for name in NAMES], "in the rig's order, and no other"
    page.wait_for_selector(f"[data-testid=camera-{UNPLUGGED}][data-lost]")
    told = page.wait_for_selector("[data-testid=camera-lost]:not(:empty)").inner_text()
    assert UNPLUGGED in told and f"ends after {GONE} frames" in told and "start anew" in told
    page.wait_for_function(  # the films' end
        "document.querySelector('[data-testid=state]').textContent.includes('The frames have ended')"
    )
    for name in NAMES:
        words = page.inner_text(f"[data-testid=sees-{name}]")
        assert words.startswith("Lost: ") if name == UNPLUGGED else re.match("Sees [3-6] of 6 lights", words), words
    assert page.inner_text("[data-testid=cameras-seeing]") == "3 of 4"
    taken = re.findall(r"of (\d+) pictures", page.inner_text("main"))
    assert min(map(int, taken)) > GONE, "the others went on"
    page.close()


def test_its_pages_have_no_serious_fault_and_fit_a_phone(browser: Any, console: Any, cell: str) -> None:
    page = console.opened(browser, f"{cell}/live")
    page.wait_for_selector("[data-testid=camera-c3][data-shown]")
    for name in ("live", "calibrate", "cell", "settings"):
        page.set_viewport_size({"width": 1400, "height": 900})
        page.goto(f"{cell}/{name}", wait_until="domcontentloaded")
        page.wait_for_selector("[data-testid=state]")
        for scheme in ("light", "dark") if name == "live" else ("light",):
            assert console.faults(page, scheme) == [], (name, scheme)
        if name in ("calibrate", "cell"):
            titles = page.locator("main h3").all_inner_texts()
            assert [one for one in titles if one.startswith("Camera ")] == [f"Camera {one}" for one in NAMES]
        page.set_viewport_size({"width": 390, "height": 900})
        page.wait_for_function("document.documentElement.scrollWidth <= 390")
    assert "c3=" in page.input_value("[data-testid=field-cameras]")
    page.close()


def test_the_step_of_all_cameras_asks_for_a_board_and_says_which_camera_is_lost(
    browser: Any, console: Any, cell: str
) -> None:
    page = console.opened(browser, f"{cell}/calibrate")
    for name in (*(f"camera-{one}" for one in NAMES), "cameras"):
        assert page.locator(f"[data-testid=step-{name}]").count() == 1
    assert page.locator("[data-testid=step-stereo]").count() == 0
    assert page.inner_text("[data-testid=hint]") == texts.NEXT["show_board"]
    page.click("[data-testid=accept]")
    page.wait_for_function(
        "/no picture comes of c2/.test(document.querySelector('[data-testid=step-said]').textContent)"
    )
    page.close()
