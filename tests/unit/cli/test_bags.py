"""ROS 1 and ROS 2 bags, written by the stock writer, as sources of frames and of joint values."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from armsight.ops.sources.cameras import open_rig
from armsight.optics import SIDES

pytest.importorskip("rosbags", reason="the extra armsight[bags] is not installed")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from armsight.errors import ArmsightError, BadFile, BadImage, Inconsistent, UsageError
from armsight.kinematics.presets import preset
from armsight.ops.kinematics_results import read_values
from armsight.ops.sources.bags import BagFrames, joint_states
from armsight.store.bags import bag_topic
from refusals import refuses

COUNT = 12
BEGIN_NS = 1_700_000_000_123_456_789
STEP_NS = 33_333_333
Message = tuple[str, str, int, Any]
"""Topic, type, time written in ns, message."""


class Ros:
    """Messages of one ROS, and how a bag of it is written."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.types = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)

    def header(self, stamp_ns: int) -> Any:
        make = self.types.types
        extra = {"seq": 0} if self.kind == "ros1" else {}
        time = make["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return make["std_msgs/msg/Header"](stamp=time, frame_id="camera", **extra)

    def image(self, image: np.ndarray, stamp_ns: int, encoding: str = "mono8", pad: int = 0, cut: int = 0) -> Any:
        rows = image.reshape(len(image), -1)
        data = np.pad(rows, ((0, 0), (0, pad))).ravel()
        return self.types.types["sensor_msgs/msg/Image"](
            header=self.header(stamp_ns),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1] + pad,
            data=data[: len(data) - cut],
        )

    def compressed(self, data: bytes, stamp_ns: int, kind: str = "png") -> Any:
        make = self.types.types["sensor_msgs/msg/CompressedImage"]
        return make(header=self.header(stamp_ns), format=kind, data=np.frombuffer(data, np.uint8))

    def joints(self, names: list[str], q: Iterable[float], stamp_ns: int) -> Any:
        none, position = np.empty(0), np.array(list(q), dtype=np.float64)
        make = self.types.types["sensor_msgs/msg/JointState"]
        return make(header=self.header(stamp_ns), name=names, position=position, velocity=none, effort=none)

    def write(self, folder: Path, messages: Iterable[Message]) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / ("run.bag" if self.kind == "ros1" else "run")
        plugin = StoragePlugin.MCAP if self.kind == "ros2-mcap" else StoragePlugin.SQLITE3
        writer: Any = Writer1(path) if self.kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
        pack: Callable[[Any, str], Any] = self.types.serialize_ros1 if self.kind == "ros1" else self.types.serialize_cdr
        with writer:
            topics: dict[str, Any] = {}
            for topic, kind, written_ns, message in messages:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=self.types)
                writer.write(topics[topic], written_ns, pack(message, kind))
        return path


@pytest.fixture(params=["ros1", "ros2", "ros2-mcap"])
def ros(request: pytest.FixtureRequest) -> Ros:
    return Ros(request.param)


IMAGE, COMPRESSED, JOINTS = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState"


def stamp(i: int) -> int:
    return BEGIN_NS + i * STEP_NS


def images_of(ros: Ros, scene: Any, compressed: bool = False) -> list[Message]:
    out: list[Message] = []
    for i in range(COUNT):
        for side in ("left", "right"):
            path = scene.folder / side / f"frame{i}.png"
            if compressed:
                out.append(
                    (f"/{side}/image/compressed", COMPRESSED, stamp(i), ros.compressed(path.read_bytes(), stamp(i)))
                )
            else:
                out.append((f"/{side}/image", IMAGE, stamp(i), ros.image(cv2.imread(str(path), 0), stamp(i), pad=3)))
    return out


def one_topic(ros: Ros, folder: Path, *messages: Any, kind: str = IMAGE, late_ns: int = 0) -> str:
    path = ros.write(folder, [("/camera", kind, stamp(i) + late_ns, message) for i, message in enumerate(messages)])
    return f"bag:{path}:/camera"


def frames(text: str, colour: bool = False) -> list[Any]:
    with BagFrames(text, colour=colour) as source:
        return list(source)


