"""A recording's content as plain files: PNG folders, CSV tables, TUM."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Annotated

from armsight.drivers import Ahead, RecordedMoments, by_name
from armsight.errors import BadFile, Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.file_names import RIG, TARGET
from armsight.ops.simulation.cells import write_png
from armsight.ops.sources.frames import RecordedFrames
from armsight.optics import SIDES
from armsight.records import Frame, Progress, Silent
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import PosesWriter, SpotsWriter, write_bytes, write_text, write_tum
from armsight.store.atomic import RowFile, disk_errors, json_text
from armsight.store.recording import Recording
from armsight.store.rosbag2 import write_rosbag2
from armsight.store.tables import cells, number, word

FOLDER = re.compile(r"\w[\w.-]*(/\w[\w.-]*)*")
"""A camera's name that leads into the folder written to; whoever wrote the recording chose it."""

KINDS = ("files", "rosbag2")
"""What a recording can be written as."""


@output
class ExportOutput(Output):
    """armsight convert recording."""

    source: Annotated[str, Doc("The recording.", key="from")]
    out: Annotated[str, Doc("The folder or file written.")]
    n: Annotated[dict[str, int], Doc("Rows or frames by file.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield ", ".join(f"{name}: {count}" for name, count in self.n.items()) + f" in {self.out}"


def export(source: Path, out: Path, *, to: str = "files", progress: Progress | None = None) -> ExportOutput:
    """Write what a recording holds; return rows or frames by file.

    out ending in .tum: its complete poses; in .csv: its poses; else a folder: CAMERA/000000.png and times.csv for
    frames, poses.csv, poses.tum, joints.csv, spots.csv, commands.csv, events.csv, rig.yaml and target.yaml, of what is
    there. to: 'files', or 'rosbag2' for a bag of ROS 2 in the folder out. Raises BadFile, NotEnoughData where what is
    asked for is not there, DeviceFailed, Cancelled.
    """
    progress = progress or Silent()
    if to not in KINDS:
        raise UsageError(f"a recording is not exported to {to!r}", cure=f"Give --to with one of {', '.join(KINDS)}")
    if to == "rosbag2":
        return _rosbag2(source, out, progress)
    suffix = out.suffix.lower()
    if suffix not in ("", ".csv", ".tum"):
        raise UsageError(f"{out.name}: a recording is not exported to {suffix}", cure="Give a folder, a .csv or a .tum")
    with Recording(source) as recording:
        if suffix == ".tum":
            done = {out.name: write_tum(out, recording.poses())}
        elif suffix == ".csv":
            done = {out.name: _poses(recording, out)}
        else:
            with disk_errors(out):
                out.mkdir(parents=True, exist_ok=True)
            done = _folder(recording, out, progress)
    if not any(done.values()):
        raise NotEnoughData(
            f"{source} holds nothing that could be written",
            cure="Give another, or record anew: nothing in it is whole, or nothing was recorded",
        )
    return ExportOutput(source=str(source), out=str(out), n=done)


def _rosbag2(source: Path, out: Path, progress: Progress) -> ExportOutput:
    with Recording(source) as recording:
        total = sum(recording.count(topic) for topic in recording.topics)

        def on_written(count: int) -> None:
            progress.update(count, max(count, total), "writing the bag")
            if progress.cancelled():
                raise Cancelled(f"stopped after {count} messages", consequence="No bag was written")

        done = write_rosbag2(recording, out, on_written=on_written)
    return ExportOutput(source=str(source), out=str(out), n=done)


def _folder(recording: Recording, out: Path, progress: Progress) -> dict[str, int]:
    done: dict[str, int] = {}
    for name in (RIG, TARGET):
        if name in recording.attachments:
            write_bytes(out / name, recording.attachment(name))
            done[name] = 1
    for camera in recording.cameras:
        if not FOLDER.fullmatch(camera):
            raise BadFile(
                f"{recording.path}: {camera[:60]!r} names no folder within {out}",
                consequence="Its frames would be written elsewhere; nothing is",
                cure="Give the topic another name, and record it anew",
            )
    times = _images(recording, out, progress)
    done |= {camera: len(stamps) for camera, stamps in times.items()}
    first = next(iter(times.values()), [])
    for i, (camera, stamps) in enumerate(times.items()):
        if i and stamps == first:
            continue
        name = f"times_{camera}.csv" if i else "times.csv"
        write_text(out / name, "\n".join(["t_s", *(number(t_s) for t_s in stamps)]) + "\n")
        done[name] = len(stamps)
    tables: dict[str, tuple[str, Callable[[Recording, Path], int]]] = {
        "poses.csv": ("/target/measured", _poses),
        "poses.tum": ("/target/measured", lambda it, path: write_tum(path, it.poses())),
        "joints.csv": ("/robot/joints", _joints),
        "commands.csv": ("/robot/command", _commands),
        "events.csv": ("/events", _events),
    }
    for name, (topic, write) in tables.items():
        if topic in recording.topics:
            done[name] = write(recording, out / name)
    cameras = [topic.split("/")[1] for topic in recording.topics if topic.endswith("/spots")]
    if cameras:
        done["spots.csv"] = _spots(recording, cameras, out / "spots.csv")
    return done


def _images(recording: Recording, out: Path, progress: Progress) -> dict[str, list[float]]:
    """Write the frames by camera, numbered by their place; return their times.

    Of three cameras and more by their moment: a view that is missing leaves its number out, so that they fit together.
    """
    for camera in recording.cameras:
        with disk_errors(out / camera):
            (out / camera).mkdir(parents=True, exist_ok=True)
    total = sum(recording.count(f"/{camera}/image") for camera in recording.cameras)

    def write(item: tuple[str, int, Frame]) -> tuple[str, float]:
        camera, number, frame = item
        write_png(out / camera / f"{number:06d}.png", frame)
        return camera, frame.t_s

    stamps: dict[str, list[float]] = {camera: [] for camera in recording.cameras}
    for n, (camera, t_s) in enumerate(Ahead(write, _numbered(recording)), start=1):
        stamps[camera].append(t_s)
        progress.update(n, total, camera)
        if progress.cancelled():
            raise Cancelled(f"stopped after {n} frames", consequence=f"They are in {out}")
    return stamps


def _numbered(recording: Recording) -> Iterator[tuple[str, int, Frame]]:
    """Yield the frames with their camera and number."""
    names = recording.cameras
    if len(names) <= len(SIDES):
        for name in names:
            yield from ((name, number, frame) for number, frame in enumerate(recording.frames(name)))
        return
    sources = [RecordedFrames(str(recording.path), name, colour=None) for name in names]
    with RecordedMoments(*sources, names=names, fewest=1) as moments:
        for number, moment in enumerate(moments):
            yield from ((name, number, frame) for name, frame in by_name(names, moment).items())


def _poses(recording: Recording, path: Path) -> int:
    count = 0
    poses = recording.poses()
    first = next(poses)  # raises before there is a file where there are none
    with PosesWriter(path) as table:
        for pose in chain([first], poses):
            table.write(pose)
            count += 1
    return count


def _spots(recording: Recording, cameras: Iterable[str], path: Path) -> int:
    count = 0
    with SpotsWriter(path) as table:
        for camera in cameras:
            for seen in recording.spots(camera):
                names = seen.names or tuple(str(i + 1) for i in range(len(seen.spots)))
                table.write(seen.t_s, seen.camera, names, seen.spots)
                count += len(seen.spots)
    return count


def _joints(recording: Recording, path: Path) -> int:
    readings = recording.joints()
    first = next(readings)
    n = len(first.q)
    count = 0
    with RowFile(path, ",".join(["t_s", *(f"q{i + 1}" for i in range(n))])) as table:
        for reading in chain([first], readings):
            if len(reading.q) != n:
                raise Inconsistent(f"{recording.path}: {len(reading.q)} joints after readings of {n}")
            table.add(f"{number(reading.t_s)},{cells(reading.q.tolist())}")
            count += 1
    return count


def _commands(recording: Recording, path: Path) -> int:
    return _rows(
        path,
        "t_s,kind,values",
        (f"{number(it.t_s)},{word(it.kind)},{word(json_text(it.values, indent=None))}" for it in recording.commands()),
    )


def _events(recording: Recording, path: Path) -> int:
    return _rows(
        path,
        "t_s,level,name,message",
        (f"{number(it.t_s)},{it.level},{word(it.name)},{word(it.message)}" for it in recording.events()),
    )


def _rows(path: Path, header: str, rows: Iterable[str]) -> int:
    count = 0
    with RowFile(path, header) as table:
        for row in rows:
            table.add(row)
            count += 1
    return count
