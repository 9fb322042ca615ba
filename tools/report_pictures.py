"""Pictures of reports wide and on a telephone, light and dark, and as printed.

    report_pictures.py OUT                     every kind, from data that is simulated for it
    report_pictures.py OUT --kind iso9283 ...  some kinds
    report_pictures.py OUT REPORT...           reports that are there

Prints each report's bytes and how wide its page is; ends with 1 where one is too large, too wide or breaks.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from typer.testing import CliRunner

from armsight.cli.commands import app
from report_kinds import KINDS

CHROMIUM = "/usr/bin/chromium"
WIDTHS = (1400, 390)
SCHEMES = ("light", "dark")
GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
LARGEST_BYTES = 1_500_000
SHEET_PX: ViewportSize = {"width": 794, "height": 1123}
TALLEST_PX = 8_000
"""Chromium repeats its picture in a screenshot that is taller than its largest texture."""


def main() -> int:
    """Write the pictures; return 1 where a report is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("reports", type=Path, nargs="*")
    parser.add_argument("--kind", action="append", choices=sorted(KINDS), default=[])
    asked = parser.parse_args()
    out = asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    reports, broken = [path.resolve() for path in asked.reports], 0
    for kind in asked.kind or (() if reports else KINDS):
        try:
            reports += _made(kind, out / "made" / kind)
        except RuntimeError as error:
            broken += 1
            print(error, flush=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GL)
        for report in reports:
            broken += _pictures(browser, report, out)
        browser.close()
    print(f"{len(reports)} reports, {broken} that are not as they should be.")
    return min(broken, 1)


def _made(kind: str, folder: Path) -> list[Path]:
    """Return the reports of a kind, made anew. Raises RuntimeError where a command ends with an error."""
    if not (folder / "done").exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for step in KINDS[kind]:
            if not isinstance(step, str):
                step(folder)
                continue
            with _inside(folder):
                run = CliRunner().invoke(app, step.split())
            if run.exit_code:
                raise RuntimeError(f"{kind}: armsight {step}\n{run.output[-800:]}")
        (folder / "done").write_text("")
    return sorted(folder.rglob("*.html"))


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _pictures(browser: Browser, report: Path, out: Path) -> bool:
    """Write a PNG for each width and scheme and the printed pages; return whether something is wrong."""
    made = out / "made"
    parts = report.relative_to(made).parts if report.is_relative_to(made) else (report.parent.name, report.name)
    name = "-".join(parts).removesuffix(".html").replace(".", "-")
    size = report.stat().st_size
    wrong = [f"larger than {LARGEST_BYTES:,} bytes"] if size > LARGEST_BYTES else []
    for width in WIDTHS:
        for scheme in SCHEMES:
            wrong += _picture(browser, report, out / f"{name}-{width}-{scheme}.png", width, scheme)
    print(f"{name}: {size:,} bytes. {'; '.join(wrong) or 'Fits.'}", flush=True)
    return bool(wrong)


def _picture(browser: Browser, report: Path, picture: Path, width: int, scheme: str) -> list[str]:
    wrong: list[str] = []
    page = browser.new_page(
        viewport={"width": width, "height": 900}, color_scheme="dark" if scheme == "dark" else "light"
    )
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(report.as_uri())
    page.wait_for_selector("html[data-drawn]", state="attached", timeout=120_000)
    page.wait_for_timeout(700)  # WebGL draws after the script has ended
    tall = min(int(page.evaluate("document.documentElement.scrollHeight")), TALLEST_PX)
    page.screenshot(path=picture, full_page=True, clip={"x": 0, "y": 0, "width": width, "height": tall})
    wide = int(page.evaluate("document.documentElement.scrollWidth"))
    if wide > width:
        wrong.append(f"{wide} px wide in {width} px, {scheme}")
    if (width, scheme) == (WIDTHS[0], SCHEMES[0]):
        _printed(page, picture.with_name(picture.name.replace(f"-{width}-{scheme}.png", "-print.pdf")))
    page.close()
    return wrong


def _printed(page: Page, pdf: Path) -> None:
    """Print the page to PDF; and a picture of it in the style for print, as wide as the sheet."""
    page.pdf(path=pdf, format="A4", print_background=True)
    page.set_viewport_size(SHEET_PX)
    page.emulate_media(media="print")
    page.wait_for_timeout(500)
    page.screenshot(path=pdf.with_suffix(".png"), full_page=True)


if __name__ == "__main__":
    sys.exit(main())