def test_a_bag_gives_the_same_poses_as_the_same_frames_as_png(
    armsight: Any, scene: Any, tmp_path: Path, ros: Ros
) -> None:
    compressed = ros.kind == "ros2"
    path = ros.write(tmp_path, images_of(ros, scene, compressed))
    end = "/image/compressed" if compressed else "/image"
    (tmp_path / "times.csv").write_text("t_s\n" + "".join(f"{i * STEP_NS / 1e9!r}\n" for i in range(COUNT)))
    words = ["--times", tmp_path / "times.csv", "-o", tmp_path / "png"]
    assert armsight("measure", *scene.inputs, *scene.sources(), *words).code == 0
    sides = ["--left", f"bag:{path}:/left{end}", "--right", f"bag:{path}:/right{end}"]
    done = armsight("measure", *scene.inputs, *sides, "-o", tmp_path / "bag")
    assert done.code == 0, done.text
    assert done.json["n_ok"] == COUNT
    for name in ("poses.csv", "points.csv", "spots.csv", "poses.tum"):
        assert (tmp_path / "bag" / name).read_bytes() == (tmp_path / "png" / name).read_bytes(), name
    assert "1700000000.123457" in (tmp_path / "bag" / "report.html").read_text()


def test_two_bags_share_the_left_one_s_origin(scene: Any, tmp_path: Path) -> None:
    ros = Ros("ros1")
    messages = images_of(ros, scene)
    left = ros.write(tmp_path / "one", [one for one in messages if one[0] == "/left/image"])
    right = ros.write(tmp_path / "two", [one for one in messages if one[0] == "/right/image"][4:])
    with open_rig(SIDES, f"bag:{left}:/left/image", f"bag:{right}:/right/image") as pairs:
        got = [(one.t_s, other.t_s) for one, other in pairs]
    assert got == [(i * STEP_NS / 1e9, i * STEP_NS / 1e9) for i in range(4, COUNT)]


def test_encodings_give_the_same_grey_picture_and_colours_in_the_right_places(tmp_path: Path) -> None:
    ros, bgr = Ros("ros2"), np.random.default_rng(5).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    grey, whole = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA)
    layouts = {"mono8": grey, "bgr8": bgr, "rgb8": bgr[..., ::-1], "bgra8": whole, "rgba8": whole[..., [2, 1, 0, 3]]}
    for encoding, layout in layouts.items():
        image = ros.image(np.ascontiguousarray(layout), stamp(0), encoding)
        text = one_topic(ros, tmp_path / encoding, image)
        np.testing.assert_array_equal(frames(text)[0].image, grey)
        if encoding != "mono8":
            np.testing.assert_array_equal(frames(text, colour=True)[0].image, bgr)
    one = np.array([30, 90, 220], dtype=np.uint8)  # one colour all over
    for colours in ("rggb", "bggr", "gbrg", "grbg"):
        mosaic = np.empty((16, 20), np.uint8)
        for place, name in enumerate(colours):
            mosaic[place // 2 :: 2, place % 2 :: 2] = one["bgr".index(name)]
        text = one_topic(ros, tmp_path / colours, ros.image(mosaic, stamp(0), f"bayer_{colours}8"))
        assert (frames(text, colour=True)[0].image[4:-4, 4:-4] == one).all(), colours


GREY = np.full((24, 32), 7, np.uint8)


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (lambda ros: [ros.image(GREY.repeat(2, 1), stamp(0), "mono16")], IMAGE, "mono16"),
        (lambda ros: [ros.image(GREY, stamp(0), cut=40)], IMAGE, "728 bytes"),
        (lambda ros: [ros.compressed(b"no picture", stamp(0))], COMPRESSED, "whole image"),
        (lambda ros: [ros.compressed(b"", stamp(0))], COMPRESSED, "empty"),
        (
            lambda ros: [ros.compressed(cv2.imencode(".jpg", GREY)[1].tobytes()[:-20], stamp(0))],
            COMPRESSED,
            "breaks off",
        ),
    ],
    ids=["16 bits", "cut", "garbage", "empty", "half a jpeg"],
)
def test_images_that_cannot_be_used_are_named(tmp_path: Path, make: Any, kind: str, words: str) -> None:
    ros = Ros("ros2")
    text = one_topic(ros, tmp_path, *make(ros), kind=kind)
    with refuses(BadImage, words) as info:
        frames(text)
    assert "message 1" in info.value.cause and info.value.consequence and info.value.cure


