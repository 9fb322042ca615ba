"""A recording read back: whole, cut off in the middle, or written by another program."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from armsight._files import open_file
from armsight.errors import BadFile, DataRefused, Inconsistent, NotEnoughData
from armsight.file_names import RIG, TARGET
from armsight.geometry import pose_from_quat
from armsight.optics import Rig
from armsight.records import Frame, JointReading, PoseStatus, Spots, Target, TargetPose
from armsight.store.atomic import Closing
from armsight.store.recording import record_reader, schemas
from armsight.store.recording.images import decode
from armsight.store.recording.mcapfile import MAGIC
from armsight.store.recording.schemas import NS
from armsight.store.recording.writer import FORMAT, METADATA
from armsight.store.rigs import rig_from_mapping
from armsight.store.targets import target_from_mapping
from armsight.store.yamls import parse_yaml

IMAGES = (schemas.RAW_IMAGE, schemas.COMPRESSED_IMAGE)

R = TypeVar("R")


class Recorded(NamedTuple):
    """A message as the file holds it."""

    topic: str
    schema: str
    encoding: str
    sequence: int
    t_ns: int
    data: memoryview


class SpotsSeen(NamedTuple):
    """The spots of one image."""

    t_s: float
    camera: str
    names: tuple[str, ...]
    spots: Spots


class Command(NamedTuple):
    """What was sent to the robot."""

    t_s: float
    kind: str
    values: dict[str, Any]


class Event(NamedTuple):
    """Something that happened."""

    t_s: float
    level: int
    name: str
    message: str


@dataclass(slots=True)
class _Content:
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    blocks: list[record_reader.ChunkSpan | record_reader.Span] = field(default_factory=list)
    attachments: dict[str, record_reader.Span] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    readable_bytes: int = len(MAGIC)
    finished: bool = False


class Recording(Closing):
    """A recording open for reading; use it as a context manager.

    Opening looks at every record's head and reads no image. Damage is told where it stands, when it is reached.
    Raises BadFile.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file: BinaryIO = open_file(path)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise BadFile(f"{path}: cannot be read ({reason})", cure="Check the path") from error
        try:
            record_reader.check_magic(self._file, path)
            self._size = self._file.seek(0, 2)
            self._content = _look_through(self._file, self._size, path)
            self.origin_ns = self._origin()
        except BaseException:
            self._file.close()
            raise

    @property
    def finished(self) -> bool:
        """Tell whether the file was closed properly."""
        return self._content.finished

    @property
    def lost_bytes(self) -> int:
        """Bytes at the end of a file cut off that belong to no whole record."""
        return 0 if self._content.finished else self._size - self._content.readable_bytes

    @property
    def topics(self) -> dict[str, str]:
        """The schema's name of each topic."""
        return {channel.topic: self._schema(channel) for channel in self._content.channels.values()}

    def count(self, topic: str) -> int:
        """Return how many messages a topic has."""
        numbers = [number for number, channel in self._content.channels.items() if channel.topic == topic]
        return sum(self._content.counts[number] for number in numbers)

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that frames are there of, such as ('left', 'right')."""
        found = [topic for topic, schema in self.topics.items() if schema in IMAGES and self.count(topic)]
        return tuple(topic.removeprefix("/").removesuffix("/image") for topic in found)

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the files in it."""
        return tuple(self._content.attachments)

    def attachment(self, name: str) -> bytes:
        """Return a file's content. Raises NotEnoughData where it is not there."""
        span = self._content.attachments.get(name)
        if span is None:
            there = ", ".join(self.attachments) or "none"
            raise NotEnoughData(f"{self.path} holds no file {name}; it holds {there}")
        try:
            return bytes(record_reader.record_at(self._file, span, Attachment).data)
        except ValueError as error:
            raise record_reader.damaged(self.path, span, str(error)) from error

    @property
    def rig(self) -> Rig:
        """The rig recorded with it. Raises NotEnoughData where none was."""
        return rig_from_mapping(parse_yaml(self.attachment(RIG), f"{self.path}: {RIG}"), str(self.path))

    @property
    def target(self) -> Target:
        """The target recorded with it. Raises NotEnoughData where none was."""
        content = parse_yaml(self.attachment(TARGET), f"{self.path}: target.yaml")
        return target_from_mapping(content, str(self.path))

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Recorded]:
        """Yield the messages of the given topics (None: of all) as they stand in the file. Raises BadFile."""
        wanted = None if topics is None else frozenset(topics)
        numbers = {
            number: (channel.topic, self._schema(channel), channel.message_encoding)
            for number, channel in self._content.channels.items()
            if wanted is None or channel.topic in wanted
        }
        with open_file(self.path) as file:  # its own place in the file: several may read at once
            for block in self._content.blocks:
                for message in _messages_of(file, block, self.path):
                    if message.channel in numbers:
                        topic, schema, encoding = numbers[message.channel]
                        yield Recorded(topic, schema, encoding, message.sequence, message.t_ns, message.data)

    def frames(self, camera: str) -> Iterator[Frame]:
        """Yield a camera's frames, numbered as recorded. Raises as images, and BadImage."""
        for t_s, message, exposure_s in self.images(camera):
            where = f"{self.path}:{camera}:{message.sequence}"
            image = decode(message.schema, message.data, where)
            yield Frame(image=image, t_s=t_s, sequence=message.sequence, source=where, exposure_s=exposure_s)

    def images(self, camera: str) -> Iterator[tuple[float, Recorded, float]]:
        """Yield t_s, message and exposure (s) of a camera's images, not decoded. Raises NotEnoughData, Inconsistent,
        BadFile."""
        topic = f"/{camera}/image"
        if self.topics.get(topic) not in IMAGES:
            raise self._lacks(topic, "images")
        exposure_s, last_ns = 0.0, None
        for message in self.messages((topic, f"/{camera}/exposure")):
            if message.topic != topic:
                exposure_s = float(self._json(message).get("exposure_s", 0.0))
                continue
            if last_ns is not None and message.t_ns < last_ns:
                back_s = (last_ns - message.t_ns) / NS
                raise Inconsistent(
                    f"{self.path}:{camera}:{message.sequence}: time runs backwards by {back_s:.6g} s",
                    consequence="The frames have no order from there on, so reading stops",
                    cure="Sort the recording by time (`mcap sort`), or record it anew",
                )
            last_ns = message.t_ns
            yield (message.t_ns - self.origin_ns) / NS, message, exposure_s

    def poses(self) -> Iterator[TargetPose]:
        """Yield the target's poses. Raises NotEnoughData where there are none, BadFile."""
        return self._records("/target/measured", schemas.TARGET_POSE, _pose)

    def joints(self) -> Iterator[JointReading]:
        """Yield the joint readings. Raises NotEnoughData where there are none, BadFile."""
        return self._records("/robot/joints", schemas.JOINT_READING, _joints)

    def spots(self, camera: str) -> Iterator[SpotsSeen]:
        """Yield a camera's spots. Raises NotEnoughData where there are none, BadFile."""
        return self._records(f"/{camera}/spots", schemas.SPOTS, _spots)

    def commands(self) -> Iterator[Command]:
        """Yield what was sent to the robot. Raises NotEnoughData where there is nothing, BadFile."""
        return self._records(
            "/robot/command", schemas.COMMAND, lambda it: Command(float(it["t_s"]), it["kind"], it["values"])
        )

    def events(self) -> Iterator[Event]:
        """Yield what happened. Raises NotEnoughData where there is nothing, BadFile."""

        def event(it: dict[str, Any]) -> Event:
            stamp = it["timestamp"]
            t_ns = int(stamp["sec"]) * NS + int(stamp["nsec"]) - self.origin_ns
            return Event(t_ns / NS, int(it["level"]), str(it["name"]), str(it["message"]))

        return self._records("/events", schemas.LOG, event)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _records(self, topic: str, schema: str, make: Callable[[dict[str, Any]], R]) -> Iterator[R]:
        if self.topics.get(topic) != schema:
            raise self._lacks(topic, schema)
        for message in self.messages((topic,)):
            content = self._json(message)
            try:
                record = make(content)
            except (KeyError, TypeError, ValueError, DataRefused) as error:
                raise BadFile(
                    f"{self.path}: message {message.sequence} of {topic} is no {schema} ({error!r:.120})",
                    consequence="Reading stops there",
                ) from error
            yield record

    def _json(self, message: Recorded) -> dict[str, Any]:
        try:
            content = json.loads(bytes(message.data)) if message.encoding == "json" else None
        except (ValueError, RecursionError):  # lists within lists without end
            content = None
        if isinstance(content, dict):
            return content
        raise BadFile(f"{self.path}: message {message.sequence} of {message.topic} is not JSON")

    def _lacks(self, topic: str, what: str) -> NotEnoughData:
        there = ", ".join(f"{name} ({schema})" for name, schema in self.topics.items())
        return NotEnoughData(
            f"{self.path} has no channel {topic} with {what}; it has {there[:400] or 'none at all'}",
            consequence="There is nothing to read",
            cure="Give a recording made by `armsight record`, or one with these topics",
        )

    def _schema(self, channel: Channel) -> str:
        schema = self._content.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _origin(self) -> int:
        """Return the zero of t_s: as the recording says, else (another program's) its first moment is not known: 0."""
        own = self._content.metadata.get(METADATA, {})
        if own.get("format") != FORMAT:
            return 0
        text = own.get("origin_ns", "")
        if not text.lstrip("-").isdecimal():
            raise BadFile(f"{self.path}: origin_ns is {text[:40]!r}", consequence="Its times mean nothing")
        return int(text)


