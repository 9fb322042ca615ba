"""Walking through an MCAP file record by record, as far as it is whole: no index is needed and none is trusted."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]  # it ships no types
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from armsight.errors import BadFile
from armsight.store.recording.mcapfile import CHUNK_HEAD, MAGIC, MESSAGE_HEAD

T = TypeVar("T", Schema, Channel, Attachment, Metadata)

RECORD_HEAD = struct.Struct("<BQ")
HEAD = RECORD_HEAD.size

MAX_CHUNK = 1 << 30
"""Ours have 8 MB and at most one pair more; a length beyond this is a damaged file."""

MAX_SMALL = 1 << 26
"""Of an attachment, schema or channel: the largest of ours, a rig with its covariance, has 20 kB."""

PARSE_ERRORS = (struct.error, ValueError, OverflowError, McapError, IndexError)


class Span(NamedTuple):
    """A record: its opcode, where its content starts, and its length without the head."""

    opcode: int
    start: int
    length: int

    @property
    def end(self) -> int:
        """The byte behind it."""
        return self.start + self.length


class Message(NamedTuple):
    """A message within a chunk's data."""

    channel: int
    sequence: int
    t_ns: int
    data: memoryview
    sent_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkSpan:
    """A whole chunk: where its records stand in the file, how they are compressed."""

    start: int
    stored: int
    size: int
    crc: int
    compression: str


def read_at(file: BinaryIO, start: int, length: int) -> bytes:
    """Return length bytes from start, fewer at the file's end."""
    file.seek(start)
    return file.read(length)


def check_magic(file: BinaryIO, path: Path) -> None:
    """Raise BadFile where the file does not begin as MCAP does."""
    begin = read_at(file, 0, len(MAGIC))
    if begin == MAGIC:
        return
    raise BadFile(
        f"{path}: the file is empty" if not begin else f"{path} is no MCAP recording: it begins with {begin.hex(' ')}",
        consequence="Nothing can be read from it",
        cure="Give a file that `armsight record` or another MCAP program wrote",
    )


def spans(file: BinaryIO, start: int, end: int) -> Iterator[Span]:
    """Yield the records from start on that end before `end`; stops at the first that does not."""
    at = start
    while at + HEAD <= end:
        opcode, length = RECORD_HEAD.unpack(read_at(file, at, HEAD))
        if opcode == 0 or length > end - at - HEAD:
            return
        span = Span(opcode, at + HEAD, length)
        yield span
        at = span.end


def chunk_span(file: BinaryIO, span: Span, path: Path) -> ChunkSpan:
    """Return what a chunk's head says. Raises BadFile where it cannot be."""
    head = read_at(file, span.start, CHUNK_HEAD.size - HEAD - 8)
    try:
        _, _, size, crc, name_length = struct.unpack("<QQQII", head)
        name_end = span.start + len(head) + name_length
        if name_length > 100 or name_end + 8 > span.end:
            raise ValueError("its compression's name is too long")
        compression = str(read_at(file, name_end - name_length, name_length), "utf-8")
        (stored,) = struct.unpack("<Q", read_at(file, name_end, 8))
        if stored > span.end - name_end - 8 or max(stored, size) > MAX_CHUNK:
            raise ValueError(f"{size} bytes in {stored}")
    except (struct.error, ValueError) as error:
        raise damaged(path, span, str(error)) from error
    return ChunkSpan(start=name_end + 8, stored=stored, size=size, crc=crc, compression=compression)


def chunk_data(file: BinaryIO, chunk: ChunkSpan, path: Path) -> bytes:
    """Return a chunk's records, checked. Raises BadFile where they are damaged."""
    stored = read_at(file, chunk.start, chunk.stored)
    try:
        data = _decompressed(stored, chunk)
    except (RuntimeError, zstandard.ZstdError, ValueError, EOFError, MemoryError) as error:
        raise damaged(path, chunk, f"{chunk.compression}: {error}") from error
    if len(data) != chunk.size or (chunk.crc and zlib.crc32(data) != chunk.crc):
        raise damaged(path, chunk, "its checksum or size does not fit its content")
    return data


def _decompressed(stored: bytes, chunk: ChunkSpan) -> bytes:
    """Return what was stored, at most a byte more than the chunk says: a few bytes can unpack to any size."""
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(stored) as reader:
            return bytes(reader.read(chunk.size + 1))
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=chunk.size + 1))
    if chunk.compression:
        raise ValueError("an unknown compression")
    return stored


def inner_records(data: bytes) -> Iterator[Message | Schema | Channel]:
    """Yield the messages, schemas and channels in a chunk's records. Raises ValueError where they are damaged."""
    view = memoryview(data).toreadonly()
    at = 0
    while at < len(view):
        if at + HEAD > len(view):
            raise ValueError("a record is cut off")
        opcode, length = RECORD_HEAD.unpack_from(view, at)
        end = at + HEAD + length
        if end > len(view):
            raise ValueError("a record is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            yield message_of(view[at:end])
        elif opcode == Opcode.SCHEMA:
            yield _parsed(Schema, bytes(view[at + HEAD : end]))
        elif opcode == Opcode.CHANNEL:
            yield _parsed(Channel, bytes(view[at + HEAD : end]))
        at = end


def message_of(record: memoryview) -> Message:
    """Return the message in a whole record. Raises ValueError."""
    if len(record) < MESSAGE_HEAD.size:
        raise ValueError("a message is shorter than its head")
    _, _, channel, sequence, t_ns, sent_ns = MESSAGE_HEAD.unpack_from(record)
    return Message(channel, sequence, t_ns, record[MESSAGE_HEAD.size :], sent_ns)


def record_at(file: BinaryIO, span: Span, kind: type[T]) -> T:
    """Return the record of this kind at a place in a file. Raises ValueError where it cannot be read."""
    return _parsed(kind, read_at(file, span.start, span.length))


def _parsed(kind: type[T], body: bytes) -> T:
    try:
        record: T = kind.read(ReadDataStream(BytesIO(body)))
        return record
    except PARSE_ERRORS as error:
        raise ValueError(f"a {kind.__name__.lower()} record cannot be read ({error})") from error


def damaged(path: Path, span: Span | ChunkSpan, reason: str) -> BadFile:
    """Return the error for a damaged record."""
    return BadFile(
        f"{path}: damaged at byte {span.start} ({reason})",
        consequence="What follows there is not read",
        cure="`armsight record --repair` makes a readable file of what is whole",
    )
