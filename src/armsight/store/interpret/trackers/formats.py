"""Every kind of tracker file: how it is known by its first lines, and how it is read; one entry a kind.

What a file of each really says stands, with its source, at the head of the module that reads it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from armsight.errors import UsageError
from armsight.store.interpret.raw import RawTable
from armsight.store.interpret.table_format import TableFormat
from armsight.store.interpret.trackers.c3d import is_c3d, read_c3d
from armsight.store.interpret.trackers.lists import is_libfranka, is_points, read_libfranka, read_points
from armsight.store.interpret.trackers.motive import is_motive, read_motive
from armsight.store.interpret.trackers.qtm import is_qtm, read_qtm
from armsight.store.interpret.trackers.tracks import Tracks
from armsight.store.interpret.trackers.trc import is_trc, read_trc
from armsight.store.interpret.trackers.vicon import is_vicon, read_vicon

HEAD_BYTES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerFormat:
    """A kind of file: title for lists; needs: what has to be said where the file leaves it open; unit: of its lengths.

    begins, begins_bytes: whether the text of a file's first bytes, or they themselves, are of this kind. read: bytes,
    the file's name and what is said of it to bodies and markers, or to a table.
    """

    title: str
    needs: str = ""
    unit: str = "as the header says"
    begins: Callable[[str], bool] | None = None
    begins_bytes: Callable[[bytes], bool] | None = None
    read: Callable[[bytes, str, TableFormat], Tracks | RawTable]


BODY = "--body of several"
CLOUD = f"{BODY}, or the markers of one"

TRACKERS: Mapping[str, TrackerFormat] = {
    "motive": TrackerFormat(title="OptiTrack Motive, CSV 1.2 to 1.25", needs=BODY, begins=is_motive, read=read_motive),
    "qtm": TrackerFormat(title="Qualisys QTM, 6D and 3D TSV", needs=CLOUD, unit="mm", begins=is_qtm, read=read_qtm),
    "vicon": TrackerFormat(
        title="Vicon Nexus and Tracker, CSV",
        needs=f"{CLOUD}; --euler where angles may be of two kinds",
        begins=is_vicon,
        read=read_vicon,
    ),
    "trc": TrackerFormat(title="TRC of Motive, Cortex, Nexus, OpenSim", needs=CLOUD, begins=is_trc, read=read_trc),
    "c3d": TrackerFormat(title="C3D of any program", needs=CLOUD, begins_bytes=is_c3d, read=read_c3d),
    "libfranka": TrackerFormat(
        title="libfranka, logToCSV: joints", unit="m, rad, ms", begins=is_libfranka, read=read_libfranka
    ),
    "spatialanalyzer": TrackerFormat(
        title="SpatialAnalyzer, ASCII points",
        needs="--units; --body of several groups",
        unit="as a remark or --units says",
        begins=is_points,
        read=read_points,
    ),
}
"""By name, in the order in which a file is asked for them."""


def tracker_of(data: bytes) -> TrackerFormat | None:
    """Return the kind of tracker file that bytes begin as, None for other tables."""
    head = data[:HEAD_BYTES].decode("utf-8", errors="replace").lstrip("\ufeff")
    for kind in TRACKERS.values():
        if (kind.begins_bytes is not None and kind.begins_bytes(data)) or (
            kind.begins is not None and kind.begins(head)
        ):
            return kind
    return None


def tracker_table(kind: TrackerFormat, data: bytes, where: str, format_: TableFormat) -> RawTable:
    """Return a tracker file's body, or the log, as a table. Raises UsageError, DataRefused."""
    found = kind.read(data, where, format_)
    if isinstance(found, Tracks):
        return found.table(format_)
    if format_.body:
        raise no_bodies(where, format_.body)
    return found


def no_bodies(where: str, body: str) -> UsageError:
    """Return what is raised for a body named in a file that has none by name."""
    return UsageError(
        f"{where}: --body {body!r} is named, and this file has no bodies by name", cure="Leave --body out"
    )
