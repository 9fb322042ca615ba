"""A report as PDF, printed by a browser of this machine: its plots are drawn by the page's own scripts."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from armsight.errors import BadFile, DeviceFailed, DeviceNotFound, UsageError
from armsight.store.atomic import write_bytes

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
"""Looked for in this order: all print without a window by the same flags."""
ELSEWHERE = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
"""Where they are on systems that do not put them on the path."""
CHOSEN = "ARMSIGHT_BROWSER"
PATIENCE_S = 180.0
"""A report of six views in space took 17 s on two busy cores, without a graphics card."""
FLAGS = (
    "--headless",
    "--disable-gpu",
    "--use-angle=swiftshader",  # views in space are drawn by WebGL, here without a graphics card
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--no-pdf-header-footer",
    "--virtual-time-budget=30000",  # the page's clock runs on until its scripts have drawn
)
MARK = "armsight "
"""In the foot of every report: other pages are not printed, for they could load what they like."""


def print_report(report: Path, out: Path | None = None) -> Path:
    """Print a report (its file, or the folder that holds report.html) as PDF and return the PDF's path.

    out: else beside the report, under its name. Raises BadFile for what is no report, DeviceNotFound where there is no
    browser, DeviceFailed where it does not print.
    """
    page = report / "report.html" if report.is_dir() else report
    out = page.with_suffix(".pdf") if out is None else out
    if out.suffix.lower() != ".pdf":
        raise UsageError(f"{out} is no name of a PDF", cure="Let it end in .pdf")
    if not page.is_file():
        raise BadFile(f"{page}: there is no such file", consequence="Nothing is printed", cure="Check its name")
    if not _is_report(page):
        raise BadFile(
            f"{page} is no report of armsight's",
            consequence="Nothing is printed",
            cure="Give a report.html, or the folder that it is in",
        )
    browser = find_browser()
    with tempfile.TemporaryDirectory(prefix="armsight-") as folder:
        made = Path(folder) / "report.pdf"
        # a browser of the system's own packages may see nothing but its home and /tmp: the page goes there
        shutil.copyfile(page, Path(folder) / "report.html")
        _run([browser, *FLAGS, *_as_root(), f"--user-data-dir={folder}/profile", f"--print-to-pdf={made}"], folder)
        if not made.is_file() or not made.read_bytes().startswith(b"%PDF"):
            raise _not_printed(browser, "wrote no PDF")
        write_bytes(out, made.read_bytes())
    return out


def find_browser() -> str:
    """Return the browser that prints: $ARMSIGHT_BROWSER, else the first that is here. Raises DeviceNotFound."""
    chosen = os.environ.get(CHOSEN)
    for name in (chosen,) if chosen else (*BROWSERS, *ELSEWHERE):
        found = shutil.which(name)
        if found is not None:
            return found
    raise DeviceNotFound(
        f"{chosen} is not here" if chosen else "no Chromium, Chrome or Edge is here",
        consequence="Nothing is printed",
        cure=f"Install one (apt install chromium), name it in {CHOSEN}, or open the report and print it from there",
    )


def _is_report(page: Path) -> bool:
    text = page.read_text(encoding="utf-8", errors="replace")
    return text.startswith("<!doctype html>") and f"<footer>{MARK}" in text


def _as_root() -> tuple[str, ...]:
    """Return what lets a browser start as root, as in containers: the page is armsight's own and loads nothing."""
    return ("--no-sandbox",) if getattr(os, "geteuid", lambda: 1)() == 0 else ()


def _run(command: list[str], folder: str) -> None:
    try:
        subprocess.run(
            [*command, (Path(folder) / "report.html").as_uri()], capture_output=True, timeout=PATIENCE_S, check=True
        )
    except subprocess.TimeoutExpired:
        raise _not_printed(command[0], f"did not end within {PATIENCE_S:.0f} s") from None
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", b"") or b""
        last = said.decode(errors="replace").strip().splitlines()[-1:] or [str(error)]
        raise _not_printed(command[0], f"failed: {last[0][:200]}") from error


def _not_printed(browser: str, why: str) -> DeviceFailed:
    return DeviceFailed(
        f"{browser} {why}",
        consequence="There is no PDF",
        cure="Open the report in a browser and print it from there, or name another in " + CHOSEN,
    )
