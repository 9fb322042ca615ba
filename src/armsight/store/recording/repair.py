"""A file cut off by a crash, or damaged within, made whole again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from armsight._files import open_file
from armsight.errors import BadFile, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.records.output import Output, output
from armsight.store.recording import record_reader
from armsight.store.recording.mcapfile import MAGIC, McapFile

CALIBRATION = ("/calibration", "/tf")
"""Ends of the topics that say where the cameras are: they stand once, before the frames."""


@output
class Repaired(Output):
    """armsight record --repair."""

    file: Annotated[str, Doc("The mended recording.")]
    messages: Annotated[dict[str, int], Doc("Messages saved by topic.")]
    duration_s: Annotated[float, Doc("From the first message to the last, s.")]
    lost_bytes: Annotated[int, Doc("Bytes that were not whole.")]
    damaged_chunks: Annotated[int, Doc("Chunks whose checksum does not fit.")]


def repair(source: Path, out: Path, *, overwrite: bool = False, within_ns: tuple[int, int] | None = None) -> Repaired:
    """Copy all that is whole in source into a new, complete file; source is only read.

    within_ns: only messages of these times, see cut.
    A chunk whose checksum does not fit is left out, those behind it are kept. Raises BadFile where source is no MCAP
    file, NotEnoughData where no message is whole, UsageError where out is there already, or is source, DeviceFailed.
    """
    if out.exists() and source.exists() and out.samefile(source):
        raise UsageError(f"{source} is both source and result", cure="Write to another file")
    try:
        file = open_file(source)
    except OSError as error:
        raise BadFile(f"{source}: cannot be read ({error.strerror or error})", cure="Check the path") from error
    with file:
        record_reader.check_magic(file, source)
        begin = len(MAGIC) + record_reader.HEAD  # of the header, which first says what the file is of, such as ros2
        length = int.from_bytes(record_reader.read_at(file, begin, 4), "little")
        profile = str(record_reader.read_at(file, begin + 4, min(length, 80)), "utf-8", "replace")
        copy = _Copy(McapFile(out, overwrite=overwrite, profile=profile), within_ns)
        try:
            copy.all_of(file, source)
        finally:
            copy.out.close()
    if not copy.n_kept:
        out.unlink()
        if copy.counts:
            raise NotEnoughData(
                f"{source}: nothing was recorded between these times",
                consequence="Nothing is saved",
                cure="Give others",
            )
        raise NotEnoughData(
            f"{source}: not one message in it is whole", consequence="Nothing can be saved", cure="Record anew"
        )
    return Repaired(
        file=str(out),
        messages=dict(copy.counts),
        duration_s=(copy.last_ns - copy.first_ns) / 1e9,
        lost_bytes=copy.lost_bytes,
        damaged_chunks=copy.damaged,
    )


def cut(source: Path, out: Path, first_ns: int, last_ns: int, *, overwrite: bool = False) -> Repaired:
    """Copy what is between two times into a new file, with the calibration and the files in it. Raises as repair."""
    return repair(source, out, overwrite=overwrite, within_ns=(first_ns, last_ns))


class _Copy:
    """Copies records and counts them; numbers of schemas and channels may differ in the copy.

    within_ns: the times of messages that are copied; those of calibrations are always. n_kept: of all messages, or of
    those within these times.
    """

    def __init__(self, out: McapFile, within_ns: tuple[int, int] | None = None) -> None:
        self.out = out
        self._within_ns = within_ns
        self.counts: dict[str, int] = {}
        self.first_ns = self.last_ns = self.n_kept = 0
        self.lost_bytes = 0
        self.damaged = 0
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, tuple[int, str]] = {}

    def all_of(self, file: BinaryIO, path: Path) -> None:
        """Copy every whole record."""
        size = file.seek(0, 2)
        readable_bytes = len(MAGIC)
        for span in record_reader.spans(file, len(MAGIC), size):
            readable_bytes = span.end
            if span.opcode == Opcode.DATA_END:
                readable_bytes = size
                break
            try:
                self._span(file, span, path)
            except (BadFile, ValueError):
                self.damaged += 1
                self.lost_bytes += span.length
        self.lost_bytes += size - readable_bytes

    def _span(self, file: BinaryIO, span: record_reader.Span, path: Path) -> None:
        if span.opcode == Opcode.CHUNK:
            data = record_reader.chunk_data(file, record_reader.chunk_span(file, span, path), path)
            for record in list(record_reader.inner_records(data)):
                self._record(record)
            self.out.flush()  # the chunks of the copy are those of the source
        elif span.opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            for record in _single(file, span):
                self._record(record)
            self.out.flush_due()
        elif span.opcode == Opcode.ATTACHMENT:
            it = record_reader.record_at(file, span, Attachment)
            self.out.add_attachment(it.name, it.media_type, it.data, it.log_time, it.create_time)
        elif span.opcode == Opcode.METADATA:
            meta = record_reader.record_at(file, span, Metadata)
            self.out.add_metadata(meta.name, meta.metadata)

    def _record(self, record: record_reader.Message | Schema | Channel) -> None:
        if isinstance(record, Schema):
            if record.id not in self._schemas:
                self._schemas[record.id] = self.out.add_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            if record.id not in self._channels:
                schema = self._schemas.get(record.schema_id, 0)
                number = self.out.add_channel(record.topic, record.message_encoding, schema, record.metadata)
                self._channels[record.id] = (number, record.topic)
        elif record.channel in self._channels:
            number, topic = self._channels[record.channel]
            first_ns, last_ns = self._within_ns or (record.t_ns, record.t_ns)
            if not first_ns <= record.t_ns <= last_ns and not topic.endswith(CALIBRATION):
                return
            self.out.add_message(number, record.t_ns, record.sequence, record.data, sent_ns=record.sent_ns)
            self.counts[topic] = self.counts.get(topic, 0) + 1
            if self._within_ns is None or not topic.endswith(CALIBRATION):
                self.first_ns = min(self.first_ns, record.t_ns) if self.n_kept else record.t_ns
                self.last_ns = max(self.last_ns, record.t_ns)
                self.n_kept += 1


def _single(file: BinaryIO, span: record_reader.Span) -> Iterator[record_reader.Message | Schema | Channel]:
    return record_reader.inner_records(
        record_reader.read_at(file, span.start - record_reader.HEAD, span.length + record_reader.HEAD)
    )