def _look_through(file: BinaryIO, size: int, path: Path) -> _Content:
    """Return what the file holds, up to its end or to the first record that is cut off."""
    content = _Content()
    for span in record_reader.spans(file, len(MAGIC), size):
        content.readable_bytes = span.end
        try:
            if span.opcode == Opcode.DATA_END:
                content.finished = (
                    size >= span.end and record_reader.read_at(file, size - len(MAGIC), len(MAGIC)) == MAGIC
                )
                break
            _take(content, file, span, path)
        except ValueError as error:
            raise record_reader.damaged(path, span, str(error)) from error
    return content


def _take(content: _Content, file: BinaryIO, span: record_reader.Span, path: Path) -> None:
    if span.opcode == Opcode.CHUNK:
        chunk = record_reader.chunk_span(file, span, path)
        content.blocks.append(chunk)
        if not chunk.compression:
            for inner in record_reader.spans(file, chunk.start, chunk.start + chunk.size):
                _take_inner(content, file, inner)
        else:
            for record in record_reader.inner_records(record_reader.chunk_data(file, chunk, path)):
                _count(content, record)
    elif span.opcode == Opcode.MESSAGE:
        content.blocks.append(span)
        _take_inner(content, file, span)
    elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        _take_inner(content, file, span)
    elif span.opcode == Opcode.METADATA and span.length < record_reader.MAX_SMALL:
        own = record_reader.record_at(file, span, Metadata)
        content.metadata[own.name] = own.metadata
    elif span.opcode == Opcode.ATTACHMENT and span.length < record_reader.MAX_SMALL:
        name = record_reader.record_at(file, span, Attachment).name
        content.attachments[name] = span


