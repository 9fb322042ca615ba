"""Bags of ROS 1 (.bag) and ROS 2 (a folder, or the .mcap or .db3 in it): images and joint states.

A topic is written bag:FILE:/topic. Times are the headers' stamps; t_s = 0 is the time at which the bag's first message
was written, or an origin that is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from armsight.drivers.images import CHANNELS, decode_image, grey_or_bgr, unpack_image
from armsight.errors import BadFile, BadImage, DataRefused, DeviceNotFound, Inconsistent, NotEnoughData, UsageError
from armsight.records import Frame, Motion

PREFIX = "bag:"
IMAGE, COMPRESSED, JOINTS = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState"

LAYOUTS = {
    "mono8": "mono",
    "8UC1": "mono",
    "bgr8": "bgr",
    "8UC3": "bgr",
    "rgb8": "rgb",
    "bgra8": "bgra",
    "8UC4": "bgra",
    "rgba8": "rgba",
    "bayer_rggb8": "rggb",
    "bayer_bggr8": "bggr",
    "bayer_gbrg8": "gbrg",
    "bayer_grbg8": "grbg",
}
"""Layout of the pixels by the message's encoding: those of 8 bits, as a frame has."""

OTHER_CLOCK_NS = 86_400 * 10**9
"""Stamps a day from when they were written are of another clock, such as a simulation's, and count from its zero."""


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
    """One topic of a bag, opened and closed by `with`. text: bag:FILE:/topic.

    Opening raises BadFile for what is no bag, UsageError that lists the topics where the text's is not one of them or
    of none of the wanted types, DeviceNotFound where the reader's package is missing.
    """

    def __init__(self, text: str, types: tuple[str, ...]) -> None:
        self.name = text
        self.path, self.topic = bag_topic(text)
        self._types = types
        self._reader: Any = None
        self._connections: list[Any] = []

    def __enter__(self) -> Self:
        self._reader = _open(self.path)
        try:
            self._connections = self._found()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    @property
    def count(self) -> int:
        """How many messages the topic has."""
        return sum(one.msgcount for one in self._connections)

    @property
    def origin_ns(self) -> int:
        """The time in ns at which the bag's first message was written; the origin where none is given."""
        return int(self._reader.start_time)

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

    def _found(self) -> list[Any]:
        topics = {name: info.msgtype or "of several types" for name, info in self._reader.topics.items()}
        if topics.get(self.topic) in self._types:
            return [one for one in self._reader.connections if one.topic == self.topic]
        there = "; ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"
        if not self.topic:
            what = f"{self.name} names no topic"
        elif self.topic not in topics:
            what = f"{self.path} has no topic {self.topic}"
        else:
            what = f"{self.topic} of {self.path} is {topics[self.topic]}"
        raise UsageError(
            what,
            consequence="Nothing is read",
            cure=f"Write bag:FILE:/topic with a topic of type {' or '.join(self._types)}. Its topics: {there}",
        )

    def _messages(self, origin_ns: int | None) -> Iterator[tuple[Any, float]]:
        """Yield the messages with t_s."""
        last_ns: int | None = None
        zero_ns = self.origin_ns if origin_ns is None else origin_ns
        for number, (message, written_ns) in enumerate(_decoded(self._reader, self._connections, self.name), 1):
            stamp = message.header.stamp
            stamp_ns = int(stamp.sec) * 10**9 + int(stamp.nanosec)
            if last_ns is None and abs(stamp_ns - written_ns) > OTHER_CLOCK_NS:
                zero_ns = 0
            if last_ns is not None and stamp_ns <= last_ns:
                raise _not_after(f"{self.name} message {number}", stamp_ns, last_ns)
            last_ns = stamp_ns
            yield message, (stamp_ns - zero_ns) / 1e9


def bag_origin_ns(path: Path) -> int:
    """Return the time in ns at which a bag's first message was written. Raises as opening a topic does."""
    reader = _open(path)
    try:
        return int(reader.start_time)
    finally:
        reader.close()


def _open(path: Path) -> Any:
    """Return the open reader of a bag."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise DeviceNotFound(
            f"ROS bags cannot be read: {error}",
            consequence=f"{path} is not opened",
            cure="Install the extra: pip install 'armsight[bags]'",
        ) from error
    if path.suffix in (".mcap", ".db3") and (path.parent / "metadata.yaml").exists():
        path = path.parent
    if not path.exists():
        raise BadFile(f"there is no bag {path}", consequence="There are no messages", cure="Check the path")
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # the reader raises whatever its parsers do
        raise _unreadable(str(path), error) from error
    return reader


def _decoded(reader: Any, connections: list[Any], name: str) -> Iterator[tuple[Any, int]]:
    """Yield messages and the times in ns at which they were written. BadFile where one is not whole or not there."""
    if not connections:
        return
    messages = reader.messages(connections=connections)
    said = sum(one.msgcount for one in connections)
    for number in range(1, said + 1):
        try:
            connection, written_ns, data = next(messages)
            message = reader.deserialize(data, connection.msgtype)
        except StopIteration:
            raise _unreadable(f"{name} message {number} of {said}", EOFError("the bag ends before it")) from None
        except Exception as error:
            raise _unreadable(f"{name} message {number}", error) from error
        yield message, written_ns


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


def _unreadable(where: str, error: Exception) -> DataRefused:
    words = " ".join(str(error).split())[:200]
    return BadFile(
        f"{where} cannot be read: {type(error).__name__}{f': {words}' if words else ''}",
        consequence="There are no messages from there on",
        cure="Check it with rosbag info, ros2 bag info; ROS 1 mends an unfinished bag with rosbag reindex, ROS 2 with "
        "ros2 bag reindex",
    )
