"""What armsight does: one function an action, whose signature is its only declaration.

The modules of actions load nothing that takes long, for a command's flags and help are made of their signatures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

MODULES = (
    *("machine", "measure", "verify", "mastering", "files", "identify", "boards"),
    *("calibrate_cameras", "calibrate_hand_eye", "calibrate_robot", "calibrate_mirrors", "calibrate_rig"),
    *("calibrate_cell", "convert", "kinematics", "paths", "motion", "teach", "robots"),
)
"""Those that have actions, whose order is that of the commands in the help of their group."""


def actions() -> Iterator[Callable[..., Any]]:
    """Yield every action, in the order of MODULES and of their source."""
    for name in MODULES:
        module = import_module(f"{__name__}.{name}")
        for one in vars(module).values():
            if "action" in getattr(one, "__dict__", ()) and one.__module__ == module.__name__:
                yield one
