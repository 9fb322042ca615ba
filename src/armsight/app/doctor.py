"""What this machine can do, and what a rig can tell apart."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import cv2

from armsight._version import __version__
from armsight.app.accuracy import accuracy_plan
from armsight.app.schemas.machine import DoctorOutput, KernelCache, Machine, ResolutionAt, RigResolution
from armsight.app.simulate.scenarios import FILES, scenario_names
from armsight.drivers import CAMERAS, CELLS, ROBOTS, SCENARIOS, SETS, cameras_there, cores, folder, known
from armsight.drivers.aravis import genicam_cameras
from armsight.errors import UsageError
from armsight.optics import Rig, resolution
from armsight.optics.resolution import CENTROID_SIGMA_PX, Resolution
from armsight.store import read_zoom_rig

PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "pydantic", "plotly", "typer")
DEPTHS_IN_BASELINES = (2.0, 5.0, 10.0, 20.0, 50.0)
"""Distances of the table: below two baselines views hardly overlap, beyond fifty depth is a guess."""


def doctor(
    rig: Path | None = None,
    *,
    depths_m: Sequence[float] = (),
    sigma_px: float = CENTROID_SIGMA_PX,
    accuracy_m: float | None = None,
) -> DoctorOutput:
    """Look at the machine and, where given, at a rig's resolution at distances (default: multiples of its baseline).

    accuracy_m: tell also which settings and which baseline reach this standard deviation at the distances. Raises
    UsageError where it is wanted without a rig or a distance, or a distance without a rig.
    """
    if depths_m and rig is None:
        raise UsageError("--depth is of a rig", cure="Give --rig with it")
    if accuracy_m is not None and (rig is None or not depths_m):
        raise UsageError(
            "--accuracy is of a rig at a distance",
            cure="Give --rig and --depth (in m; again for the far end of a volume)",
        )
    drivers = {group.removeprefix("armsight."): list(known(group)) for group in (CAMERAS, ROBOTS, CELLS, SETS)}
    drivers["scenarios"] = list(scenario_names())
    packages = [Path(__file__).parent.parent]
    if FILES in known(SCENARIOS):
        packages.append(folder(SCENARIOS, FILES).parent)
    kernels = kernel_cache(*packages)
    return DoctorOutput(
        versions={"armsight": __version__, "python": platform.python_version(), **_versions()},
        machine=Machine(system=platform.platform(), cores=cores(), cores_there=os.cpu_count() or 1),
        cameras=[*cameras_there(), *genicam_cameras()],
        drivers=drivers,
        kernels=kernels,
        problems=_problems(drivers, kernels),
        rig=None if rig is None else rig_resolution(read_zoom_rig(rig), depths_m, sigma_px, accuracy_m),
    )


def rig_resolution(
    rig: Rig, depths_m: Sequence[float], sigma_px: float, accuracy_m: float | None = None
) -> RigResolution:
    """Return what the rig can tell apart at distances, for spots known to sigma_px; with zoom, as it was calibrated."""
    depths = list(depths_m) or [factor * rig.baseline_m for factor in DEPTHS_IN_BASELINES]
    return RigResolution(
        baseline_m=rig.baseline_m,
        rms_px=rig.rms_px,
        sigma_px=sigma_px,
        distances=[_resolution_at(resolution(rig, depth_m, sigma_px)) for depth_m in depths],
        accuracy=None if accuracy_m is None else accuracy_plan(rig, accuracy_m, depths, sigma_px),
    )


def _resolution_at(row: Resolution) -> ResolutionAt:
    return ResolutionAt(
        depth_m=row.depth_m,
        sigma_depth_m=row.sigma_depth_m,
        sigma_lateral_m=row.sigma_lateral_m.tolist(),
        depth_per_px_m=row.depth_per_px_m,
        lateral_per_px_m=row.lateral_per_px_m,
        in_view=row.in_view,
    )


def kernel_cache(*packages: Path) -> KernelCache:
    """Return how many compiled kernels of packages are kept on disk, where, and whether more can be added.

    Where: the first package, or the first that nothing can be added to.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    places = [Path(given)] if given else packages
    closed = [place for place in places if not os.access(place, os.W_OK)]
    kept = sum(1 for place in places if place.is_dir() for _ in place.rglob("*.nbc"))
    return KernelCache(folder=str([*closed, *places][0]), compiled=kept, writable=not closed)


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    found["opencv"] = cv2.__version__
    return found


def _problems(drivers: Mapping[str, Sequence[str]], kernels: KernelCache) -> list[str]:
    problems = []
    if not drivers["cameras"]:
        problems.append("No camera driver is registered: the installation is incomplete. Run `make install`.")
    if not kernels.writable:
        problems.append(
            f"{kernels.folder} cannot be written, so every start compiles anew. Set NUMBA_CACHE_DIR to a folder."
        )
    if cv2.__version__.startswith("5.") or sys.version_info < (3, 11):
        problems.append("OpenCV 5 or an old Python is installed; run in the environment that `make install` builds.")
    return problems
