"""The robot in the console: jog keys, a second operator, and whatever must stop the arm."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def cell(console: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """The console of a simulated cell that leaves two busy cores time for two browsers' enables."""
    home = tmp_path_factory.mktemp("operator")
    console.small_cell(home / "small.yaml")
    folder = home / "cell"
    address, process = console.begin(folder, "--robot", f"sim:{home / 'small.yaml'}")
    yield address, folder
    console.end(process)


def joint(page: Any, number: int) -> float:
    return float(page.inner_text(f".jog .axis:nth-child({number}) span").split()[2])


@pytest.mark.alone
def test_a_jog_key_moves_the_arm_and_escape_stops_it(browser: Any, console: Any, cell: tuple[str, Path]) -> None:
    page = console.opened(browser, f"{cell[0]}/live")
    console.measuring(page)
    before = joint(page, 6)
    console.jog(page, "joints:5:1", 700)
    page.wait_for_function(
        "q => parseFloat(document.querySelector('.jog .axis:nth-child(6) span').textContent.split(' ')[3]) > q + 1",
        arg=before,
    )
    page.keyboard.press("Escape")
    console.robot_says(page, "is stopped")
    page.click("[data-testid=reset]")
    console.robot_says(page, "stands")
    page.close()


@pytest.mark.alone
def test_a_second_operator_is_told_who_drives_and_a_lost_page_stops_the_arm(
    browser: Any, console: Any, cell: tuple[str, Path]
) -> None:
    page, other = (console.opened(browser, f"{cell[0]}/settings") for _ in range(2))
    console.robot_says(page, "stands")
    page.focus("[data-testid=enable]")
    page.keyboard.down(" ")
    page.wait_for_selector("[data-testid=enable][data-alive=true]")
    console.robot_says(other, "drives; you can watch, and stop")
    other.focus("[data-testid=enable]")
    other.keyboard.down(" ")
    other.wait_for_function("document.getElementById('robot-refused').textContent.includes('drives')")
    other.keyboard.up(" ")
    page.wait_for_selector("[data-testid=enable][data-alive=true]")
    page.evaluate("() => { const end = performance.now() + 3000; while (performance.now() < end); }")  # it hangs
    console.robot_says(other, "is stopped")
    other.click("[data-testid=reset]")
    console.robot_says(other, "stands")
    other.close()


@pytest.mark.alone
def test_a_reload_while_a_path_is_recorded_loses_nothing(browser: Any, console: Any, cell: tuple[str, Path]) -> None:
    """It is one stretch to its end, and no moment between two of its poses was left out."""
    page = console.opened(browser, f"{cell[0]}/teach")
    console.measuring(page)
    page.click("[data-testid=record]")
    page.wait_for_selector("text=/Recording. [1-9]/")
    for _ in range(2):
        before = int(page.inner_text("[data-testid=taught]").split()[1])
        page.reload()
        page.wait_for_function("n => document.body.innerText.match(/Recording. (\\d+) poses/)?.[1] > n + 3", arg=before)
    page.click("[data-testid=record]")
    page.wait_for_selector("text=/^[1-9][0-9]* poses in 1 stretches/")
    taught = int(page.inner_text("[data-testid=taught]").split()[0])
    page.click("[data-testid=save]")
    page.wait_for_selector(f"text=/{taught} places over/")
    page.close()


def test_pages_of_the_robot_have_no_serious_fault_of_accessibility_and_a_phone_shows_the_stop(
    browser: Any, console: Any, cell: tuple[str, Path]
) -> None:
    page = console.opened(browser, f"{cell[0]}/teach")
    for name in ("teach", "identify", "live"):
        page.goto(f"{cell[0]}/{name}", wait_until="domcontentloaded")
        page.wait_for_selector("[data-jog]")
        assert console.faults(page, "light") == [], name
    page.set_viewport_size({"width": 390, "height": 900})
    page.wait_for_function("document.documentElement.scrollWidth <= 390")
    box = page.locator("[data-testid=stop]").bounding_box()
    assert box["x"] >= 0 and box["x"] + box["width"] <= 390 and box["height"] >= 44
    page.close()
