"""The main job on a simulated cell, and how far its poses are from the truth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.app.measure.collector import About
from armsight.app.measure.outputs import Summary
from armsight.app.measure.run import run
from armsight.app.measure.warm_up import prepare
from armsight.app.simulate.cells import CellPairs, load_cell, write_cell_files
from armsight.geometry import pose_from_quat
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.records import Progress, Silent
from armsight.report.measure import INSIDE_95
from armsight.report.series import SCALE, errors_of
from armsight.store import rig_from_mapping, target_from_mapping, write_json
from armsight.units import DEG, MM

Array = NDArray[np.float64]

AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DemoResult:
    """The run's figures, the errors (n, 6) in m and rad of its poses, and the deviations they claim (n, 6)."""

    summary: Summary
    errors: Array
    claimed: Array
    inside_95: float | None
    seconds: float
    assumptions: tuple[str, ...]

    def rows(self) -> Sequence[tuple[str, float, float, float]]:
        """Return name, RMS, largest and claimed deviation (RMS) of each coordinate, in mm and degrees."""
        units = [("mm", MM)] * 3 + [("deg", DEG)] * 3
        return [
            (
                f"{axis}, {unit}",
                _rms(self.errors[:, i]) / factor,
                float(np.abs(self.errors[:, i]).max(initial=0.0)) / factor,
                _rms(self.claimed[:, i]) / factor,
            )
            for i, (axis, (unit, factor)) in enumerate(zip(AXES, units, strict=True))
        ]

    def content(self) -> dict[str, Any]:
        """Return it as --json gives it."""
        units = ["m"] * 3 + ["rad"] * 3
        return {
            **self.summary.content(),
            "truth": {
                f"{axis}_{unit}": {
                    "rms": _rms(self.errors[:, i]),
                    "max": float(np.abs(self.errors[:, i]).max(initial=0.0)),
                    "claimed": _rms(self.claimed[:, i]),
                }
                for i, (axis, unit) in enumerate(zip(AXES, units, strict=True))
            },
            "inside_95": self.inside_95,
            "seconds_s": self.seconds,
            "assumptions": list(self.assumptions),
        }


def demo(
    out: Path,
    *,
    seed: int,
    frames: int,
    cell: str,
    room: str | None = None,
    keep_frames: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Measure a simulated cell's frames into the folder out and compare with the truth.

    room: a room's name or a picture's path instead of the cell's own. Raises DeviceNotFound for an unknown cell,
    UsageError for an unknown room, what `run` raises, and Cancelled.
    """
    start_s = time.perf_counter()
    progress = progress or Silent()
    made = load_cell(cell, seed=seed, frames=frames, room=room)
    prepare(progress, cell=cell)
    rig, target = rig_from_mapping(made.rig, f"{cell}'s rig"), target_from_mapping(made.target, f"{cell}'s target")
    setup = Setup(rig=rig, target=target, settings=SpotSettings())
    write_cell_files(made, out, seed=seed, frames=frames)
    truth = [pose_from_quat(xyz_m, quat_xyzw) for _, xyz_m, quat_xyzw in made.truth]
    about = About(
        title=f"Demonstration: {cell}",
        facts=[("frames", f"simulated, {made.fps:g} a second, seed {seed}")],
        assumptions=made.assumptions,
        truth=truth,
    )
    pairs = CellPairs(made, frames, folder=out if keep_frames else None)
    summary, poses = run(setup, pairs, out, progress=progress, about=about)
    errors = errors_of(poses, truth)
    compared = np.isfinite(errors.distance2)
    result = DemoResult(
        summary=summary,
        errors=errors.values[compared] * SCALE,
        claimed=errors.std[compared] * SCALE,
        inside_95=float(np.mean(errors.distance2[compared] <= INSIDE_95)) if compared.any() else None,
        seconds=time.perf_counter() - start_s,
        assumptions=tuple(made.assumptions),
    )
    write_json(out / "demo.json", result.content())
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
