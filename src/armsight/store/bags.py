"""Bags of ROS 1 (.bag) and ROS 2 (a folder, or the .mcap or .db3 in it): images and joint states.

A topic is written bag:FILE:/topic. Times are the headers' stamps; t_s = 0 is the time at which the bag's first message
was written, or an origin that is given.
"""

from __future__ import annotations

import heapq
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Self

import numpy as np
import zstandard

from armsight.drivers.images import CHANNELS, decode_image, grey_or_bgr, unpack_image
from armsight.errors import ArmsightError, BadFile, BadImage, DeviceNotFound, Inconsistent, NotEnoughData, UsageError
from armsight.records import Frame, Motion
from armsight.store.atomic import read_bytes
from armsight.store.yamls import parse_yaml

PREFIX = "bag:"
IMAGE, COMPRESSED, JOINTS = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState"

LAYOUTS = {
    **dict.fromkeys(("mono8", "8UC1"), "mono"),
    **dict.fromkeys(("bgr8", "8UC3"), "bgr"),
    "rgb8": "rgb",
    **dict.fromkeys(("bgra8", "8UC4"), "bgra"),
    "rgba8": "rgba",
    **{f"bayer_{mosaic}8": mosaic for mosaic in ("rggb", "bggr", "gbrg", "grbg")},
    **dict.fromkeys(("uyvy", "yuv422"), "uyvy"),
    **dict.fromkeys(("yuyv", "yuv422_yuy2"), "yuyv"),
}
"""Layout of the pixels by the message's encoding: those of 8 bits, as a frame has."""

OTHER_CLOCK_NS = 86_400 * 10**9
"""Stamps a day from when they were written are of another clock, such as a simulation's, and count from its zero."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # begins a message that is compressed; others of ROS 2 begin with 0

ROOM_LEFT = 1_000_000_000
"""Bytes that a file which is unpacked leaves free in the folder of temporary files."""

Written = tuple[int, str, bytes]  # time in ns, encoding (cdr or ros1), content


def is_bag(text: str) -> bool:
    """Tell whether a source's text names a topic of a bag."""
    return text.startswith(PREFIX)


def bag_topic(text: str) -> tuple[Path, str]:
    """Return file and topic of bag:FILE:/topic; the topic is '' where the text names none."""
    file, found, topic = text.removeprefix(PREFIX).rpartition(":/")
    return (Path(file), f"/{topic}") if found else (Path(text.removeprefix(PREFIX)), "")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointStates:
    """Joint values with the joints' names, in the order of motion's columns."""

    names: tuple[str, ...]
    motion: Motion


