"""The documentation builds without a warning, and its reference holds every public name."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import armsight

ROOT = Path(__file__).resolve().parents[2]


def test_the_pages_build_and_hold_every_public_name(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "reference" / "index.html").read_text(encoding="utf-8")
    missing = [
        name
        for name, module in armsight._places().items()
        if not module.startswith("armsight._")
        if f'id="{module}.{name}"' not in page and f">{name}<" not in page
    ]
    assert not missing
    outside = [path.name for path in tmp_path.rglob("*.html") if 'src="https://' in path.read_text(encoding="utf-8")]
    assert not outside, "the pages open without a network"
