"""What the operating system runs first: measuring before the pictures of it that people look at."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

MEASURING, PICTURES = -10, 5
"""Niceness: browsers on the same machine have 0."""


def measure_first() -> None:
    """Let the calling thread, and those that it begins, run before others where the system allows it."""
    _nice(MEASURING)


def pictures_last() -> None:
    """Let the calling thread wait for others."""
    _nice(PICTURES)


def _nice(value: int) -> None:
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), value)
