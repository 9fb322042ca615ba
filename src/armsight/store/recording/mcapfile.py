"""An MCAP file that grows chunk by chunk and can be read whatever happens to the program that writes it.

Our own writer rather than the mcap package's: it never copies an image, knows at which byte the last whole chunk
ends (what a full disk cuts off is cut back to there), and decides by the clock when a chunk is due. The small
records are put into bytes by the mcap package. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path

from mcap import records as mcap_records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from armsight._version import __version__
from armsight.clock import Clock, SystemClock
from armsight.errors import DeviceFailed, Inconsistent, UsageError

MAGIC = b"\x89MCAP0\r\n"

CHUNK_S = 0.25
"""A message waits no longer than this in memory; half a second in a recorder's queue added, a killed program loses
less than a second."""

CHUNK_BYTES = 8_000_000
"""A quarter of a second of raw 720p pairs has 28 MB; smaller chunks keep the reader's memory small."""

COALESCE = 65_536
"""Smaller pieces are gathered and written together: a system call costs as much as copying this many bytes."""

CHUNK_HEAD = struct.Struct("<BQQQQIIQ")
"""Opcode, length, first and last time, size, CRC, length of the compression's name (none), size of the records."""

MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, time of logging, time of publishing."""

Buffer = bytes | memoryview


@dataclass(slots=True)
class _Chunk:
    parts: list[bytearray | memoryview] = field(default_factory=list)
    size: int = 0
    crc: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    begun_s: float = 0.0

    def add(self, data: Buffer) -> None:
        """Take a piece; a large one is kept as it is, small ones are gathered."""
        self.crc = zlib.crc32(data, self.crc)
        self.size += len(data)
        if len(data) >= COALESCE:
            self.parts.append(memoryview(data))
        elif self.parts and isinstance(self.parts[-1], bytearray):
            self.parts[-1] += data
        else:
            self.parts.append(bytearray(data))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Written:
    """What one step added to the file: it ends at `end`."""

    end: int
    chunk: mcap_records.ChunkIndex | None = None
    counts: dict[int, int] = field(default_factory=dict)
    attachment: mcap_records.AttachmentIndex | None = None
    metadata: mcap_records.MetadataIndex | None = None


class McapFile:
    """A new MCAP file; close() gives it its index and end.

    Raises UsageError where the file is there already and overwrite is not set, DeviceFailed where the disk refuses:
    then what was written in whole chunks has been closed as a readable file.
    """

    def __init__(
        self,
        path: Path,
        *,
        overwrite: bool = False,
        clock: Clock | None = None,
        chunk_s: float = CHUNK_S,
        chunk_bytes: int = CHUNK_BYTES,
        profile: str = "",
    ) -> None:
        self.path = path
        self._clock = clock or SystemClock()
        self._chunk_s = chunk_s
        self._chunk_bytes = chunk_bytes
        self._file = _create(path, overwrite)
        self._schemas: list[mcap_records.Schema] = []
        self._channels: list[mcap_records.Channel] = []
        self._steps: list[_Written] = []
        self._last_ns: dict[int, int] = {}
        self._chunk = _Chunk()
        self._end = 0
        self._failed = False
        header = mcap_records.Header(profile=profile, library=f"armsight {__version__}")
        self._commit([MAGIC, _bytes_of(header)])

    @property
    def closed(self) -> bool:
        """Tell whether nothing can be added any more."""
        return self._failed or self._file.closed

    @property
    def size(self) -> int:
        """Bytes of the file so far, without the chunk being filled."""
        return self._end

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; return its number."""
        schema = mcap_records.Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._chunk.add(_bytes_of(schema))
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str] | None = None) -> int:
        """Add a channel; return its number."""
        channel = mcap_records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=metadata or {},
        )
        self._channels.append(channel)
        self._chunk.add(_bytes_of(channel))
        return channel.id

    def add_message(self, channel: int, t_ns: int, sequence: int, *parts: Buffer, sent_ns: int | None = None) -> None:
        """Add a message made of parts, which must not change any more. Raises Inconsistent where time runs backwards.

        sent_ns: of a message of another file, which is copied with its times as they are.
        Nothing is written before flush_due or flush, so that messages which belong together share a chunk.
        """
        last_ns = self._last_ns.get(channel, t_ns)
        if t_ns < last_ns and sent_ns is None:
            topic = self._channels[channel - 1].topic
            raise Inconsistent(
                f"time runs backwards by {(last_ns - t_ns) / 1e9:.6g} s at message {sequence} of {topic}",
                consequence="Recording stops here; what was recorded until then is kept",
                cure="Look for two sources on one channel, or for a clock that was set",
            )
        if t_ns < 0:
            raise Inconsistent("a recording cannot hold times before 1970", cure="Set origin_ns")
        self._last_ns[channel] = t_ns
        chunk = self._chunk
        if not chunk.index:
            chunk.begun_s = self._clock.now_s()
        chunk.index.setdefault(channel, []).append((t_ns, chunk.size))
        sent_ns = t_ns if sent_ns is None else sent_ns
        length = MESSAGE_HEAD.size - 9 + sum(len(part) for part in parts)
        chunk.add(MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, t_ns, sent_ns))
        for part in parts:
            chunk.add(part)

    def add_attachment(self, name: str, media_type: str, data: bytes, t_ns: int, created_ns: int = 0) -> None:
        """Write a file into this one."""
        self.flush()
        record = _bytes_of(
            mcap_records.Attachment(create_time=created_ns, log_time=t_ns, name=name, media_type=media_type, data=data)
        )
        index = mcap_records.AttachmentIndex(
            offset=self._end,
            length=len(record),
            create_time=created_ns,
            log_time=t_ns,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._commit([record], attachment=index)

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Write names and values into the file."""
        self.flush()
        record = _bytes_of(mcap_records.Metadata(name=name, metadata=content))
        self._commit([record], metadata=mcap_records.MetadataIndex(offset=self._end, length=len(record), name=name))

    def flush_due(self) -> bool:
        """Write the chunk where it is old or large enough; tell whether it was."""
        chunk = self._chunk
        if not chunk.index:
            return False
        if chunk.size < self._chunk_bytes and self._clock.now_s() - chunk.begun_s < self._chunk_s:
            return False
        self.flush()
        return True

    def flush(self) -> None:
        """Give what waits to the system: from then on it survives this program."""
        chunk = self._chunk
        if not chunk.index:
            return
        self._chunk = _Chunk()
        times = [t_ns for records in chunk.index.values() for t_ns, _ in records]
        first_ns, last_ns = min(times), max(times)
        length = CHUNK_HEAD.size - 9 + chunk.size
        head = CHUNK_HEAD.pack(Opcode.CHUNK, length, first_ns, last_ns, chunk.size, chunk.crc, 0, chunk.size)
        at = self._end + len(head) + chunk.size
        indexes = bytearray()
        offsets: dict[int, int] = {}
        for channel, records in chunk.index.items():
            offsets[channel] = at + len(indexes)
            indexes += _bytes_of(mcap_records.MessageIndex(channel_id=channel, records=records))
        index = mcap_records.ChunkIndex(
            chunk_start_offset=self._end,
            chunk_length=len(head) + chunk.size,
            compression="",
            compressed_size=chunk.size,
            uncompressed_size=chunk.size,
            message_start_time=first_ns,
            message_end_time=last_ns,
            message_index_length=len(indexes),
            message_index_offsets=offsets,
        )
        counts = {channel: len(records) for channel, records in chunk.index.items()}
        self._commit([head, *chunk.parts, indexes], chunk=index, counts=counts)

    def sync(self) -> None:
        """Wait until the disk has what the system was given: from then on it survives a power cut."""
        with contextlib.suppress(ValueError):  # closed meanwhile by another thread
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write what waits, the index and the end; sync the disk. A second call does nothing."""
        if self._file.closed:
            return
        try:
            if not self._failed:
                self.flush()
                self._finish()
        finally:
            self._file.close()

    def _commit(
        self,
        parts: list[bytes | bytearray | memoryview],
        *,
        chunk: mcap_records.ChunkIndex | None = None,
        counts: dict[int, int] | None = None,
        attachment: mcap_records.AttachmentIndex | None = None,
        metadata: mcap_records.MetadataIndex | None = None,
    ) -> None:
        """Write the parts; where the disk refuses, cut the file back to its last whole step and close it there."""
        if self.closed:
            raise self._refused("it is closed")
        try:
            _write_all(self._file, parts)
        except OSError as error:
            self._failed = True
            self._salvage()
            raise self._refused(error.strerror or str(error)) from error
        self._end += sum(len(part) for part in parts)
        step = _Written(end=self._end, chunk=chunk, counts=counts or {}, attachment=attachment, metadata=metadata)
        self._steps.append(step)

    def _finish(self) -> None:
        try:
            _write_all(self._file, [self._summary()])
            os.fsync(self._file.fileno())
        except OSError as error:
            self._failed = True
            self._salvage()
            raise self._refused(error.strerror or str(error)) from error

    def _salvage(self) -> None:
        while self._steps:
            try:
                self._file.seek(self._end)
                self._file.truncate()
                _write_all(self._file, [self._summary()])
                os.fsync(self._file.fileno())
                return
            except OSError:
                self._steps.pop()
                self._end = self._steps[-1].end if self._steps else 0

    def _summary(self) -> bytes:
        """Return all that follows the data: MCAP's summary section, footer and magic."""
        data_end = _bytes_of(mcap_records.DataEnd(data_section_crc=0))
        start = self._end + len(data_end)
        groups: list[tuple[Opcode, list[mcap_records.McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas)),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [step.chunk for step in self._steps if step.chunk]),
            (Opcode.ATTACHMENT_INDEX, [step.attachment for step in self._steps if step.attachment]),
            (Opcode.METADATA_INDEX, [step.metadata for step in self._steps if step.metadata]),
        ]
        out, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            begin = len(out)
            for record in records:
                out += _bytes_of(record)
            if records:
                offset = mcap_records.SummaryOffset(
                    group_opcode=opcode, group_start=start + begin, group_length=len(out) - begin
                )
                offsets += _bytes_of(offset)
        offset_start = start + len(out)
        out += offsets
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start), zlib.crc32(out))
        footer = mcap_records.Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)
        return data_end + bytes(out) + _bytes_of(footer) + MAGIC

    def _statistics(self) -> mcap_records.Statistics:
        chunks = [step.chunk for step in self._steps if step.chunk]
        counts: Counter[int] = Counter()
        for step in self._steps:
            counts.update(step.counts)
        return mcap_records.Statistics(
            message_count=counts.total(),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=sum(step.attachment is not None for step in self._steps),
            metadata_count=sum(step.metadata is not None for step in self._steps),
            chunk_count=len(chunks),
            message_start_time=min((chunk.message_start_time for chunk in chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in chunks), default=0),
            channel_message_counts=dict(counts),
        )

    def _refused(self, reason: str) -> DeviceFailed:
        return DeviceFailed(
            f"{self.path}: cannot be written any further ({reason})",
            consequence=f"The recording ends there; the {self._end / 1e6:.1f} MB until then are whole and readable",
            cure="Check the free space and the limits on a file's size, or record to another disk",
        )


def _create(path: Path, overwrite: bool) -> FileIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        own = overwrite and (path.is_file() or not path.exists())  # a device is never replaced, nor deleted later
        return FileIO(path, "w" if own else "x")
    except FileExistsError:
        raise UsageError(
            f"{path} is there already",
            consequence="Nothing was recorded, and the file is as it was",
            cure="Choose another name, or give --overwrite",
        ) from None
    except (OSError, ValueError) as error:
        raise DeviceFailed(
            f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})",
            consequence="Nothing was recorded, and the file is as it was",
            cure="Check the folder, its permissions and the free space, or choose another place",
        ) from error


def _bytes_of(record: mcap_records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _write_all(file: FileIO, parts: list[bytes | bytearray | memoryview]) -> None:
    for part in parts:
        rest = memoryview(part)
        while rest:
            rest = rest[file.write(rest) :]