class BagTopic:
    """One topic of a bag, opened and closed by `with`; once open it has count and origin_ns. text: bag:FILE:/topic.

    Opening raises BadFile for what is no bag, UsageError that lists the topics where the text's is not one of them or
    of none of the wanted types, DeviceNotFound where the reader's package is missing.
    """

    def __init__(self, text: str, types: tuple[str, ...]) -> None:
        self.name = text
        self.path, self.topic = bag_topic(text)
        self._types = types
        self._stack = ExitStack()
        self._files: list[_File] = []
        self._kind, self.origin_ns, self.count = "", 0, 0

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._files, said, self.origin_ns = _opened(self.path, stack)
            self._kind = self._found()
            self.count = sum(file.topics[self.topic][1] for file in self._files if self.topic in file.topics)
            if self.count < said.get(self.topic, 0):
                raise BadFile(
                    f"{self.path} has {self.count} of the {said[self.topic]} messages of {self.topic} in metadata.yaml",
                    consequence="Messages are missing",
                    cure="Put back what is missing; to read what is there, move metadata.yaml out of the folder",
                )
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def frames(self, *, colour: bool, origin_ns: int | None = None) -> Iterator[Frame]:
        """Yield the images, grey or BGR. Raises BadImage, Inconsistent for stamps that do not increase, BadFile."""
        for sequence, (message, t_s) in enumerate(self._messages(origin_ns)):
            where = f"{self.name} message {sequence + 1}"
            image = _image(message, where, colour=colour)
            yield Frame(image=image, t_s=t_s, sequence=sequence, source=where)

    def joint_states(self, *, origin_ns: int | None = None) -> JointStates:
        """Return all joint states. Raises Inconsistent where names change or a value is missing, NotEnoughData."""
        names: tuple[str, ...] = ()
        times, rows = [], []
        for number, (message, t_s) in enumerate(self._messages(origin_ns), 1):
            found = tuple(str(name) for name in message.name)
            names = names or found
            row = np.asarray(message.position, dtype=np.float64)
            if not found or set(found) != set(names) or len(found) != len(row) or not np.isfinite(row).all():
                raise Inconsistent(
                    f"{self.name} message {number} has positions {row.tolist()} of the joints {', '.join(found) or '-'}"
                    f"; the first one is of {', '.join(names) or '-'}",
                    consequence="The joints' motion is not known",
                    cure="Give a topic on which one publisher sends all positions of one robot in each message",
                )
            times.append(t_s)
            rows.append([row[found.index(name)] for name in names])
        if not rows:
            raise NotEnoughData(f"{self.name} has no message", consequence="There are no joint states")
        return JointStates(names=names, motion=Motion(t_s=np.array(times), q=np.array(rows)))

    def _found(self) -> str:
        found = {name: kind for file in self._files for name, (kind, _) in file.topics.items()}
        topics = {name: kind.replace("/", "/msg/") if kind.count("/") == 1 else kind for name, kind in found.items()}
        if topics.get(self.topic) in self._types:
            return topics[self.topic]
        there = "; ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"
        if not self.topic:
            what = f"{self.name} names no topic"
        elif self.topic not in topics:
            what = f"{self.path} has no topic {self.topic}"
        else:
            what = f"{self.topic} of {self.path} is {topics[self.topic]}"
        raise UsageError(
            what, cure=f"Write bag:FILE:/topic with one of type {' or '.join(self._types)}. Its topics: {there}"
        )

    def _messages(self, origin_ns: int | None) -> Iterator[tuple[Any, float]]:
        last_ns: int | None = None
        zero_ns = self.origin_ns if origin_ns is None else origin_ns
        for number, (message, written_ns) in enumerate(self._decoded(), 1):
            stamp = message.header.stamp
            stamp_ns = int(stamp.sec) * 10**9 + int(stamp.nanosec)
            if last_ns is None and abs(stamp_ns - written_ns) > OTHER_CLOCK_NS:
                zero_ns = 0
            if last_ns is not None and stamp_ns <= last_ns:
                raise _not_after(f"{self.name} message {number}", stamp_ns, last_ns)
            last_ns = stamp_ns
            yield message, (stamp_ns - zero_ns) / 1e9

    def _decoded(self) -> Iterator[tuple[Any, int]]:
        """Yield messages and the times in ns at which they were written. BadFile where one is not whole."""
        from rosbags.typesys import Stores, get_typestore

        # definitions in the file are not looked at: these types are known, and those of other topics hinder nothing
        ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
        decoders: dict[str, Any] = {"ros1": ros1.deserialize_ros1, "cdr": ros2.deserialize_cdr}
        found = (file.messages(self.topic) for file in self._files if self.topic in file.topics)
        messages = heapq.merge(*found, key=lambda one: one[0])
        for number in range(1, self.count + 1):
            try:
                written_ns, encoding, data = next(messages)
                data = _unpacked(data) if data[:4] == ZSTD_MAGIC else data
                message = decoders[encoding](data, self._kind)
            except StopIteration:
                raise _unreadable(f"{self.name} message {number}", EOFError("the bag ends before it")) from None
            except ArmsightError:
                raise
            except Exception as error:
                raise _unreadable(f"{self.name} message {number}", error) from error
            yield message, written_ns


def bag_origin_ns(path: Path) -> int:
    """Return the time in ns at which a bag's first message was written. Raises as opening a topic does."""
    with ExitStack() as stack:
        return _opened(path, stack)[2]


class _File(NamedTuple):
    """An open file of a bag: type and number of messages of its topics, and when its first message was written."""

    topics: dict[str, tuple[str, int]]
    start_ns: int | None
    messages: Callable[[str], Iterator[Written]]


