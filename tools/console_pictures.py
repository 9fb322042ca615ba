"""Make docs/images/console-*.png anew: the console of the simulated cell as a person has it before them.

    python tools/console_pictures.py [FOLDER]

Needs Debian's Chromium. A path is taught with the jog keys, so that there is one to see.
"""

from __future__ import annotations

import importlib
import io
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from armsight.store.cell_file import CellFile, CellMirrors, write_cell

CHROMIUM = "/usr/bin/chromium"
FOLDER = Path("docs/images")
LARGEST_BYTES = 150_000
PATIENCE_MS = 180_000
TESTS = Path(__file__).resolve().parent.parent / "tests"


@contextmanager
def served(folder: Path, *more: str) -> Iterator[str]:
    """Serve the console of a folder; give its address. more: flags, such as --robot."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "armsight", "console", *more, "--folder", str(folder), "--port", str(port)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        for line in process.stderr or ():
            if "Open http" in line:
                break
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(60)


def save(page: Any, file: Path) -> None:
    """Write what the page shows as a PNG, with as many colours and as large as LARGEST_BYTES holds."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    for share, colours in ((1.0, 256), (0.8, 128), (0.8, 64), (0.65, 64), (0.5, 64)):
        size = (round(share * picture.width), round(share * picture.height))
        small = picture.resize(size, Image.Resampling.LANCZOS)
        few = small.quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)  # keeps rare colours
        few.save(file, optimize=True)
        if file.stat().st_size <= LARGEST_BYTES:
            break
    print(f"{file}: {file.stat().st_size / 1000:.0f} kB")


def hold(page: Any, key: str, for_ms: int) -> None:
    """Hold a jog key."""
    button = page.locator(f"[data-jog='{key}']")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.wait_for_timeout(for_ms)
    page.mouse.up()
    page.wait_for_timeout(1500)


def opened(browser: Any, address: str, width: int, height: int) -> Any:
    """Return a page on which the target is measured."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address, wait_until="domcontentloaded")
    page.wait_for_function("document.querySelector('[data-testid=state]')?.textContent.includes('Measuring')")
    page.wait_for_timeout(4000)
    return page


def main(out: Path) -> None:
    """Take all pictures."""
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        take_mirrors(browser, out)
        take_cell(browser, out)
        take_robot(browser, out)
        browser.close()


def take_mirrors(browser: Any, out: Path) -> None:
    """Take the step Mirrors of a simulated mirror rig, whose mirrors stand a little off."""
    with tempfile.TemporaryDirectory() as made:
        pictures, folder = Path(made) / "set", Path(made) / "cell"
        subprocess.run([sys.executable, "-m", "armsight", "simulate", "mirrors", "-o", str(pictures)], check=True)
        folder.mkdir()
        shutil.copy(pictures / "camera.yaml", folder / "camera.yaml")
        cell = CellFile(
            camera="camera.yaml", board="checkerboard:7x5:0.015", mirrors=CellMirrors(baseline_m=0.12), fps=1
        )
        write_cell(folder, cell)
        with served(folder, "--left", str(pictures / "complex"), "--play-again") as address:
            page = browser.new_page(viewport={"width": 1280, "height": 1400})
            page.set_default_timeout(PATIENCE_MS)
            page.goto(f"{address}/calibrate", wait_until="domcontentloaded")
            page.wait_for_selector("canvas[data-shown]")
            for _ in range(7):
                page.wait_for_timeout(1100)
                page.click("[data-testid=accept]:not([disabled])")
            page.wait_for_selector("[data-testid=accept]:not([disabled])")
            page.wait_for_timeout(1500)
            page.evaluate("window.scrollTo(0, 0)")
            save(page, out / "console-mirrors.png")
            page.close()


def take_cell(browser: Any, out: Path) -> None:
    """Take the page Cell while it records lights that two webcams see."""
    with tempfile.TemporaryDirectory() as made:
        home, folder = Path(made), Path(made) / "my-cell"
        sys.path.insert(0, str(TESTS))
        drawing: Any = importlib.import_module("drawn_cell")
        drawn = drawing.drawn_cell(home / "set", frames=1500)
        for side in drawing.SIDES:
            (home / side).mkdir()
            for k, image in enumerate(drawn.images(side)):
                Image.fromarray(image).save(home / side / f"{k:04d}.png", compress_level=1)
        folder.mkdir()
        for name in ("target.yaml", "arm.yaml", "joints.csv"):
            shutil.copy(home / "set" / name, folder / name)
        left, right = (str(home / side) for side in drawing.SIDES)
        write_cell(folder, CellFile(left=left, right=right, target="target.yaml", arm="arm.yaml", fps=drawing.FPS))
        with served(folder) as address:
            page = browser.new_page(viewport={"width": 1280, "height": 1500})
            page.set_default_timeout(PATIENCE_MS)
            page.goto(f"{address}/cell", wait_until="domcontentloaded")
            page.wait_for_selector("[data-testid=lamp-lights][data-level=good]")
            page.click("[data-testid=record-cell]")
            page.wait_for_timeout(22_000)
            page.evaluate("window.scrollTo(0, 0)")
            save(page, out / "console-cell.png")
            page.close()


def take_robot(browser: Any, out: Path) -> None:
    """Take the pages of the simulated cell with its robot."""
    with (
        tempfile.TemporaryDirectory() as folder,
        served(Path(folder) / "cell", "--robot", "sim:webcam-cell") as address,
    ):
        save(opened(browser, f"{address}/live", 1280, 1100), out / "console-live.png")
        save(opened(browser, f"{address}/live", 390, 780), out / "console-phone.png")
        page = opened(browser, f"{address}/identify", 1280, 900)
        page.click("[data-testid=expect]")
        page.wait_for_selector("text=What these ranges will tell")
        page.evaluate("window.scrollTo(0, 0)")
        save(page, out / "console-identify.png")
        page = opened(browser, f"{address}/teach", 1280, 1000)
        page.locator("[data-testid=override]").fill("100")
        page.click("[data-testid=jog-base]")
        for key in (None, "base:2:1", "base:1:1", "base:2:-1"):
            if key is not None:
                hold(page, key, 1500)
            page.click("[data-testid=point]")
            page.wait_for_timeout(6000)
        page.click("[data-testid=save]")
        page.click("[data-testid=change]")
        page.click("[data-testid=check]")
        page.click("[data-testid=look-paths]")
        page.wait_for_timeout(5000)
        page.evaluate("window.scrollTo(0, 0)")
        save(page, out / "console-teach.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
