"""Compile the kernels before the first frame, once per machine, with a second process to share the work."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.measure import settings
from armsight.measure.consistency.evidence import Evidence
from armsight.measure.poses.from_spots import measure_among
from armsight.measure.poses.pipeline import Setup, warm_up
from armsight.optics import RIG_PARAMETERS, Camera, parallel_rig
from armsight.records import Frame, NamedCovariance, Progress, Spots, spot_target, unmeasured_target

FIRST_TIME = "compiling (only this first time, about a minute)"
READY = "preparing"
LAST_COMPILED = ("locate.locate_near", "tracking.predict_views", "levels.step_poses")
"""Kernels that a tracked pair needs last, in each of the parts of the measurement."""


def prepare(progress: Progress, *, cell: str = "", views: bool = False) -> None:
    """Make sure that no frame waits for the compiler; with a cell's name, nor does its first frame.

    views: for a rig that is no pair.

    Where nothing is compiled yet, a second process compiles the matching, the pose and the cell's renderer while
    this one compiles the search for spots: the compiler holds the interpreter's lock, so threads would not help.
    """
    if compiled():
        progress.update(0, 0, READY)
        warm_up()
        if views:
            compile_views()
        return
    progress.update(0, 0, FIRST_TIME)
    code = f"from armsight.ops.measurement.warm_up import compile_beside; compile_beside({cell!r})"
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
    uncertainty = NamedCovariance(names=RIG_PARAMETERS, matrix=1e-12 * np.eye(len(RIG_PARAMETERS)))
    rig = replace(parallel_rig(Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0), 0.1), covariance=uncertainty)
    views = rig.project(np.array(list(xyz_m.values())) + np.array([0.05, 0.0, 0.5]))
    left, right = (Spots.of_centres(uv_px, 0.01 * np.eye(2)) for uv_px in views)
    frames = _frame(views[0]), _frame(views[1])
    for target in (spot_target(xyz_m, covariance=1e-12 * np.eye(9)), unmeasured_target()):
        setup, track = Setup(rig, target), None
        evidence = Evidence.of(setup)
        for number in range(3):
            measured, _ = measure_among(setup, 0.01 * number, left, right, track, None, frames)
            evidence.add(measured)
            track = measured.track
    if cell:
        from armsight.ops.simulation.cells import load_cell

        next(load_cell(cell, seed=0, frames=1).frames())


def _frame(uv_px: NDArray[np.float64]) -> Frame:
    """Return a dark image with lights at uv_px (n, 2), one pixel wide as `Spots.of_centres` has them."""
    y, x = np.mgrid[0:480, 0:640]
    image = sum(150.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 2.0) for u, v in uv_px).astype(np.uint8)
    return Frame(image=image, t_s=0.0, sequence=0, source="warm-up")


def compile_views() -> None:
    """Compile the poses of other rigs than pairs: by three cameras, lights half hidden, then by one alone."""
    from armsight.measure.poses.kernels.hidden import FINDING, UU, VV
    from armsight.measure.poses.solving import Views, solve_views, widen
    from armsight.measure.poses.views import measure_views
    from armsight.optics import MountedCamera, Rig

    xyz_m = np.array([[-0.05, 0.0, 0.0], [0.05, 0.04, 0.01], [0.03, -0.04, 0.0], [-0.01, 0.05, 0.03]])
    camera, place, cameras, seen = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0), [0.05, 0.0, 0.5], [], []
    for name, x_m in (("left", 0.0), ("right", 0.1), ("top", 0.05)):
        T = RigidTransform.from_translation([x_m, 0.0, 0.0])
        cameras.append(MountedCamera(name=name, camera=camera, T_rig_camera=T))
        seen.append(Spots.of_centres(camera.project(T.inv().apply(xyz_m + place)), 0.01 * np.eye(2)))
    setup = Setup(Rig(cameras=cameras), spot_target(dict(zip("ABCD", xyz_m.tolist(), strict=True))))
    measure_views(setup, 0.0, seen)
    measure_views(setup, 0.0, [seen[0], Spots.none(), Spots.none()])
    uv_px, cov_px2 = (np.stack([getattr(one, part) for one in seen], axis=1) for part in ("uv_px", "covariance_px2"))
    views, hidden = Views(uv_px, cov_px2, np.zeros(uv_px.shape[:2])), np.zeros((len(seen), len(xyz_m), FINDING))
    hidden[:, :, [UU, VV]] = 1.0
    widen(setup, 0.0, tuple("ABCD"), views, solve_views(setup, 0.0, tuple("ABCD"), views), hidden)
