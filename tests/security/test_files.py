"""Files that were made to harm who reads them: they unpack, expand, nest or claim without end, or hold other things."""

from __future__ import annotations

import io
import resource
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from scipy.io import savemat

from armsight.drivers import egm as packets
from armsight.drivers import images as image_files
from armsight.drivers import rsi
from armsight.drivers.images import LARGEST_PX, said_size
from armsight.drivers.rsi import read_tags
from armsight.errors import BadFile, BadImage, DataRefused
from armsight.ops.compare.runs import shared
from armsight.ops.recording.export import export
from armsight.store import read_rig, read_target
from armsight.store.arm_file import read_arm
from armsight.store.interpret import other_files
from armsight.store.recording import record_reader
from armsight.store.recording.images import decode
from armsight.store.recording.mcapfile import CHUNK_HEAD, MAGIC, McapFile
from armsight.store.recording.reader import Recording
from armsight.store.recording.repair import repair
from armsight.store.recording.schemas import COMPRESSED_IMAGE, LOG, RAW_IMAGE, fields
from armsight.store.tokens import read_tokens
from armsight.store.urdf import arm_from_urdf, read_urdf
from armsight.store.yamls import parse_yaml, parse_yaml_documents
from refusals import refuses

MOST_BYTES = 300_000_000
"""More memory than this for a file of a few kilobytes is harm."""


