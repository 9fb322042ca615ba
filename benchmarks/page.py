"""Assembles docs/benchmarks.md from what the benchmarks printed.

    python benchmarks/pose.py > out/pose.txt        (and so on, one file per benchmark)
    python benchmarks/page.py out

A benchmark without a file in the folder keeps the section it has in the page.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"
INTRO = """# Benchmarks

What the scripts in `benchmarks/` printed, ours and the peers' side by side from one run. The first line of each section
names the day and the machine. That machine is shared: the same call takes up to three times as long in a busy hour, so
compare the rows of one table, not the tables with each other. Times are medians; "wanted" and "aim" are set for the
machine in a quiet hour. Real measurements come from folders of other people's data beside the repository; without
them those tables are skipped.
"""
SECTIONS = {
    "real_boards": "Calibration on real boards",
    "calibration": "Calibration beside the Cramer-Rao bound",
    "spots": "Centres of spots",
    "pose": "Poses",
    "folder": "Measuring a folder",
    "kinematics": "Kinematics",
    "render": "Rendering frames",
    "recording": "Recordings",
    "identify": "Identification of an arm",
    "identify_live": "Identification online",
    "calibrate_arm": "Calibration of an arm",
    "sagging_arm": "Joints that give way",
    "other_arm": "Nominal figures of another arm",
    "handeye": "Hand-eye calibration",
    "tooltip": "Tool tip",
    "mirrors": "Mirror stereo",
    "target": "A target's lights",
    "xcorner": "Board detectors",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="holds NAME.txt for each benchmark that was run")
    folder = parser.parse_args().folder
    kept = sections(PAGE.read_text()) if PAGE.exists() else {}
    text = INTRO
    for name, title in SECTIONS.items():
        printed = folder / f"{name}.txt"
        body = printed.read_text().strip() if printed.exists() else kept.get(title, "")
        if body:
            text += f"\n## {title}\n\n`python benchmarks/{name}.py`\n\n{body}\n" if printed.exists() else f"\n{body}\n"
    PAGE.write_text(text)


def sections(page: str) -> dict[str, str]:
    """Return the page's sections by title, each with its heading."""
    parts = re.split(r"^(?=## )", page, flags=re.MULTILINE)[1:]
    return {part.splitlines()[0].removeprefix("## "): part.strip() for part in parts}


if __name__ == "__main__":
    main()