def _opened(path: Path, stack: ExitStack) -> tuple[list[_File], dict[str, int], int]:
    """Return a bag's files, the numbers of messages in its metadata.yaml, and the time of its first message, ns.

    All else that is said there (quality of service, storage, version) is for playing the bag and is often edited.
    Nothing is written beside the files: what has to be unpacked, or joined with a log, is copied elsewhere.
    """
    require_rosbags(f"{path} is not opened")
    paths, said = _listed(path)
    openers, files = {".bag": _bag1, ".db3": _db3, ".mcap": _mcap}, []
    for one in paths:
        try:
            readable = _readable(one, stack)
            files.append(openers[readable.suffix](readable, stack))
        except ArmsightError:
            raise
        except Exception as error:  # the readers raise whatever their parsers do
            raise _unreadable(str(one), error) from error
    return files, said, min((file.start_ns for file in files if file.start_ns is not None), default=0)


def require_rosbags(consequence: str) -> None:
    """Raise DeviceNotFound where the package that knows ROS's messages is missing."""
    try:
        import rosbags  # noqa: F401
    except ImportError as error:
        raise DeviceNotFound(
            f"ROS bags can neither be read nor written: {error}",
            consequence=consequence,
            cure="Install the extra: pip install 'armsight[bags]'",
        ) from error


def _listed(path: Path) -> tuple[list[Path], dict[str, int]]:
    """Return a bag's files, and the numbers of messages in its metadata.yaml; a recorder that was killed left none."""
    folder = path if path.is_dir() else path.parent
    try:
        data = read_bytes(folder / "metadata.yaml", limit=20_000_000)  # that of ten thousand files has 2 MB
        content = parse_yaml(data, "metadata.yaml")["rosbag2_bagfile_information"]
        # Foxy's names begin with the folder's, those of Windows have its strokes
        paths = [folder / PureWindowsPath(name).name for name in content["relative_file_paths"]]
        said = {it["topic_metadata"]["name"]: int(it["message_count"]) for it in content["topics_with_message_count"]}
    except (BadFile, LookupError, TypeError, ValueError):
        paths, said = [], {}
    if path != folder and path not in paths:
        paths, said = [path], {}
    paths = [one for one in paths if one.is_file()]
    if not paths and path == folder:  # what record --repair put aside is not meant
        paths = [one for one in folder.glob("*") if one.is_file() and not one.stem.endswith(".broken")]
    paths = [one for one in paths if one.name.removesuffix(".zstd").endswith((".bag", ".mcap", ".db3"))]
    if not paths:
        raise BadFile(
            f"{path} is {'no bag, and holds none' if path.exists() else 'not there'}",
            consequence="There are no messages",
            cure="Check the path: give a .bag, .mcap or .db3, or the folder that ros2 bag record made",
        )
    return paths, said


def _readable(path: Path, stack: ExitStack) -> Path:
    """Return the file, or a copy that is unpacked, or has taken up the logs (-wal, -journal) of a recorder killed."""
    logs = [log for end in ("-wal", "-journal") if (log := Path(f"{path}{end}")).is_file() and log.stat().st_size]
    if path.suffix != ".zstd" and not logs:
        return path
    copy = Path(stack.enter_context(TemporaryDirectory()), path.name.removesuffix(".zstd"))
    if path.suffix == ".zstd":
        with path.open("rb") as packed, copy.open("wb") as plain:
            for part in zstandard.ZstdDecompressor().read_to_iter(packed):
                if shutil.disk_usage(copy.parent).free < ROOM_LEFT:
                    raise OSError("it unpacks to more than there is room for")
                plain.write(part)
        return copy
    for one in (path, *logs):
        shutil.copyfile(one, copy.parent / one.name)
    with closing(sqlite3.connect(copy)) as base:
        base.execute("SELECT * FROM sqlite_master").fetchall()
    return copy


def _unpacked(data: bytes) -> bytes:
    """Return a message that was written compressed. Raises ValueError: a few bytes can unpack to any size."""
    from armsight.store.recording.record_reader import MAX_CHUNK  # in functions, as every measurement imports this

    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        plain = bytes(reader.read(MAX_CHUNK + 1))
    if len(plain) > MAX_CHUNK:
        raise ValueError(f"it unpacks to more than {MAX_CHUNK} bytes")
    return plain