@pytest.fixture
def bounded() -> Any:
    """Let the test take no more memory than MOST_BYTES beyond what this process has: what takes more fails in it."""
    status = Path("/proc/self/statm").read_text().split()
    size = int(status[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + MOST_BYTES, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


LAUGHS = "\n".join(
    ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    + [f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
)
YAMLS = {
    "aliases that multiply": LAUGHS,
    "an alias within itself": "a: &a [*a]",
    "lists within lists": "a: " + "[" * 20_000,
    "mappings within mappings": "{a: " * 20_000,
    "indents": "\n".join(" " * i + "a:" for i in range(600)),
    "an object of Python": "a: !!python/object/apply:os.system [echo]",
    "a module of Python": "a: !!python/module:os",
    "a name of Python": "a: !!python/name:os.system",
    "a tag of its own": "a: !mine {b: 1}",
    "a huge number": "a: " + "9" * 400_000,
    "a merge": "a: &a {b: 1}\nc: {<<: *a}\nd: !!merge x",
    "bytes": "a: !!binary aGk=",
    "a key that is a list": "? [1, 2]\n: 3",
    "no UTF-8": "a: \udcff",
    "half a letter": 'a: "\\ud800"',
    "zero bytes": "a: \0",
    "many values": "a: [" + "1," * 40_000 + "]",
}


@pytest.mark.parametrize("text", YAMLS.values(), ids=YAMLS)
def test_harmful_yaml_is_refused(text: str, bounded: None) -> None:
    data = text.encode("utf-8", "surrogateescape")
    for read in (parse_yaml, parse_yaml_documents):
        with pytest.raises(BadFile):
            read(data, "x.yaml")


@pytest.mark.parametrize("read", [read_rig, read_target, read_arm, read_tokens])
@pytest.mark.parametrize("number", ["0x" + "f" * 400_000, "1e999999", "-" + "9" * 4299, ".inf", ".nan"])
def test_numbers_without_measure_are_refused_in_words(read: Callable[[Path], Any], number: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"format: armsight/{read.__name__[5:]}\nversion: {number}\nkind: {number}\njoints: [{number}]\n")
    with pytest.raises(BadFile) as caught:
        read(path)
    assert len(str(caught.value)) < 2000


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int) -> bytes:
    """Return a whole black PNG of this size, a thousandth as large."""
    packer = zlib.compressobj(1)
    rows = b"\0" * (width + 1)
    packed = b"".join(packer.compress(rows) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def tiff(width: int, height: int, order: str) -> bytes:
    mark = b"II*\0" if order == "<" else b"MM\0*"
    tags = b"".join(struct.pack(order + "HHII", tag, 4, 1, value) for tag, value in ((256, width), (257, height)))
    return mark + struct.pack(order + "IH", 8, 2) + tags


def jpeg(width: int, height: int) -> bytes:
    frame = struct.pack(">BBHBHHB", 0xFF, 0xC0, 17, 8, height, width, 3) + bytes(9)
    return b"\xff\xd8\xff\xe0\x00\x04ab" + frame + b"\xff\xda\x00\x02\xff\xd9"


def bmp(width: int, height: int) -> bytes:
    return b"BM" + bytes(12) + struct.pack("<Iii", 40, width, -height) + bytes(40)


HUGE = {
    "png": b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 16, 6, 0, 0, 0))
    + chunk(b"IEND", b""),
    "tiff": tiff(100_000, 100_000, "<"),
    "tiff of Motorola": tiff(100_000, 100_000, ">"),
    "jpeg": jpeg(65_000, 65_000),
    "bmp": bmp(100_000, 100_000),
    "webp lossless": b"RIFF" + bytes(4) + b"WEBPVP8L" + bytes(4) + b"\x2f" + b"\xff\xff\xff\x0f",
    "webp extended": b"RIFF" + bytes(4) + b"WEBPVP8X" + bytes(8) + b"\xff\xff\x00" * 2,
    "pgm": b"P5\n# a remark\n100000 100000\n255\n" + bytes(10),
    "ppm": b"P6 100000 100000 255\n" + bytes(10),
}  # fmt: skip
OTHER_KINDS = {
    "exr": b"\x76\x2f\x31\x01" + bytes(100),
    "hdr": b"#?RADIANCE\n\n-Y 100000 +X 100000\n",
    "jpeg 2000": b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(100),
    "sun raster": b"\x59\xa6\x6a\x95" + struct.pack(">II", 100_000, 100_000) + bytes(20),
    "pam": b"P7\nWIDTH 100000\nHEIGHT 100000\nDEPTH 1\nMAXVAL 255\nENDHDR\n",
    "pfm": b"Pf\n100000 100000\n-1\n",
    "gif": b"GIF89a" + struct.pack("<HH", 65000, 65000) + bytes(20),
    "svg": b"<svg xmlns='http://www.w3.org/2000/svg' width='1e9' height='1e9'/>",
    "nothing": b"",
    "text": b"rig",
}


@pytest.mark.parametrize("data", [*HUGE.values(), *OTHER_KINDS.values()], ids=[*HUGE, *OTHER_KINDS])
def test_no_decoder_sees_an_image_that_is_huge_or_of_another_kind(
    data: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def decoder(*_: object) -> None:
        raise AssertionError("it was given to the decoder")

    monkeypatch.setattr(cv2, "imdecode", decoder)
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(DataRefused):
        image_files.read_image(tmp_path / "x.png")
    with pytest.raises(DataRefused):
        decode(COMPRESSED_IMAGE, memoryview(b"\x12" + _varint(len(data)) + data), "x.mcap")


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def test_a_small_file_that_unpacks_to_a_huge_image_takes_no_memory(bounded: None) -> None:
    data = png(20_000, 20_000)
    assert len(data) < 2_000_000
    with refuses(BadImage, "20000 x 20000"):
        image_files.decode_image(data, "bomb.png")


def test_an_image_of_the_largest_size_is_let_through() -> None:
    assert not image_files.too_large(tiff(1 << 14, LARGEST_PX >> 14, "<"))
    assert image_files.too_large(tiff(1 << 14, (LARGEST_PX >> 14) + 1, "<"))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp", ".pgm", ".ppm"])
@pytest.mark.parametrize("shape", [(7, 13), (7, 13, 3)])
def test_what_opencv_writes_has_the_size_that_its_head_says(suffix: str, shape: tuple[int, ...]) -> None:
    if (suffix == ".pgm") is not (len(shape) == 2) and suffix in (".pgm", ".ppm"):
        pytest.skip("not of these colours")
    data = cv2.imencode(suffix, np.full(shape, 90, np.uint8))[1].tobytes()
    assert said_size(data) == (13, 7)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp", ".pgm"])
def test_every_beginning_of_an_image_is_read_or_refused(suffix: str) -> None:
    data = cv2.imencode(suffix, np.zeros((7, 13), np.uint8))[1].tobytes()
    for end in range(len(data)):
        said_size(data[:end])


def mcap_chunk(compression: str, stored: bytes, size: int) -> bytes:
    name = compression.encode()
    head = CHUNK_HEAD.pack(Opcode.CHUNK, CHUNK_HEAD.size - 9 + len(name) + len(stored), 0, 0, size, 0, len(name), 0)[
        :-8
    ]
    return head + name + struct.pack("<Q", len(stored)) + stored


ZEROS = bytes(64_000_000)
BOMBS = {
    "lz4": lz4.frame.compress(ZEROS),
    "zstd": zstandard.ZstdCompressor().compress(ZEROS),
    "zstd without its size": zstandard.ZstdCompressor(write_content_size=False).compress(ZEROS),
    "zstd that lies": b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 50) + b"\x01\x00\x00",
}
SAID = {"a little": 100, "a gigabyte": (1 << 30), "an exabyte": 1 << 60}


@pytest.mark.parametrize("said", SAID)
@pytest.mark.parametrize("kind", BOMBS)
def test_a_chunk_unpacks_to_what_it_says_and_no_further(
    kind: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bounded: None
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(MAGIC + mcap_chunk(kind.split()[0], BOMBS[kind], SAID[said]))
    largest = []
    monkeypatch.setattr(record_reader, "_decompressed", _noted(record_reader._decompressed, largest))
    with pytest.raises(BadFile, match="damaged"), Recording(path):
        pass
    assert all(n <= SAID[said] + 1 for n in largest)


def _noted(unpack: Callable[..., bytes], sizes: list[int]) -> Callable[..., bytes]:
    def noting(*given: Any) -> bytes:
        data = unpack(*given)
        sizes.append(len(data))
        return data

    return noting


@pytest.mark.parametrize("length", [0, 1, 8, (1 << 40), (1 << 64) - 1])
def test_lengths_that_cannot_be_end_the_reading(length: int, tmp_path: Path, bounded: None) -> None:
    path = tmp_path / "x.mcap"
    for opcode in (*range(1, 16), 0x80, 0xFF):
        path.write_bytes(MAGIC + struct.pack("<BQ", opcode, length) + b"\xff" * 16)
        for read in (lambda: Recording(path).close(), lambda: repair(path, tmp_path / "out.mcap", overwrite=True)):
            try:
                read()
            except DataRefused as error:
                assert str(error), opcode


@pytest.mark.parametrize("camera", ["../out", "..", "/etc/out", "a/../../out", ".hidden", "a//b", "a\\..\\b", "a\nb"])
def test_a_recordings_camera_names_no_folder_elsewhere(camera: str, tmp_path: Path) -> None:
    source = tmp_path / "x.mcap"
    with closing(McapFile(source)) as file:
        number = file.add_channel(f"/{camera}/image", "protobuf", file.add_schema(RAW_IMAGE, "protobuf", b""))
        file.add_message(number, 0, 0, b"")
    folder = tmp_path / "deep" / "out"
    with refuses(BadFile, "no folder"):
        export(source, folder)
    assert {path.name for path in tmp_path.iterdir()} == {"x.mcap", "deep"} and not list(folder.iterdir())


def test_json_that_is_deep_is_refused_wherever_it_stands(tmp_path: Path) -> None:
    source = tmp_path / "x.mcap"
    deep = b'{"a":' + b"[" * 100_000
    with closing(McapFile(source)) as file:
        number = file.add_channel("/events", "json", file.add_schema(LOG, "jsonschema", b"{}"))
        file.add_message(number, 0, 0, deep)
    with Recording(source) as recording, refuses(BadFile, "JSON"):
        list(recording.events())
    (tmp_path / "measure.json").write_bytes(deep)
    with pytest.raises(BadFile):
        shared(tmp_path / "poses.csv", tmp_path / "poses.csv")
    with pytest.raises(BadFile):
        parse_yaml(deep, "x.json")


ENTITIES = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True))
DOCTYPES = {
    "entities": f'<!DOCTYPE x [<!ENTITY a "{"a" * 1000}">{ENTITIES}]>',
    "a file": '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>',
    "an address": '<!DOCTYPE x SYSTEM "http://127.0.0.1:1/x.dtd">',
    "parameters": '<!DOCTYPE x [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]>',
}
ENCODINGS = ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp037", "cp500", "cp1140"]
ROB = "<Rob><AIPos " + " ".join(f'A{i}="0"' for i in range(1, 7)) + "/><IPOC>1</IPOC>{}</Rob>"
CONFIG = "<ROOT><CONFIG><SENTYPE>ImFree</SENTYPE></CONFIG><SEND/><RECEIVE/>{}</ROOT>"


