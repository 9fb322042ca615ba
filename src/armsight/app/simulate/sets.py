"""Simulated sets for one calibration each, reached by name, as files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from armsight.app.schemas.files import SimulateOutput
from armsight.app.simulate.cells import write_png
from armsight.drivers import SETS, load
from armsight.errors import Cancelled, UsageError
from armsight.records import Frame, Progress
from armsight.store import write_text
from armsight.store.arm_file import ARM_FORMAT
from armsight.store.rigs import RIG_FORMAT
from armsight.store.schema import write_document
from armsight.store.tables import number
from armsight.store.targets import TARGET_FORMAT
from armsight.store.yamls import dump_yaml
from armsight.store.zoom import CAMERA_FORMAT

Documents = Mapping[str, Mapping[str, Any]]


class Dataset(Protocol):
    """What a simulated set offers (entry points armsight.sets: (seed, size) -> Dataset): contents by file name."""

    name: str
    commands: Sequence[str]
    assumptions: Sequence[str]
    rigs: Documents
    cameras: Documents
    targets: Documents
    arms: Documents
    truths: Documents
    tables: Mapping[str, tuple[Sequence[str], Sequence[Sequence[float | str]]]]
    n_images: int
    images: Callable[[], Iterator[tuple[str, Frame]]]


def simulate_set(name: str, out: Path, *, seed: int, size: int | None, progress: Progress) -> SimulateOutput:
    """Write a set's pictures, tables and truth into the folder out.

    size: how many pictures or rows, where not the set's own. Raises UsageError for too few, DeviceFailed where the disk
    refuses, Cancelled between two pictures, before any of the tables is there.
    """
    made = cast(Dataset, load(SETS, name)(seed, size))
    done, folders = 0, set()
    for done, (place, frame) in enumerate(made.images(), start=1):
        file = out / f"{place}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        folders.add(file.parent.name)
        write_png(file, frame)
        progress.update(done, made.n_images)
        if progress.cancelled():
            raise Cancelled(f"stopped after {done} pictures", consequence=f"They are in {out}, and no tables")
    _write_files(made, out, seed)
    return SimulateOutput(
        scenario=made.name,
        seed=seed,
        n_frames=done,
        views=sorted(folders) or None,
        out=str(out),
        commands=list(made.commands),
    )


def require_own(name: str, room: str | None, zoom: float | None) -> None:
    """Raise UsageError where a room or a zoom is asked for."""
    if room is not None or zoom is not None:
        raise UsageError(f"the set {name} has a room and lenses of its own", cure="Leave --room and --zoom away")


def _write_files(made: Dataset, out: Path, seed: int) -> None:
    """Write all but the pictures."""
    kinds = (
        (RIG_FORMAT, made.rigs),
        (CAMERA_FORMAT, made.cameras),
        (TARGET_FORMAT, made.targets),
        (ARM_FORMAT, made.arms),
    )
    for format_, documents in kinds:
        for file, content in documents.items():
            write_document(out / file, format_, content, [])
    for file, content in made.truths.items():
        write_text(out / file, dump_yaml(dict(content)))
    for file, (columns, rows) in made.tables.items():
        lines = [",".join(cell if isinstance(cell, str) else number(cell) for cell in row) for row in rows]
        write_text(out / file, "\n".join([",".join(columns), *lines]) + "\n")
    scenario = {
        "format": "armsight/scenario",
        "version": 1,
        "name": made.name,
        "seed": seed,
        "assumptions": list(made.assumptions),
    }
    write_text(out / "scenario.yaml", dump_yaml(scenario))
