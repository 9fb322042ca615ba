"""A recording opened by the mcap package's own reader: checked against its checksums and index, bit for bit."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from armsight.optics import SIDES, Camera, parallel_rig
from armsight.records import Frame
from armsight.store.recording import ImageFormat, RecordingWriter, encode

ORIGIN_NS = 1_700_000_000_000_000_000


def wire(data: bytes) -> dict[int, bytes | int]:
    """Read a protobuf message; written for this test alone."""
    out: dict[int, bytes | int] = {}
    i = 0

    def number() -> int:
        nonlocal i
        value = shift = 0
        while True:
            byte = data[i]
            i += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while i < len(data):
        key = number()
        if key & 7 == 0:
            out[key >> 3] = number()
        elif key & 7 == 2:
            size = number()
            out[key >> 3] = data[i : i + size]
            i += size
        else:
            assert key & 7 == 5
            (out[key >> 3],) = struct.unpack_from("<I", data, i)
            i += 4
    return out


@pytest.fixture
def images() -> list[np.ndarray]:
    rng = np.random.default_rng(11)
    return [rng.integers(0, 256, (48, 64), dtype=np.uint8) for _ in range(20)]


def record(path: Path, images: list[np.ndarray], kind: ImageFormat) -> None:
    camera = Camera.pinhole(64, 48, 100.0, 101.0, 31.5, 23.5)
    with RecordingWriter(path, origin_ns=ORIGIN_NS, chunk_bytes=9000) as writer:
        writer.attach("rig.yaml", b"format: armsight/rig\n")
        writer.rig(0.0, parallel_rig(camera, 0.12))
        for i in range(0, len(images), 2):
            pair = [Frame(image=images[i + k], t_s=i / 60.0, sequence=i // 2, source="s") for k in range(2)]
            views = dict(zip(SIDES, pair, strict=True))
            writer.moment(views, {side: encode(one.image, kind) for side, one in views.items()})


@pytest.mark.parametrize("kind", [ImageFormat.RAW, ImageFormat.PNG])
def test_the_stock_reader_reads_it_bit_for_bit(tmp_path: Path, images: list[np.ndarray], kind: ImageFormat) -> None:
    path = tmp_path / "a.mcap"
    record(path, images, kind)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 20 + 4
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 2
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("rig.yaml", b"format: armsight/rig\n")]
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        assert metadata["armsight"]["origin_ns"] == str(ORIGIN_NS)
        back = []
        for schema, channel, message in reader.iter_messages(topics=["/left/image", "/right/image"]):
            assert schema is not None
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            back.append(pixels(schema.name, message.data, channel.topic.split("/")[1]))
            assert message.log_time == ORIGIN_NS + round(message.sequence * 2 / 60.0 * 1e9)
    assert len(back) == len(images)
    for here, there in zip(images, back, strict=True):
        np.testing.assert_array_equal(here, there)


def pixels(schema: str, data: bytes, frame_id: str) -> np.ndarray:
    content = wire(data)
    if schema == "foxglove.CompressedImage":
        assert (content[3], content[4]) == (b"png", frame_id.encode())
        return cv2.imdecode(np.frombuffer(content[2], np.uint8), cv2.IMREAD_UNCHANGED)
    assert schema == "foxglove.RawImage"
    assert (content[4], content[7], content[5]) == (b"mono8", frame_id.encode(), 64)
    return np.frombuffer(content[6], np.uint8).reshape(content[3], content[2])


def test_the_stock_stream_reader_finds_every_record_in_order(tmp_path: Path, images: list[np.ndarray]) -> None:
    path = tmp_path / "a.mcap"
    record(path, images, ImageFormat.RAW)
    with path.open("rb") as file:
        names = [type(item).__name__ for item in StreamReader(file, validate_crcs=True).records]
    assert names[0] == "Header"
    assert names[-1] == "Footer"
    assert names.count("Message") == 24
    assert {"DataEnd", "Statistics", "SummaryOffset", "MetadataIndex", "AttachmentIndex"} <= set(names)


def test_calibration_reads_as_foxglove_defines_it(tmp_path: Path, images: list[np.ndarray]) -> None:
    path = tmp_path / "a.mcap"
    record(path, images, ImageFormat.RAW)
    with path.open("rb") as file:
        found = {
            (schema.name, channel.topic): json.loads(message.data)
            for schema, channel, message in make_reader(file).iter_messages(
                topics=["/left/calibration", "/right/calibration", "/tf"]
            )
            if schema is not None
        }
    left = found["foxglove.CameraCalibration", "/left/calibration"]
    assert left["K"] == [100.0, 0.0, 31.5, 0.0, 101.0, 23.5, 0.0, 0.0, 1.0]
    assert (left["frame_id"], left["width"], left["distortion_model"]) == ("left", 64, "plumb_bob")
    assert left["timestamp"] == {"sec": ORIGIN_NS // 10**9, "nsec": 0}
    right = found["foxglove.FrameTransform", "/tf"]
    assert (right["parent_frame_id"], right["child_frame_id"]) == ("rig", "right")
    assert right["translation"]["x"] == pytest.approx(0.12)


def test_the_schemas_are_what_protobuf_says_they_are() -> None:
    descriptor_pb2 = pytest.importorskip("google.protobuf.descriptor_pb2")
    from google.protobuf import descriptor_pool, message_factory

    from armsight.store.recording.schemas import compressed_image_head, descriptor_set, raw_image_head

    heads = {
        "RawImage": raw_image_head(1_500_000_000, "left", (2, 3), "mono8") + b"abcdef",
        "CompressedImage": compressed_image_head(1_500_000_000, "left", "png", 6) + b"abcdef",
    }
    for name, data in heads.items():
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(name)).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
        message = kind.FromString(data)
        assert (message.timestamp.seconds, message.timestamp.nanos) == (1, 500_000_000)
        assert (message.frame_id, message.data) == ("left", b"abcdef")
        if name == "RawImage":
            assert (message.width, message.height, message.step, message.encoding) == (3, 2, 3, "mono8")