def encoded(encoding: str, before: str, body: str) -> bytes:
    """Return XML in an encoding that its first line names; the line itself as that encoding's readers look for it."""
    line = f'<?xml version="1.0" encoding="{encoding.removesuffix("-le").removesuffix("-be")}"?>'
    rest = before + body
    if encoding.startswith("cp"):
        return line.encode() + rest.encode(encoding)
    return (line + rest).encode(encoding)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_declarations_are_seen_in_every_encoding(encoding: str, tmp_path: Path, bounded: None) -> None:
    for before in DOCTYPES.values():
        with pytest.raises(DataRefused):
            rsi.parse(encoded(encoding, before, ROB.format("<x>&a;</x>")))
        (tmp_path / "x.xml").write_bytes(encoded(encoding, before, CONFIG.format("<x>&a;</x>")))
        with pytest.raises(BadFile):
            read_tags(tmp_path / "x.xml")
        (tmp_path / "x.urdf").write_bytes(encoded(encoding, before, '<robot name="&a;"/>'))
        with pytest.raises(BadFile):
            read_urdf(tmp_path / "x.urdf")


def test_without_declarations_the_same_packet_is_read() -> None:
    assert rsi.parse(encoded("utf-8", "", ROB.format(""))).ipoc == 1


def test_the_packets_above_pass_a_reader_that_looks_for_bytes_only() -> None:
    import xml.etree.ElementTree as ET

    data = encoded("utf-16", '<!DOCTYPE x [<!ENTITY a "expanded">]>', ROB.format("<x>&a;</x>"))
    assert b"<!" not in data and ET.fromstring(data).findtext("x") == "expanded"