def _bag1(path: Path, stack: ExitStack) -> _File:
    from rosbags.rosbag1 import Reader

    reader = stack.enter_context(Reader(path))
    return _File(
        {name: (one.msgtype or "of several types", one.msgcount) for name, one in reader.topics.items()},
        reader.start_time if reader.message_count else None,
        lambda topic: ((ns, "ros1", data) for _, ns, data in reader.messages(reader.topics[topic].connections)),
    )


def _db3(path: Path, stack: ExitStack) -> _File:
    # immutable: not even a lock is written; frames may be read by another thread than opens the file
    uri = f"{path.absolute().as_uri()}?immutable=1"
    base = stack.enter_context(closing(sqlite3.connect(uri, uri=True, check_same_thread=False)))
    rows = base.execute(
        "SELECT name, type, count(messages.id), min(timestamp) FROM topics LEFT JOIN messages ON topics.id = topic_id "
        "GROUP BY name"
    ).fetchall()
    wanted = (
        "SELECT timestamp, serialization_format, data FROM messages JOIN topics ON topics.id = topic_id "
        "WHERE name = ? ORDER BY timestamp, messages.id"
    )
    return _File(
        {name: (kind, count) for name, kind, count, _ in rows},
        min((row[3] for row in rows if row[2]), default=None),
        lambda topic: (row for row in base.execute(wanted, (topic,))),
    )


def _mcap(path: Path, stack: ExitStack) -> _File:
    from armsight.store.recording import Recording

    file = Recording(path)
    stack.callback(file.close)
    if not file.finished:
        raise BadFile(
            f"{path} breaks off: it was not closed by its recorder, or not copied to its end",
            consequence="How many messages are missing is not known",
            cure=f"`armsight record --repair {path} -o mended.mcap` saves what is whole: read bag:mended.mcap:/topic",
        )
    return _File(
        {name: (kind, file.count(name)) for name, kind in file.topics.items()},
        next((one.t_ns for one in file.messages()), None),
        lambda topic: ((one.t_ns, one.encoding, bytes(one.data)) for one in file.messages((topic,))),
    )


def _image(message: Any, where: str, *, colour: bool) -> np.ndarray:
    if hasattr(message, "format"):
        return decode_image(bytes(message.data), where, colour=colour)
    layout = LAYOUTS.get(message.encoding)
    if layout is None:
        raise BadImage(
            f"{where} has the encoding {message.encoding!r}",
            consequence="The frame cannot be used: a longer pixel does not say which of its bits carry the light",
            cure=f"Record one of {', '.join(LAYOUTS)}",
        )
    step = int(message.step) or int(message.width) * CHANNELS[layout]
    pixels = unpack_image(message.data, int(message.height), int(message.width), step, layout)
    if pixels is None:
        raise BadImage(
            f"{where} says {message.width}x{message.height} px, {message.encoding}, rows of {step} bytes, and has "
            f"{len(message.data)} bytes",
            consequence="The frame cannot be used",
            cure="Record it again: the message was cut off or wrongly filled",
        )
    return grey_or_bgr(pixels, layout, colour=colour)


def _not_after(where: str, stamp_ns: int, last_ns: int) -> Inconsistent:
    how = "repeats" if stamp_ns == last_ns else "runs back behind"
    return Inconsistent(
        f"{where}: its stamp {stamp_ns / 1e9:.6f} s {how} that of the message before it, {last_ns / 1e9:.6f} s",
        consequence="Nobody can tell when it was taken, so reading stops here",
        cure="Cut the bag at this place, or have the publisher fill its headers' stamps; one publisher per topic",
    )


def _unreadable(where: str, error: Exception) -> BadFile:
    words = " ".join(str(error).split())[:200]
    return BadFile(
        f"{where} cannot be read: {type(error).__name__}{f': {words}' if words else ''}",
        consequence="There are no messages from there on",
        cure="Check its permissions, and the room for a copy in the folder of temporary files (TMPDIR)"
        if isinstance(error, OSError)
        else "Copy it again from its recorder; if it is so there, `sqlite3 FILE '.clone mended.db3'` saves what is "
        "whole of a .db3, and rosbag reindex of a .bag",
    )
