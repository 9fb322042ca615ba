"""Compile the kernels before the first frame, once per machine, with a second process to share the work."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from armsight.app.simulate.cells import load_cell
from armsight.measure import settings
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup, warm_up
from armsight.optics import Camera, parallel_rig
from armsight.records import Progress, Spots, spot_target

FIRST_TIME = "compiling (only this first time, about a minute)"
READY = "preparing"
LAST_COMPILED = ("locate.locate_near", "pose.predict_views", "levels.step_poses")
"""Kernels that a tracked pair needs last, in each of the parts of the measurement."""


def prepare(progress: Progress, *, cell: str = "") -> None:
    """Make sure that no frame waits for the compiler; with a cell's name, nor does its first frame.

    Where nothing is compiled yet, a second process compiles the matching, the pose and the cell's renderer while
    this one compiles the search for spots: the compiler holds the interpreter's lock, so threads would not help.
    """
    if compiled():
        progress.update(0, 0, READY)
        warm_up()
        return
    progress.update(0, 0, FIRST_TIME)
    code = f"from armsight.app.measure.warm_up import compile_beside; compile_beside({cell!r})"
    helper = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        warm_up()
        helper.wait()  # where it failed, this process compiles when it comes to it
    finally:
        helper.kill()


def compiled() -> bool:
    """Tell whether compiled kernels of the measurement are kept on this machine."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(given) if given else Path(settings.__file__).parent
    return folder.is_dir() and all(any(folder.rglob(f"{name}-*.nbi")) for name in LAST_COMPILED)


def compile_beside(cell: str = "") -> None:
    """Compile what comes after the spots; see prepare."""
    xyz_m = {"A": (-0.05, 0.0, 0.0), "B": (0.05, 0.04, 0.0), "C": (0.03, -0.04, 0.0)}
    rig = parallel_rig(Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0), 0.1)
    views = rig.project(np.array(list(xyz_m.values())) + np.array([0.05, 0.0, 0.5]))
    seen = [Spots.of_centres(uv_px, 0.01 * np.eye(2)) for uv_px in views]
    setup = Setup(rig, spot_target(xyz_m))
    track = measure_spots(setup, 0.0, seen[0], seen[1]).track
    measure_spots(setup, 0.01, seen[0], seen[1], track)
    if cell:
        next(load_cell(cell, seed=0, frames=1).frames())
