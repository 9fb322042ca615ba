"""The robot in the console: a first-time user's whole way on the simulated cell, and whatever must stop the arm."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = "/usr/bin/chromium"

pytestmark = [
    pytest.mark.skipif(not Path(CHROMIUM).exists(), reason="no Chromium on this machine"),
    pytest.mark.timeout(300),
]


@pytest.fixture(scope="module")
def cell(console: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The console of the simulated cell, as `make demo` names it."""
    folder = tmp_path_factory.mktemp("operator") / "cell"
    address, process = console.begin(folder, "--robot", "sim:webcam-cell")
    yield address, folder
    console.end(process)


def measuring(page: Any) -> None:
    page.wait_for_function("document.querySelector('[data-testid=state]').textContent.includes('Measuring')")


def robot_says(page: Any, words: str) -> None:
    page.wait_for_function(
        "words => document.querySelector('[data-testid=robot-state]').textContent.includes(words)", arg=words
    )


def hold_key(page: Any, key: str, for_ms: int) -> None:
    """Hold a jog key with the pointer."""
    button = page.locator(f"[data-jog='{key}']")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.wait_for_timeout(for_ms)
    page.mouse.up()
    robot_says(page, "stands")


def joint(page: Any, number: int) -> float:
    return float(page.inner_text(f".jog .axis:nth-child({number}) span").split()[2])


def full_speed(page: Any) -> None:
    page.locator("[data-testid=override]").fill("100")


def test_a_jog_key_moves_the_arm_and_escape_stops_it(browser: Any, console: Any, cell: tuple[str, Path]) -> None:
    page = console.opened(browser, f"{cell[0]}/live")
    measuring(page)
    before = joint(page, 6)
    hold_key(page, "joints:5:1", 700)
    page.wait_for_function(
        "q => parseFloat(document.querySelector('.jog .axis:nth-child(6) span').textContent.split(' ')[3]) > q + 1",
        arg=before,
    )
    page.keyboard.press("Escape")
    robot_says(page, "is stopped")
    page.click("[data-testid=reset]")
    robot_says(page, "stands")
    page.close()


def test_a_second_operator_is_told_who_drives_and_a_lost_page_stops_the_arm(
    browser: Any, console: Any, cell: tuple[str, Path]
) -> None:
    page, other = (console.opened(browser, f"{cell[0]}/settings") for _ in range(2))
    robot_says(page, "stands")
    page.focus("[data-testid=enable]")
    page.keyboard.down(" ")
    page.wait_for_selector("[data-testid=enable][data-alive=true]")
    robot_says(other, "drives; you can watch, and stop")
    other.focus("[data-testid=enable]")
    other.keyboard.down(" ")
    other.wait_for_function("document.getElementById('robot-refused').textContent.includes('drives')")
    other.keyboard.up(" ")
    page.wait_for_selector("[data-testid=enable][data-alive=true]")
    page.evaluate("() => { const end = performance.now() + 3000; while (performance.now() < end); }")  # it hangs
    robot_says(other, "is stopped")
    other.click("[data-testid=reset]")
    robot_says(other, "stands")
    other.close()


def test_a_phone_shows_the_stop_without_scrolling_sideways(browser: Any, console: Any, cell: tuple[str, Path]) -> None:
    page = console.opened(browser, f"{cell[0]}/live", width=390)
    box = page.locator("[data-testid=stop]").bounding_box()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert box["x"] >= 0 and box["x"] + box["width"] <= 390 and box["height"] >= 44
    page.close()


@pytest.mark.parametrize("name", ["live", "identify", "teach"])
def test_pages_of_the_robot_have_no_serious_fault_of_accessibility(
    browser: Any, console: Any, cell: tuple[str, Path], name: str
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    page = console.opened(browser, f"{cell[0]}/{name}")
    page.wait_for_selector("[data-jog]")
    found = Axe().run(page).response["violations"]
    serious = [
        (fault["id"], [node["html"][:200] for node in fault["nodes"]][:3])
        for fault in found
        if fault["impact"] in ("serious", "critical")
    ]
    assert serious == []
    page.close()


@pytest.mark.skipif(
    "ARMSIGHT_ALONE" not in os.environ,
    reason="a simulated robot in real time, cameras and a browser need both cores for themselves: set ARMSIGHT_ALONE=1",
)
def test_a_user_identifies_teaches_and_plays(browser: Any, console: Any, cell: tuple[str, Path]) -> None:
    """Identify, teach a trapezium, check, play, and the reports of it all."""
    address, folder = cell
    page = console.opened(browser, f"{address}/live")
    measuring(page)
    full_speed(page)
    page.goto(f"{address}/identify")
    identify(page)
    assert (folder / "identify" / "arm.yaml").exists()
    page.goto(f"{address}/teach")
    teach(page)
    play(page)
    assert list(folder.glob("played-*/play.mcap"))
    page.goto(f"{address}/verify")
    for name in ("path-check.html", "identify/arm.report.html"):
        page.wait_for_selector(f"text={name}")
    page.close()


def identify(page: Any) -> None:
    page.wait_for_selector("[data-testid=expect]")
    page.get_by_label("Readings per joint").fill("4")
    page.click("[data-testid=expect]")
    page.wait_for_selector("text=What these ranges will tell")
    page.click("[data-testid=identify-run]")
    page.click("[data-testid=yes]:visible")
    held(page, "text=The arm is kept in")


def teach(page: Any) -> None:
    page.click("[data-testid=jog-base]")
    for taken, key in enumerate((None, "base:2:1", "base:1:1", "base:2:-1"), start=1):
        if key is not None:
            hold_key(page, key, 900)
        measuring(page)
        page.click("[data-testid=point]")
        page.wait_for_function(
            "n => document.querySelector('[data-testid=taught]').textContent.startsWith(`${n} poses`)", arg=taken
        )
    page.click("[data-testid=save]")
    page.wait_for_selector("text=/4 places over/")
    page.click("[data-testid=change]")
    page.wait_for_selector("text=/[1-9][0-9] places over/")


def play(page: Any) -> None:
    page.get_by_label("Speed along the path").fill("40")
    page.click("[data-testid=check]")
    page.wait_for_selector("text=The arm can run this path")
    page.click("[data-testid=play]")
    page.click("[data-testid=yes]:visible")
    held(page, "text=/Played: /")
    assert "Played: 100%" in page.inner_text("[data-testid=verdict]")


def held(page: Any, until: str) -> None:
    """Hold the enable by the keyboard until something is shown."""
    page.focus("[data-testid=enable]")
    page.keyboard.down(" ")
    page.wait_for_selector(until, timeout=240_000)
    page.keyboard.up(" ")
