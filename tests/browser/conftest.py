"""What tests of the console share: one browser, starting the console as a person does, and a page of it."""

from __future__ import annotations

import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import warm_python
from armsight.ops.simulation.scenarios import build_world, load_scenario, scenario_text

CHROMIUM = "/usr/bin/chromium"
PATIENCE_MS = 150_000
WORK_MS = 240_000
FIRST = ["nice", "-n", "-10"]
"""A cell's computer does nothing else, and browsers run on others: here both go before the tests beside them, where
the system lets them; else `nice` says so and goes on."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests of this folder where there is no browser."""
    for item in items if not Path(CHROMIUM).exists() else ():
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason="no Chromium on this machine"))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def begin(
    folder: Path, *more: str, meanwhile: Callable[[str], object] | None = None
) -> tuple[str, subprocess.Popen[bytes]]:
    """Start the console as a person does; return its address. meanwhile: is called with it from the first answer on."""
    port = free_port()
    command = [*FIRST, str(warm_python.commands() / "armsight"), "console", "--folder", str(folder)]
    process = subprocess.Popen([*command, "--port", str(port), *more], stderr=subprocess.PIPE)
    assert process.stderr is not None
    if meanwhile is not None:
        listening(port)
        meanwhile(f"http://127.0.0.1:{port}")
    said = b""
    while b"Open http://" not in said:
        line = process.stderr.readline()
        assert line, said.decode()
        said += line
    listening(port)
    return f"http://127.0.0.1:{port}", process


def listening(port: int) -> None:
    """Return when somebody answers on a port; fails where nobody comes."""
    pause = threading.Event()
    for _ in range(600):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        pause.wait(0.05)
    raise AssertionError(f"nobody listens on port {port}")


def end(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGINT)
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    finally:
        if process.stderr is not None:
            process.stderr.close()


def opened(browser: Any, address: str, *, width: int = 1400, dark: bool = False) -> Any:
    """Return a page, loaded, that fails the test where its scripts do."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address, wait_until="domcontentloaded")
    page.wait_for_selector("[data-testid=state]")
    return page


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    script = tmp_path_factory.mktemp("browser") / "chromium"
    script.write_text(f'#!/bin/sh\nexec {" ".join(FIRST)} {CHROMIUM} "$@"\n')
    script.chmod(0o755)
    with sync_playwright() as player:
        made = player.chromium.launch(executable_path=str(script), args=["--no-sandbox"])
        yield made
        made.close()


def small_cell(file: Path) -> Any:
    """Write the built-in cell with half its pixels and half its controller's pace, for two cores; return its world."""
    text = scenario_text("webcam-cell")
    assert text is not None
    cell = yaml.safe_load(text[0])
    cameras = cell["cameras"]
    cameras |= {"width": cameras["width"] // 2, "height": cameras["height"] // 2, "pipeline": "ideal"}
    for side in ("left", "right"):
        lens = cameras[side]
        lens |= {"fx": lens["fx"] / 2, "fy": lens["fy"] / 2}
        lens |= {"cx": (lens["cx"] - 0.5) / 2, "cy": (lens["cy"] - 0.5) / 2}
    cell |= {"fps": 12.0, "room": "dark"}
    cell["arm"]["cycle_s"] = 0.016
    cell["target"]["sigma_px"] = 1.5
    cameras["sensor"]["hot_pixels"] = 0
    file.write_text(yaml.safe_dump(cell))
    return build_world(str(file), load_scenario(str(file))[0], seed=None, frames=1)


def measuring(page: Any) -> None:
    """Wait until the target is measured."""
    page.wait_for_function("document.querySelector('[data-testid=state]')?.textContent.includes('Measuring')")


def robot_says(page: Any, words: str) -> None:
    """Wait for words of the robot's lamp."""
    page.wait_for_function(
        "words => document.querySelector('[data-testid=robot-state]').textContent.includes(words)", arg=words
    )


def rests(page: Any) -> None:
    """Wait until the robot stands; release the stop where a slow machine lost the page, as a person would."""
    page.wait_for_function("/stands|is stopped/.test(document.querySelector('[data-testid=robot-state]').textContent)")
    if "is stopped" in page.inner_text("[data-testid=robot-state]"):
        page.click("[data-testid=reset]")
    robot_says(page, "stands")


def jog(page: Any, key: str, for_ms: int) -> None:
    """Hold a jog key with the pointer until the robot has moved for so long, then let it come to rest.

    Where the page says that the enable has to be held anew, it is.
    """
    for _ in range(10):
        button = page.locator(f"[data-jog='{key}']")
        button.scroll_into_view_if_needed()
        box = button.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.wait_for_function(
            "/moves|is stopped/.test(document.querySelector('[data-testid=robot-state]').textContent)"
            " || document.getElementById('robot-refused').textContent !== ''"
        )
        moved = "moves" in page.inner_text("[data-testid=robot-state]")
        if moved:
            page.wait_for_timeout(for_ms)
        page.mouse.up()
        rests(page)
        if moved:
            return
    raise AssertionError(f"{key} never moved the robot: {page.inner_text('#robot-refused')}")


HELD = """words => {
  const said = (selector) => document.querySelector(selector)?.textContent || "";
  if (said("[data-testid=verdict]").includes(words)) return "done";
  if (document.querySelector("[data-testid=work][data-level=bad]")) return "ended";
  if (!document.querySelector("[data-testid=reset]").hidden || said("#robot-refused")) return "let go";
  return null;
}"""


def held(page: Any, words: str) -> bool:
    """Hold the enable by the keyboard until the verdict has these words, anew wherever the page asks for it.

    Return False where the work ended before.
    """
    while True:
        page.focus("[data-testid=enable]")
        page.keyboard.down(" ")
        came = page.wait_for_function(HELD, arg=words, timeout=WORK_MS, polling=100).json_value()
        page.keyboard.up(" ")
        rests(page)
        if came != "let go":
            return bool(came == "done")


def faults(page: Any, scheme: str) -> list[tuple[str, list[str]]]:
    """Return the serious faults of accessibility that axe finds on a page, light or dark, with some of their places."""
    from axe_playwright_python.sync_playwright import Axe

    page.emulate_media(color_scheme=scheme)
    return [
        (fault["id"], [node["html"][:200] for node in fault["nodes"]][:3])
        for fault in Axe().run(page).response["violations"]
        if fault["impact"] in ("serious", "critical")
    ]


@pytest.fixture(scope="session")
def console() -> SimpleNamespace:
    """How a console is begun (folder, flags -> address, process) and ended, how a page is opened, what a person does on
    it with the robot, and a cell that two busy cores can draw."""
    return SimpleNamespace(
        begin=begin, end=end, opened=opened, measuring=measuring, robot_says=robot_says, rests=rests, jog=jog,
        held=held, small_cell=small_cell, faults=faults,
    )  # fmt: skip