@pytest.mark.parametrize(("later", "words"), [(-1, "runs back behind"), (0, "repeats")])
def test_stamps_that_do_not_increase_are_refused_after_the_frames_before(
    tmp_path: Path, later: int, words: str
) -> None:
    ros = Ros("ros1")
    text = one_topic(ros, tmp_path, *(ros.image(GREY, stamp(0) + ns) for ns in (0, 5, 5 + later)))
    got = []
    with BagFrames(text) as source, refuses(Inconsistent, "message 3", "stamp", words):
        got.extend(frame.sequence for frame in source)
    assert got == [0, 1]


def test_stamps_of_a_simulation_count_from_its_zero(tmp_path: Path) -> None:
    ros = Ros("ros2")
    text = one_topic(ros, tmp_path, *(ros.image(GREY, 7_500_000_000 + i) for i in (0, 40_000_000)))
    assert [frame.t_s for frame in frames(text)] == [7.5, 7.54]


def test_a_topic_that_is_not_there_or_of_another_type_is_answered_with_those_that_are(
    scene: Any, tmp_path: Path
) -> None:
    ros = Ros("ros1")
    joints = ros.joints(["a"], [0.1], stamp(0))
    path = ros.write(tmp_path, [*images_of(ros, scene)[:2], ("/joint_states", JOINTS, stamp(0), joints)])
    for topic, cause in (
        (":/nosuch", "/nosuch"),
        (":/joint_states", ("/joint_states", "sensor_msgs/msg/JointState")),
        ("", "no topic"),
    ):
        with refuses(UsageError, cause) as info, BagFrames(f"bag:{path}{topic}"):
            pass
        assert f"/left/image ({IMAGE}); /right/image ({IMAGE})" in info.value.cure.replace(
            f"/joint_states ({JOINTS}); ", ""
        )
    with refuses(UsageError, "sensor_msgs/msg/Image"):
        joint_states(f"bag:{path}:/left/image")


def test_what_is_no_whole_bag_is_refused(tmp_path: Path, ros: Ros) -> None:
    text = one_topic(ros, tmp_path / "whole", *(ros.image(GREY, stamp(i)) for i in range(9)))
    path, topic = bag_topic(text)
    (tmp_path / "text.bag").write_text("not a bag")
    (tmp_path / "folder").mkdir()
    for name in ("nosuch.bag", "text.bag", "folder"):
        with refuses(BadFile, name) as info, BagFrames(f"bag:{tmp_path / name}:{topic}"):
            pass
        assert info.value.consequence and info.value.cure
    data = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".db3", ".mcap"))
    whole = data.read_bytes()
    for size in range(0, 11 * (len(whole) // 12), len(whole) // 12):
        data.write_bytes(whole[:size])
        with pytest.raises(ArmsightError):
            frames(text)


def test_joint_states_are_put_in_the_arm_s_order_by_name(tmp_path: Path, ros: Ros) -> None:
    arm = preset("ur10")
    names = [joint.name for joint in arm.joints]
    order = [2, 1, 0, 3, 4, 5]  # as the driver of these arms publishes them
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    rows = [ros.joints([names[k] for k in order], q[i, order], stamp(i)) for i in range(5)]
    text = one_topic(ros, tmp_path, *rows, kind=JOINTS)
    found = read_values(arm, Path(text))
    np.testing.assert_array_equal(found.q, arm.values(q))
    np.testing.assert_array_equal(found.t_s, np.arange(5) * STEP_NS / 1e9)
    strange = one_topic(ros, tmp_path / "b", ros.joints(["x", *names[1:]], q[0], stamp(0)), kind=JOINTS)
    with refuses(Inconsistent, "bag's x"):
        read_values(arm, Path(strange))


def test_joint_states_of_several_publishers_on_one_topic_are_refused(tmp_path: Path) -> None:
    ros = Ros("ros2")
    rows = [ros.joints(["a", "b"], [0.1, 0.2], stamp(0)), ros.joints(["gripper"], [0.0], stamp(1))]
    with refuses(Inconsistent, "message 2", "gripper"):
        joint_states(one_topic(ros, tmp_path, *rows, kind=JOINTS))
