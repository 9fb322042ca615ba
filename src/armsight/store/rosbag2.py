"""A recording written as a bag of ROS 2 (MCAP, CDR), which ros2 bag, rviz and `bag:FOLDER:/topic` read.

/CAMERA/image_raw (sensor_msgs/Image), /joint_states (sensor_msgs/JointState, joints q1 ...), /target/pose
(geometry_msgs/PoseStamped, whole poses only); /CAMERA/camera_info where the recording holds its rig of two pinholes.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from armsight.errors import NotEnoughData, UsageError
from armsight.file_names import RIG
from armsight.geometry import xyz_quat
from armsight.optics import SIDES, Camera, Rig
from armsight.records import Frame, PoseStatus
from armsight.store.atomic import disk_errors
from armsight.store.bags import require_rosbags
from armsight.store.foreign.numbers import rectification
from armsight.store.foreign.ros import ROS_MODEL
from armsight.store.recording.reader import Recording
from armsight.store.recording.schemas import NS
from armsight.store.rigs import rig_from_mapping
from armsight.store.yamls import parse_yaml

ENCODINGS = {2: "mono8", 3: "bgr8"}
"""By the number of an image's dimensions."""
VERSION: Literal[9] = 9
"""Of the bag's metadata: that of ROS 2 Iron and later."""


def write_rosbag2(
    recording: Recording, out: Path, *, on_written: Callable[[int], None] = lambda count: None
) -> dict[str, int]:
    """Write a recording as a bag in the folder out, which must not be there yet; return the messages by topic.

    told: called with the number of messages so far; what it raises ends the work. A work that ends early leaves
    nothing. Raises UsageError, DeviceNotFound without the package rosbags, NotEnoughData, BadFile, DeviceFailed.
    """
    if out.exists():
        raise UsageError(f"{out} is already there", consequence="Nothing is written", cure="Give another folder")
    with disk_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        with disk_errors(out):
            with _Bag(scratch / out.name, recording.origin_ns, on_written) as bag:
                _fill(bag, recording)
            if not bag.counts:
                raise NotEnoughData(f"{recording.path} holds no frames, joints or poses", cure="Check the file")
            (scratch / out.name).rename(out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return bag.counts


class _Bag:
    """A bag being written; a topic begins with its first message."""

    def __init__(self, path: Path, origin_ns: int, on_written: Callable[[int], None]) -> None:
        require_rosbags("No bag is written")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._writer = Writer(path, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}
        self._origin_ns, self._on_written = origin_ns, on_written
        self.counts: dict[str, int] = {}

    def __enter__(self) -> _Bag:
        self._writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def header(self, t_s: float, frame: str) -> Any:
        """Return a header with a time of the recording's clock."""
        seconds, parts = divmod(self._ns(t_s), NS)
        return self.make("std_msgs/msg/Header", self.make("builtin_interfaces/msg/Time", seconds, parts), frame)

    def make(self, kind: str, *fields: Any) -> Any:
        """Return a message of its fields in their order."""
        return self._store.types[kind](*fields)

    def add(self, topic: str, t_s: float, kind: str, *fields: Any) -> None:
        """Write one message."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self.make(kind, *fields), kind)
        self._writer.write(self._connections[topic], self._ns(t_s), data)
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self._on_written(sum(self.counts.values()))

    def _ns(self, t_s: float) -> int:
        return self._origin_ns + round(t_s * NS)


def _fill(bag: _Bag, recording: Recording) -> None:
    """Write what the recording holds."""
    infos = _camera_infos(recording)
    for side in recording.cameras:
        for frame in recording.frames(side):
            _add_frame(bag, side, frame)
            if side in infos:
                bag.add(f"/{side}/camera_info", frame.t_s, *_camera_info(bag, side, frame.t_s, *infos[side]))
    if recording.topics.get("/robot/joints"):
        for reading in recording.joints():
            names = [f"q{i + 1}" for i in range(len(reading.q))]
            none = np.zeros(0)
            header = bag.header(reading.t_s, "")
            kind = "sensor_msgs/msg/JointState"
            bag.add("/joint_states", reading.t_s, kind, header, names, np.array(reading.q), none, none)
    if recording.topics.get("/target/measured"):
        for pose in recording.poses():
            if pose.status is PoseStatus.OK and pose.pose is not None:
                xyz, quat = xyz_quat(pose.pose)
                point = bag.make("geometry_msgs/msg/Point", *xyz.tolist())
                turn = bag.make("geometry_msgs/msg/Quaternion", *quat.tolist())
                placed = bag.make("geometry_msgs/msg/Pose", point, turn)
                kind = "geometry_msgs/msg/PoseStamped"
                bag.add("/target/pose", pose.t_s, kind, bag.header(pose.t_s, pose.parent), placed)


def _add_frame(bag: _Bag, side: str, frame: Frame) -> None:
    image = np.ascontiguousarray(frame.image)
    height, width = image.shape[:2]
    step = width * (1 if image.ndim == 2 else image.shape[2])
    bag.add(
        f"/{side}/image_raw",
        frame.t_s,
        "sensor_msgs/msg/Image",
        bag.header(frame.t_s, side),
        height,
        width,
        ENCODINGS[image.ndim],
        0,
        step,
        image.reshape(-1),
    )


def _camera_infos(recording: Recording) -> dict[str, tuple[Camera, np.ndarray, np.ndarray]]:
    """Return each camera with its rectifying rotation (3, 3) and projection (3, 4); none without a rig of pinholes.

    Of other rigs than pairs nothing is rectified: their cameras look where they look.
    """
    if RIG not in recording.attachments:
        return {}
    where = f"{recording.path}, {RIG}"
    rig: Rig = rig_from_mapping(parse_yaml(recording.attachment(RIG), where), where)
    if rig.names != SIDES:
        each = {name: rig.camera(name) for name in rig.names}
        return {name: (one, np.eye(3), np.column_stack([one.matrix, np.zeros(3)])) for name, one in each.items()}
    sizes = {(camera.width, camera.height) for camera in (rig.left, rig.right)}
    if rig.left.plate is not None or len(sizes) > 1:
        return {}
    found = rectification(rig)
    return {"left": (rig.left, found.R1, found.P1), "right": (rig.right, found.R2, found.P2)}


def _camera_info(bag: _Bag, side: str, t_s: float, camera: Camera, R: np.ndarray, P: np.ndarray) -> tuple[Any, ...]:
    """Return the kind and the fields of a camera's message."""
    roi = bag.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    size = (camera.height, camera.width)
    matrices = (np.array(camera.distortion), camera.matrix.ravel(), R.ravel(), P.ravel())
    return ("sensor_msgs/msg/CameraInfo", bag.header(t_s, side), *size, ROS_MODEL[camera.lens], *matrices, 0, 0, roi)
