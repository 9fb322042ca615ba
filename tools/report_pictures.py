"""Pictures of reports wide and on a telephone, light and dark: `report_pictures.py OUT REPORT...`."""

from __future__ import annotations

import sys
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

CHROMIUM = "/usr/bin/chromium"
WIDTHS = (1400, 390)
SCHEMES = ("light", "dark")
GL = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def main() -> None:
    """Write a PNG for each report, width and scheme; say how wide each page is beside its window."""
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GL)
        for report in map(Path, sys.argv[2:]):
            for width in WIDTHS:
                for scheme in SCHEMES:
                    _picture(browser, report, out, width, scheme)
        browser.close()


def _picture(browser: Browser, report: Path, out: Path, width: int, scheme: str) -> None:
    page = browser.new_page(
        viewport={"width": width, "height": 900}, color_scheme="dark" if scheme == "dark" else "light"
    )
    troubles: list[str] = []
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.goto(report.resolve().as_uri())
    page.wait_for_selector("html[data-drawn]", state="attached")
    page.wait_for_timeout(700)  # WebGL draws after the script has ended
    name = f"{report.parent.name}-{report.name.removesuffix('.html')}".replace(".", "-")
    page.screenshot(path=out / f"{name}-{width}-{scheme}.png", full_page=True)
    wide = page.evaluate("document.documentElement.scrollWidth")
    size = report.stat().st_size
    print(f"{report}: {size:,} bytes, {wide} px wide in {width} px, {scheme}. {' '.join(troubles)}")
    page.close()


if __name__ == "__main__":
    main()
