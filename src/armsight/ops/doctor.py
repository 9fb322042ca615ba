"""What this machine can do, and what a rig can tell apart."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from armsight._version import __version__
from armsight.drivers import CAMERAS, CELLS, ROBOTS, SCENARIOS, SETS, cameras_there, cores, folder, known
from armsight.drivers.aravis import genicam_cameras
from armsight.drivers.usb import crowded_buses, usb_cameras
from armsight.fields import Doc
from armsight.measure.planning import LEAST_COMMON, Choice, plan
from armsight.ops.simulation.scenarios import FILES, scenario_names
from armsight.optics import Rig, resolution, shared_point
from armsight.optics.parallelism import Resolution
from armsight.records import Progress
from armsight.records.checks import wide_rig
from armsight.records.output import Output, output
from armsight.shown import Shown, Table, digits
from armsight.units import MM


@output
class AccuracyPlan(Output):
    """Which settings and which baseline reach a wanted accuracy."""

    accuracy_m: Annotated[float, Doc("The wanted standard deviation of a point in its worst direction, m.")]
    depths_m: Annotated[list[float], Doc("The depths at which it is wanted, m.", unit="m")]
    sigma_px: Annotated[float, Doc("Standard deviation taken of a spot's centre, px.")]
    baseline_m: Annotated[float, Doc("The rig's own baseline, m.")]
    settings: Annotated[tuple[Choice, ...], Doc("By setting; one without zoom.")]
    advice: Annotated[list[str], Doc("What to do.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = []
        for one in self.settings:
            zooms = " ".join(dict.fromkeys(f"{v:g}" for v in (one.zoom_left, one.zoom_right) if v is not None))
            spots, rig, total = (
                digits(None if value is None else value / MM)
                for value in (one.now.spots_m, one.now.rig_m, one.now.total_m)
            )
            seen = [digits(one.now.width_m / MM), f"{100.0 * one.now.common:.0f}"]
            baseline = "none" if one.baseline_m is None else f"{one.baseline_m / MM:.0f}"
            total += " *" if one.reached else ""
            rows.append([zooms or "-", digits(one.focal_px, 4), *seen, spots, rig, total, baseline])
        depths = " to ".join(f"{value:g}" for value in sorted({min(self.depths_m), max(self.depths_m)}))
        yield Table(
            f"Wanted: +- {digits(self.accuracy_m / MM)} mm in the worst direction at {depths} m; spots taken as known "
            f"to {digits(self.sigma_px, 2)} px (--sigma); baseline now {digits(self.baseline_m / MM, 4)} mm",
            ["zoom", "f, px", "view", "in both, %", "spots +-", "rig +-", "total +-", "baseline for it"],
            rows,
        )
        yield "Lengths in mm; * reaches it with the rig's own baseline"
        yield from self.advice


@output
class RigResolution(Output):
    """What a rig can tell apart."""

    baseline_m: Annotated[float | None, Doc("Distance of the two centres of projection, m; null of no pair.")]
    rms_px: Annotated[float | None, Doc("RMS of the rig's calibration, px; null where its file does not say.")]
    sigma_px: Annotated[float, Doc("Standard deviation taken of a spot's centre, px.")]
    distances: Annotated[list[Resolution], Doc("By distance.")]
    accuracy: Annotated[AccuracyPlan | None, Doc("What reaches the accuracy of --accuracy.")] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = []
        for row in self.distances:
            along, across = row.sigma_depth_m / MM, max(row.sigma_lateral_m) / MM
            rows.append([digits(row.depth_m), digits(along), digits(across), "yes" if row.in_view else "no"])
        known = f"A spot known to {digits(self.sigma_px, 2)} px by"
        columns = ["distance, m", "+- along it, mm", "+- across, mm"]
        if self.baseline_m is None:
            yield Table(f"{known} the cameras, before the first one", [*columns, "in two views"], rows)
        else:
            baseline = digits(self.baseline_m / MM, 4)
            yield Table(f"{known} a rig of {baseline} mm baseline", [*columns, "in both views"], rows)
        if self.accuracy is not None:
            yield from self.accuracy.summary()


def accuracy_plan(rig: Rig, accuracy_m: float, depths_m: Sequence[float], sigma_px: float) -> AccuracyPlan:
    """Return the plan as --json gives it. Raises as measure.planning.plan."""
    choices = plan(rig, accuracy_m, depths_m, sigma_px)
    return AccuracyPlan(
        accuracy_m=accuracy_m,
        depths_m=list(depths_m),
        sigma_px=sigma_px,
        baseline_m=rig.baseline_m,
        settings=choices,
        advice=_advice(rig, choices, accuracy_m),
    )


def _advice(rig: Rig, choices: Sequence[Choice], accuracy_m: float) -> list[str]:
    """Return what to do: what is there, the least to change, or why nothing helps."""
    out = []
    if rig.covariance is None:
        out.append(
            "The rig's file tells no covariance of the cameras' places: what these bring comes on top of the figures"
        )
    reached = [one for one in choices if one.reached]
    if reached:
        widest = max(reached, key=lambda one: one.now.width_m)
        return [*out, f"The rig as it stands reaches {accuracy_m / MM:g} mm{_at(widest)}; that has the widest view"]
    able = [one for one in choices if one.baseline_m is not None]
    if able:
        least = min(able, key=lambda one: one.baseline_m or 0.0)
        return [
            *out,
            f"Move the cameras {(least.baseline_m or 0.0) / MM:.0f} mm apart{_at(least)} and calibrate the rig anew",
        ]
    seen = [one for one in choices if one.now.common >= LEAST_COMMON and isfinite(one.now.total_m)]
    if not seen:
        return [*out, "The cameras have no common view there: turn them towards it, or take a shorter focal length"]
    best = min(seen, key=lambda one: one.now.total_m)
    if best.now.rig_m > best.now.spots_m:
        return [*out, f"The calibration is what limits it ({best.now.rig_m / MM:.2g} mm{_at(best)}): take more views"]
    return [*out, "No baseline that was tried reaches it: come closer, take longer lenses, or place spots more surely"]


def _at(one: Choice) -> str:
    named = (("left", one.zoom_left), ("right", one.zoom_right))
    values = [f"--zoom-{side} {value:g}" for side, value in named if value is not None]
    return f" at {' '.join(values)}" if values else ""


PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "pydantic", "plotly", "typer")
DEPTHS_IN_BASELINES = (2.0, 5.0, 10.0, 20.0, 50.0)
"""Distances of the table: below two baselines views hardly overlap, beyond fifty depth is a guess."""
DEPTHS_IN_SHARED = (0.75, 1.0, 1.25)
"""Of other rigs than pairs, in the distance of the place at which all cameras look."""


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

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = [[name, text] for name, text in self.versions.items()]
        rows += [["system", self.machine.system], ["cores for armsight", str(self.machine.cores)]]
        rows += [["cameras there", ", ".join(self.cameras) or "none"]]
        rows += [[f"registered {group}", ", ".join(names) or "none"] for group, names in self.drivers.items()]
        rows += [["compiled kernels kept", str(self.kernels.compiled)]]
        yield Table("This machine", ["", ""], rows)
        if self.rig is not None:
            yield from self.rig.summary()
        yield from (f"Problem: {problem}" for problem in self.problems)
        if not self.problems:
            yield "No problem found."


def looked_at(told: RigResolution | None, failed: Sequence[str]) -> DoctorOutput:
    """Look at the machine. told: what a rig can tell apart; failed: what was found wrong before."""
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
        problems=[*failed, *_problems(drivers, kernels), *crowded_buses(usb_cameras()), *_too_wide(told)],
        rig=told,
    )


def rig_resolution(
    rig: Rig, depths_m: Sequence[float], sigma_px: float, accuracy_m: float | None = None
) -> RigResolution:
    """Return what the rig can tell apart at distances, for spots known to sigma_px; with zoom, as it was calibrated."""
    depths = list(depths_m) or _depths(rig)
    if accuracy_m is not None:
        rig.require_pair("--accuracy, which moves two cameras apart")
    return RigResolution(
        baseline_m=rig.baseline_m if rig.is_pair else None,
        rms_px=rig.rms_px,
        sigma_px=sigma_px,
        distances=[resolution(rig, depth_m, sigma_px) for depth_m in depths],
        accuracy=None if accuracy_m is None else accuracy_plan(rig, accuracy_m, depths, sigma_px),
    )


def _depths(rig: Rig) -> list[float]:
    """Return the distances of which is told where none are given: of no pair about where all cameras look."""
    if rig.is_pair:
        return [factor * rig.baseline_m for factor in DEPTHS_IN_BASELINES]
    depth_m = float(rig.cameras[0].T_rig_camera.inv().apply(shared_point(rig))[2])
    places = np.array([one.T_rig_camera.translation for one in rig.cameras])
    span_m = float(np.linalg.norm(places[:, None] - places, axis=2).max())
    if not 0.5 * span_m < depth_m < DEPTHS_IN_BASELINES[-1] * span_m:  # they look in parallel, or apart
        return [factor * span_m for factor in DEPTHS_IN_BASELINES]
    return [factor * depth_m for factor in DEPTHS_IN_SHARED]


def kernel_cache(*packages: Path) -> KernelCache:
    """Return how many compiled kernels of packages are kept on disk, where, and whether more can be added.

    Where: the first package, or the first that nothing can be added to.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    folders = [Path(given)] if given else packages
    closed = [folder for folder in folders if not os.access(folder, os.W_OK)]
    kept = sum(1 for folder in folders if folder.is_dir() for _ in folder.rglob("*.nbc"))
    return KernelCache(folder=str([*closed, *folders][0]), compiled=kept, writable=not closed)


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    found["opencv"] = cv2.__version__
    return found


def compiled_now(progress: Progress | None) -> list[str]:
    """Compile all that is not compiled yet; return what is wrong."""
    from armsight.ops.compilation import compile_all

    left = compile_all(progress)
    if not left:
        return []
    return [f"Not compiled: {', '.join(left)}. What stands above says why; where nothing does, install armsight anew."]


def _too_wide(rig: RigResolution | None) -> list[str]:
    """Return what is wrong with a rig that is wider than any that sees an arm."""
    return [text] if rig is not None and (text := wide_rig(rig.baseline_m or 0.0)) else []


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
