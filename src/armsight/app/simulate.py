"""A simulated cell's frames and truth as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armsight.app.cells import CellPairs, load_cell, write_cell_files
from armsight.errors import Cancelled
from armsight.records import Progress, Silent


def simulate(scenario: str, out: Path, *, seed: int, frames: int, progress: Progress | None = None) -> dict[str, Any]:
    """Write left/*.png, right/*.png, rig.yaml, target.yaml, times.csv, truth.csv and scenario.yaml into the folder out.

    Raises DeviceNotFound for an unknown scenario, DeviceFailed where the disk refuses, Cancelled.
    """
    progress = progress or Silent()
    cell = load_cell(scenario, seed=seed, frames=frames)
    write_cell_files(cell, out, seed=seed, frames=frames)
    done = 0
    with CellPairs(cell, frames, folder=out) as pairs:
        for _ in pairs:
            done += 1
            progress.update(done, frames)
            if progress.cancelled():
                raise Cancelled(f"stopped after {done} pairs", consequence=f"They are in {out}")
    return {"scenario": scenario, "seed": seed, "n_frames": done, "out": str(out)}
