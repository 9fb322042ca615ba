"""Bags as recorders, players and editors leave them: what metadata.yaml says of them, what stands beside them."""

import hashlib
import re
import shlex
import shutil
import sqlite3
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

pytest.importorskip("rosbags", reason="the extra armsight[bags] is not installed")
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from armsight.errors import BadFile
from armsight.ops.sources.bags import BagFrames
from armsight.store import bags
from refusals import refuses

STORE = get_typestore(Stores.ROS2_HUMBLE)
IMAGE = "sensor_msgs/msg/Image"
BEGIN_NS, STEP_NS, COUNT = 1_700_000_000_000_000_000, 40_000_000, 10
TIMES = [i * STEP_NS / 1e9 for i in range(COUNT)]
PLUGINS = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
PROFILE = {
    "history": 3,
    "depth": 0,
    "reliability": 1,
    "durability": 2,
    "deadline": {"sec": 9223372036, "nsec": 854775807},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": 1,
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
"""As ROS 2 Foxy to Iron writes it."""
NAMED = {**PROFILE, "history": "keep_last", "depth": 5, "reliability": "best_effort", "durability": "volatile"}
NAMED["liveliness"] = "automatic"
"""As ROS 2 Jazzy and later write it."""


def image_of(i: int, data: np.ndarray | None = None, encoding: str = "mono8", step: int = 0) -> Any:
    """Return an image of 6x4 px, all of the value i, or of the data."""
    make = STORE.types
    ns = BEGIN_NS + i * STEP_NS
    header = make["std_msgs/msg/Header"](make["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), "camera")
    data = np.full((4, 6), i, np.uint8) if data is None else data
    rows = data.reshape(len(data), -1)
    return make[IMAGE](header, len(data), data.shape[1], encoding, 0, step or rows.shape[1], rows.ravel())


def cdr(i: int) -> bytes:
    return bytes(STORE.serialize_cdr(image_of(i), IMAGE))


def written(folder: Path, plugin: StoragePlugin, version: Any = 9) -> Path:
    """Write ten images to /camera with the stock writer."""
    with Writer(folder, version=version, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/camera", IMAGE, typestore=STORE)
        for i in range(COUNT):
            writer.write(topic, BEGIN_NS + i * STEP_NS, cdr(i))
    return folder


def data_of(folder: Path) -> Path:
    return next(one for one in folder.iterdir() if one.suffix in (".db3", ".mcap"))


def read(path: Path, topic: str = "/camera", colour: bool = False) -> list[Any]:
    with BagFrames(f"bag:{path}:{topic}", colour=colour) as source:
        frames = list(source)
        assert source.total == len(frames)
    return frames


def all_there(path: Path) -> bool:
    """Read all ten, each with its own picture and time."""
    frames = read(path)
    return [one.t_s for one in frames] == TIMES and [int(one.image[0, 0]) for one in frames] == list(range(COUNT))


def edited(folder: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    file = folder / "metadata.yaml"
    content = yaml.safe_load(file.read_text())
    change(content["rosbag2_bagfile_information"])
    file.write_text(yaml.safe_dump(content))
    return folder


def untouched(folder: Path) -> dict[str, str]:
    """Return names and contents of all files."""
    return {one.name: hashlib.sha256(one.read_bytes()).hexdigest() for one in folder.iterdir()}


@pytest.mark.parametrize("plugin", PLUGINS)
@pytest.mark.parametrize(
    ("version", "profiles"),
    [(5, yaml.safe_dump([{**PROFILE, "reliability": 2}])), (8, ""), (9, [NAMED, PROFILE]), (9, None)],
)
def test_what_is_said_of_quality_of_service_changes_nothing(
    tmp_path: Path, plugin: StoragePlugin, version: int, profiles: Any
) -> None:
    def change(content: dict[str, Any]) -> None:
        content["version"] = version
        content["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"] = profiles

    assert all_there(edited(written(tmp_path / "run", plugin), change))


@pytest.mark.parametrize("plugin", PLUGINS)
@pytest.mark.parametrize("text", [None, "rosbag2_bagfile_information:\n  version: 9\n  relative_", "- 1\n"])
def test_a_folder_whose_metadata_were_never_written(tmp_path: Path, plugin: StoragePlugin, text: str | None) -> None:
    run = written(tmp_path / "run", plugin)
    (run / "metadata.yaml").unlink()
    if text is not None:
        (run / "metadata.yaml").write_text(text)
    assert all_there(run) and all_there(data_of(run))


SERVICE = "example_interfaces/srv/AddTwoInts_Event"
SERVICE_TEXT = "=" * 80 + "\nSRV: example_interfaces/srv/AddTwoInts\nint64 a\nint64 b\n---\nint64 sum\n"
STRANGE = [(SERVICE, "ros2msg", SERVICE_TEXT), ("my_msgs/msg/Own", "ros2msg", "%")]
"""Type, encoding and text of a definition, as ROS 2 Jazzy writes them of services and of packages it does not know."""


def mcap(
    path: Path, others: list[tuple[str, str, str]] = (), profile: str = "ros2", which: range = range(COUNT), **how: Any
) -> Path:  # type: ignore[assignment]
    """Write the ten images, and a message of each of the others, as an MCAP file alone."""
    how = {"compression": CompressionType.NONE, "chunk_size": 500, **how}
    with path.open("wb") as file:
        writer = McapWriter(file, **how)
        writer.start(profile=profile, library="test")
        definition = STORE.generate_msgdef(IMAGE, ros_version=2)[0].encode()
        schema = writer.register_schema(IMAGE, "ros2msg", definition)
        camera = writer.register_channel("/camera", "cdr", schema, {"offered_qos_profiles": yaml.safe_dump([PROFILE])})
        for name, encoding, text in others:
            number = writer.register_schema(name, encoding, text.encode())
            channel = writer.register_channel(f"/other/{number}/_service_event", "cdr", number)
            writer.add_message(channel, BEGIN_NS, b"\0\1\0\0\7", BEGIN_NS)
        for i in which:
            writer.add_message(camera, BEGIN_NS + i * STEP_NS, cdr(i), BEGIN_NS + i * STEP_NS - 5_000_000, i)
        writer.finish()
    return path


@pytest.mark.parametrize("strange", STRANGE)
def test_topics_that_nobody_asks_for_hinder_nothing(tmp_path: Path, strange: tuple[str, str, str]) -> None:
    assert all_there(mcap(tmp_path / "run.mcap", [strange]))
    run = written(tmp_path / "run", StoragePlugin.SQLITE3)
    name, encoding, text = strange
    with sqlite3.connect(data_of(run)) as base:
        base.execute("INSERT INTO topics VALUES (9, '/a/_service_event', ?, 'cdr', 'no yaml: [', 'RIHS01_0')", (name,))
        base.execute("INSERT INTO message_definitions VALUES (9, ?, ?, ?, '')", (name, encoding, text))
        base.execute("INSERT INTO messages VALUES (99, 9, ?, x'0001000007')", (BEGIN_NS + 5,))
    base.close()
    assert all_there(run)


@pytest.mark.parametrize(
    "how",
    [
        {"use_chunking": False},
        {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
        {"compression": CompressionType.ZSTD},
        {"profile": ""},
    ],
    ids=str,
)
def test_an_mcap_file_alone(tmp_path: Path, how: dict[str, Any]) -> None:
    assert all_there(mcap(tmp_path / "run.mcap", **how))


@pytest.mark.parametrize("how", ["message", "file"])
def test_compressed_by_message_or_by_file(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = written(tmp_path / "run", StoragePlugin.SQLITE3)
    path = data_of(run)
    pack = zstandard.ZstdCompressor().compress
    if how == "message":
        with sqlite3.connect(path) as base:
            for number, data in base.execute("SELECT id, data FROM messages").fetchall():
                base.execute("UPDATE messages SET data = ? WHERE id = ?", (pack(data), number))
        base.close()
    else:
        path.with_name(f"{path.name}.zstd").write_bytes(pack(path.read_bytes()))
        path.unlink()
    names = [one.name for one in run.iterdir() if one.suffix != ".yaml"]
    edited(
        run, lambda it: it.update(compression_format="zstd", compression_mode=how.upper(), relative_file_paths=names)
    )
    before = untouched(run)
    assert all_there(run)
    assert untouched(run) == before
    monkeypatch.setattr("armsight.store.recording.record_reader.MAX_CHUNK", 10)
    monkeypatch.setattr(bags, "ROOM_LEFT", 1 << 62)
    with refuses(BadFile, "unpacks"):
        all_there(run)


def killed(folder: Path) -> Path:
    """Return a bag of which the last five messages stand in the log beside it, and no metadata."""
    run = written(folder / "recorded", StoragePlugin.SQLITE3)
    (run / "metadata.yaml").unlink()
    with closing(sqlite3.connect(data_of(run), isolation_level=None)) as base:
        rows = base.execute("SELECT * FROM messages WHERE id > 5").fetchall()
        base.execute("DELETE FROM messages WHERE id > 5")
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("PRAGMA wal_autocheckpoint = 0")
        base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        shutil.copytree(run, folder / "run")
    return folder / "run"


def test_messages_in_the_log_beside_are_read(tmp_path: Path) -> None:
    run = killed(tmp_path)
    before = untouched(run)
    assert any(name.endswith("wal") for name in before)
    assert all_there(run) and all_there(data_of(run))
    assert untouched(run) == before


def cure_of(path: Path) -> str:
    with refuses(BadFile) as info:
        read(path)
    assert info.value.consequence
    return info.value.cure


def test_a_file_that_breaks_off_is_saved_as_its_cure_says(
    armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mcap(tmp_path / "run.mcap")
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.index(cdr(8)) + 40])
    command = re.findall("`(.*)`", cure_of(path))[0].split()
    assert command[:3] == ["armsight", "record", "--repair"] and command[4] == "-o"
    monkeypatch.chdir(tmp_path)
    assert armsight(*command[1:]).code == 0
    found = read(Path(command[5]))
    assert [one.t_s for one in found] == TIMES[: len(found)] and len(found) >= 6


@pytest.mark.skipif(not shutil.which("sqlite3"), reason="the program sqlite3 is not installed")
def test_a_damaged_database_is_saved_as_its_cure_says(tmp_path: Path) -> None:
    large = np.random.default_rng(1).integers(0, 255, (50, 60), dtype=np.uint8)
    path = tmp_path / "run.db3"
    shutil.move(data_of(written(tmp_path / "run", StoragePlugin.SQLITE3)), path)
    with sqlite3.connect(path) as base:
        for i in range(COUNT):
            message = bytes(STORE.serialize_cdr(image_of(i, large), IMAGE))
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (message, i + 1))
    base.close()
    content = bytearray(path.read_bytes())
    at = content.index(large.tobytes()[:500], len(content) // 2) // 4096 * 4096  # a page of a message behind the middle
    content[at : at + 8] = b"\x55" * 8
    path.write_bytes(content)
    program, file, words = shlex.split(re.findall("`(.*)`", cure_of(path))[0])
    assert file == "FILE"
    subprocess.run([program, path, words], cwd=tmp_path, check=True, timeout=60)
    saved = [one.t_s for one in read(tmp_path / "mended.db3")]
    assert 0 < len(saved) < COUNT and set(saved) < set(TIMES)


def test_what_metadata_say_beyond_what_is_there_is_told(tmp_path: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["topics_with_message_count"][0]["message_count"] += 3
        content["relative_file_paths"] += ["run_1.db3"]

    run = edited(written(tmp_path / "run", StoragePlugin.SQLITE3), change)
    with refuses(BadFile, "metadata.yaml", "13", "10", "/camera"):
        read(run)
    (run / "metadata.yaml").rename(tmp_path / "metadata.yaml")
    assert all_there(run)


def test_a_message_of_another_content_is_named(tmp_path: Path) -> None:
    run = written(tmp_path / "run", StoragePlugin.SQLITE3)
    with sqlite3.connect(data_of(run)) as base:
        base.execute("UPDATE messages SET data = substr(data, 1, 30) WHERE id = 4")
    base.close()
    with refuses(BadFile, "message 4"):
        read(run)


def test_while_a_database_that_kept_a_log_is_read_nothing_stands_beside_it(tmp_path: Path) -> None:
    run = written(tmp_path / "run", StoragePlugin.SQLITE3)  # as the recorder's preset for resilience leaves it
    with closing(sqlite3.connect(data_of(run))) as base:
        base.execute("PRAGMA journal_mode = WAL")
    before = untouched(run)
    with BagFrames(f"bag:{run}:/camera") as source, ThreadPoolExecutor() as other:
        frames = iter(source)
        assert [other.submit(next, frames).result().t_s for _ in TIMES] == TIMES
        assert untouched(run) == before


YUV = [("yuv422", "uyvy"), ("yuv422_yuy2", "yuyv")]


@pytest.mark.parametrize(("encoding", "order"), YUV)
def test_yuv_of_four_bytes_to_two_pixels(tmp_path: Path, encoding: str, order: str) -> None:
    bgr = np.array([40, 90, 200])
    y, u, v = np.array([[24.966, 128.553, 65.481], [112, -74.203, -37.797], [-18.214, -93.786, 112]]) / 255 @ bgr + (
        np.array([16, 128, 128])
    )  # ITU-R BT.601, 8 bits, from B G R
    parts = {"y": round(float(y)), "u": round(float(u)), "v": round(float(v))}
    light = np.arange(24).reshape(4, 6)
    rows = np.empty((4, 6, 2), np.uint8)
    for place, name in enumerate(order):
        rows[:, place // 2 :: 2, place % 2] = parts[name]
    shaded = rows.copy()
    shaded[..., order.index("y")] = light
    padded = np.pad(np.stack([rows, shaded]).reshape(2, 4, 12), ((0, 0), (0, 0), (0, 5)))
    with Writer(tmp_path / "run", version=9) as writer:
        topic = writer.add_connection("/camera", IMAGE, typestore=STORE)
        for i, data in enumerate(padded):
            message = image_of(i, np.empty((4, 6), np.uint8), encoding, step=17)
            message.data = data.ravel()
            writer.write(topic, BEGIN_NS + i, STORE.serialize_cdr(message, IMAGE))
    even, _ = read(tmp_path / "run", colour=True)
    assert np.abs(even.image.astype(int) - bgr).max() <= 2
    np.testing.assert_array_equal(read(tmp_path / "run")[1].image, light)
