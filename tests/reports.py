"""Strangers' cases, which stand beside the project in ../shared/data/reports: a folder each, with what is right."""

from pathlib import Path

import pytest

REPORTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "reports"


def case(name: str) -> Path:
    """Return a case's folder; the test is skipped, saying so, where it is not there."""
    folder = REPORTS / name
    if not folder.is_dir():
        pytest.skip(f"strangers' case {name} is not beside the project (../shared/data/reports)")
    return folder
