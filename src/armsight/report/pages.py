"""Which page tells of a result of an action, and where it goes beside the result's file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from armsight.calibrate.handeye import HandEyeResult
from armsight.report.handeye_report import handeye_report

FILES_SHOWN = 20
"""Files of what went in that a page lists; the result's own file has all, with their hashes."""


def _hand_eye(result: HandEyeResult, files: Sequence[Path]) -> str:
    return handeye_report(result, inputs=[("file", item.name) for item in files[:FILES_SHOWN]])


PAGES: Mapping[type, Callable[[Any, Sequence[Path]], str]] = {HandEyeResult: _hand_eye}
"""By class of result: the page, from the result and the files that went in."""


def page_path(out: Path, result: object) -> Path | None:
    """Return where the page of a result goes, by its file's: rig.report.html; None where it has none."""
    return out.with_suffix(".report.html") if type(result) in PAGES else None


def page_of(result: object, files: Sequence[Path]) -> str:
    """Return the page of a result as HTML text that needs no other file."""
    return PAGES[type(result)](result, files)
