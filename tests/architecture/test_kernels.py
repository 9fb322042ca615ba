"""Compiled code follows one rule: only `_numba` says how, so that no kernel raises on exact data."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BARE = re.compile(r"\b(njit|numba\.jit|guvectorize)\b")


def named_outside(folder: Path) -> list[str]:
    files = [path for path in folder.rglob("*.py") if path.name != "_numba.py"]
    return [path.name for path in files if BARE.search(path.read_text(encoding="utf-8"))]


def test_only_one_file_says_how_kernels_are_compiled(tmp_path: Path) -> None:
    assert not named_outside(ROOT / "src")
    (tmp_path / "planted.py").write_text("from numba import njit\n")
    assert named_outside(tmp_path) == ["planted.py"]
