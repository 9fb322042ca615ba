"""What this machine can do, and what a rig can tell apart."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import cv2

from armsight._version import __version__
from armsight.app.accuracy import ResolutionAt, RigResolution, accuracy_plan
from armsight.app.simulate.scenarios import scenario_names
from armsight.drivers import CAMERAS, CELLS, ROBOTS, SETS, cameras_there, cores, known
from armsight.drivers.aravis import genicam_cameras
from armsight.errors import UsageError
from armsight.optics import Rig, resolution
from armsight.optics.resolution import CENTROID_SIGMA_PX, Resolution
from armsight.records.fields import Doc
from armsight.records.output import Output, output
from armsight.store import read_zoom_rig

PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "pydantic", "plotly", "typer")
DEPTHS_IN_BASELINES = (2.0, 5.0, 10.0, 20.0, 50.0)
"""Distances of the table: below two baselines views hardly overlap, beyond fifty depth is a guess."""


@output
class Machine(Output):
    """The machine."""

    system: Annotated[str, Doc("The operating system.")]
    cores: Annotated[int, Doc("Processor cores that armsight uses.")]
    cores_there: Annotated[int, Doc("Processor cores of the machine.")]


@output
class KernelCache(Output):
    """Compiled kernels kept on disk."""

    folder: Annotated[str, Doc("Where.")]
    compiled: Annotated[int, Doc("How many.")]
    writable: Annotated[bool, Doc("Whether more can be added.")]


@output
class DoctorOutput(Output):
    """armsight doctor."""

    versions: Annotated[dict[str, str], Doc("Versions by program or package.")]
    machine: Annotated[Machine, Doc("The machine.")]
    cameras: Annotated[list[str], Doc("Cameras that are there.")]
    drivers: Annotated[dict[str, list[str]], Doc("Drivers, cells and scenarios by group.")]
    kernels: Annotated[KernelCache, Doc("Compiled kernels.")]
    problems: Annotated[list[str], Doc("What is wrong, each with a cure.")]
    rig: Annotated[RigResolution | None, Doc("What the rig of --rig can tell apart; null without one.")]


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
    kernels = kernel_cache(Path(__file__).parent.parent)
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


def kernel_cache(package: Path) -> KernelCache:
    """Return how many compiled kernels are kept on disk, where, and whether more can be added."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(given) if given else package
    kept = sum(1 for _ in folder.rglob("*.nbc")) if folder.is_dir() else 0
    return KernelCache(folder=str(folder), compiled=kept, writable=os.access(folder, os.W_OK))


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