def _take_inner(content: _Content, file: BinaryIO, span: record_reader.Span) -> None:
    if span.opcode == Opcode.MESSAGE:
        content.counts[int.from_bytes(record_reader.read_at(file, span.start, 2), "little")] += 1
    elif span.opcode == Opcode.SCHEMA and span.length < record_reader.MAX_SMALL:
        _count(content, record_reader.record_at(file, span, Schema))
    elif span.opcode == Opcode.CHANNEL and span.length < record_reader.MAX_SMALL:
        _count(content, record_reader.record_at(file, span, Channel))


def _count(content: _Content, record: record_reader.Message | Schema | Channel) -> None:
    if isinstance(record, Schema):
        content.schemas[record.id] = record
    elif isinstance(record, Channel):
        content.channels[record.id] = record
    else:
        content.counts[record.channel] += 1


def _messages_of(
    file: BinaryIO, block: record_reader.ChunkSpan | record_reader.Span, path: Path
) -> Iterator[record_reader.Message]:
    try:
        if isinstance(block, record_reader.Span):
            data = record_reader.read_at(file, block.start - record_reader.HEAD, block.length + record_reader.HEAD)
            yield record_reader.message_of(memoryview(data))
            return
        for record in record_reader.inner_records(record_reader.chunk_data(file, block, path)):
            if isinstance(record, record_reader.Message):
                yield record
    except ValueError as error:
        raise record_reader.damaged(path, block, str(error)) from error


def _pose(it: dict[str, Any]) -> TargetPose:
    status = PoseStatus(it["status"])
    known = status is not PoseStatus.LOST
    shared = it.get("systematic_covariance", [])  # recordings of earlier versions have none
    return TargetPose(
        t_s=float(it["t_s"]),
        status=status,
        parent=str(it["parent"]),
        spots=tuple(it["spots"]),
        T_parent_target=pose_from_quat(it["xyz_m"], it["quat_xyzw"]).as_matrix() if known else None,
        covariance=np.array(it["covariance"], float) if known else None,
        systematic_covariance=np.array(shared, float) if shared else None,
        origin_known=bool(it.get("origin_known", False)),
        residual_px=np.array(it["residual_px"], float),
        why=str(it["why"]),
    )


def _joints(it: dict[str, Any]) -> JointReading:
    q = np.array(it["q"], float)
    return JointReading(q=q, t_s=float(it["t_s"]), sequence=int(it["sequence"]), source=str(it["source"]))


def _spots(it: dict[str, Any]) -> SpotsSeen:
    n = len(it["model"])
    spots = Spots(
        uv_px=np.array(it["uv_px"], float).reshape(n, 2),
        covariance_px2=np.array(it["covariance_px2"], float).reshape(n, 2, 2),
        peak=np.array(it["peak"], float),
        size_px=np.array(it["size_px"], float),
        model=tuple(it["model"]),
        rejected=tuple((float(u), float(v), str(why)) for u, v, why in it["rejected"]),
    )
    return SpotsSeen(float(it["t_s"]), str(it["camera"]), tuple(it["names"]), spots)
