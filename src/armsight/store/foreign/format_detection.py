"""Tell whose file a file of a calibration is, by the keys that only that program writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armsight.store.foreign.storage import read_storage


def kind_of_mapping(content: Mapping[str, Any]) -> str | None:
    """Return 'ros', 'kalibr', 'opencv', an armsight format such as 'armsight/rig', or None."""
    format_ = content.get("format")
    if isinstance(format_, str) and format_.startswith("armsight/"):
        return None if len(format_) > 40 else format_
    if isinstance(content.get("cam0"), Mapping):
        return "kalibr"
    if "camera_matrix" in content and ("projection_matrix" in content or "camera_name" in content):
        return "ros"
    if {"camera_matrix", "cameraMatrix", "cameraMatrix1", "M1", "K1"} & set(content) or {"R", "T"} <= set(content):
        return "opencv"
    return None


def kind_of(path: Path) -> str | None:
    """Return whose file this is; see kind_of_mapping. BadFile where it is neither YAML nor OpenCV's XML."""
    return kind_of_mapping(read_storage(path))