def test_xml_that_is_deep_is_refused(bounded: None) -> None:
    for text in ("<robot>" + "<a>" * 200_000 + "</a>" * 200_000 + "</robot>", "<robot>" + "<a>" * 200_000):
        with pytest.raises(BadFile):
            arm_from_urdf(text)


PACKETS = [b"", b"\0" * 1400, b"\xff" * 1400, b"\x0a\xff\xff\xff\xff\x0f", b"\x0b" * 500, b"\x0a\x80" * 700]


@pytest.mark.parametrize("data", PACKETS)
def test_packets_that_are_none_are_refused(data: bytes) -> None:
    for parse in (rsi.parse, lambda packet: packets.parse(packet, 6)):
        with pytest.raises(DataRefused):
            parse(data)
    try:
        fields(memoryview(data))
    except ValueError as error:
        assert str(error)


def mat(variables: dict[str, Any]) -> bytes:
    out = io.BytesIO()
    savemat(out, variables, do_compression=True)
    return out.getvalue()


def lying_mat(size: int) -> bytes:
    """Return a .mat whose one variable says 1 x 1 and unpacks to size bytes of zeros."""
    head = mat({"x": np.ones((1, 1))})[:128]
    inner = zlib.decompressobj().decompress(mat({"x": np.ones((1, 1))})[136:])
    packed = zlib.compress(inner[:-16] + struct.pack("<II", 9, size) + bytes(size), 9)
    return head + struct.pack("<II", 15, len(packed)) + packed


def test_matlab_variables_unpack_to_so_much_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bounded: None
) -> None:
    path = tmp_path / "x.mat"
    monkeypatch.setattr(other_files, "MAT_BYTES", 1_000_000)
    for data in (mat({"x": np.zeros((1000, 1000))}), lying_mat(40_000_000)):
        path.write_bytes(data)
        assert len(data) < 100_000
        with refuses(BadFile, "unpack"):
            other_files.mat_table(path)
    path.write_bytes(mat({"q_deg": np.ones((4, 6))}))
    assert len(other_files.mat_table(path).columns[0]) > 1


def test_only_numbers_of_a_matlab_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(mat({"q_deg": np.ones((4, 6)), "s": {"a": {"b": 1}}, "c": np.array([{}, "x"], object), "t": "x"}))
    found = other_files._loaded(path.read_bytes(), other_files.MAT_NUMBERS)
    assert {name for name in found if not name.startswith("__")} == {"q_deg"}
