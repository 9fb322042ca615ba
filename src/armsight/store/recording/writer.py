"""The records of armsight into an MCAP file, on one clock."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from armsight._version import __version__
from armsight.clock import Clock
from armsight.geometry import xyz_quat
from armsight.optics import LensKind, Rig
from armsight.records import Frame, JointReading, Points, Spots, TargetPose
from armsight.store.atomic import Closing, json_text
from armsight.store.recording import schemas
from armsight.store.recording.images import Encoded, image_message
from armsight.store.recording.mcapfile import CHUNK_BYTES, CHUNK_S, McapFile

FORMAT = "armsight/recording"
VERSION = "1"
METADATA = "armsight"
FOXGLOVE_MODEL = {
    LensKind.PINHOLE: "plumb_bob",
    LensKind.FISHEYE: "kannala_brandt",
    LensKind.RATIONAL: "rational_polynomial",
}

POINTS_MARK = 1
"""foxglove.ImageAnnotations: a set of points."""

MARK_COLOUR = {"r": 1.0, "g": 0.2, "b": 0.2, "a": 1.0}


class RecordingWriter(Closing):
    """A recording being written. t_s of all records is on one clock, whose zero is origin_ns of Unix time.

    Every method adds one record and writes what is due; call tick() in between where records may stay away. Raises
    UsageError, DeviceFailed and Inconsistent as McapFile does. Not for several threads at once, but for sync().
    """

    def __init__(
        self,
        path: Path,
        *,
        origin_ns: int | None = None,
        overwrite: bool = False,
        clock: Clock | None = None,
        chunk_s: float = CHUNK_S,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self._origin_ns = time.time_ns() if origin_ns is None else origin_ns
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._exposures: dict[str, float] = {}
        self._file = McapFile(path, overwrite=overwrite, clock=clock, chunk_s=chunk_s, chunk_bytes=chunk_bytes)
        self._file.add_metadata(
            METADATA,
            {
                "format": FORMAT,
                "version": VERSION,
                "origin_ns": str(self._origin_ns),
                "software": f"armsight {__version__}",
            },
        )

    @property
    def path(self) -> Path:
        """The file."""
        return self._file.path

    @property
    def size(self) -> int:
        """Bytes given to the system."""
        return self._file.size

    def moment(self, frames: Mapping[str, Frame], encoded: Mapping[str, Encoded | None] = MappingProxyType({})) -> None:
        """Add a moment's views by camera, all in one chunk; encoded: the same images compressed, else they are raw."""
        for camera, frame in frames.items():
            self._frame(camera, frame, encoded.get(camera))
        self.tick()

    def frame(self, camera: str, frame: Frame, encoded: Encoded | None = None) -> None:
        """Add a frame of one camera by itself."""
        self.moment({camera: frame}, {camera: encoded})

    def _frame(self, camera: str, frame: Frame, encoded: Encoded | None) -> None:
        t_ns = self._ns(frame.t_s)
        schema, head, data = image_message(t_ns, camera, frame.image, encoded)
        self._file.add_message(self._channel(f"/{camera}/image", schema), t_ns, frame.sequence, head, data)
        if frame.exposure_s and frame.exposure_s != self._exposures.get(camera):
            self._exposures[camera] = frame.exposure_s
            content = {"t_s": frame.t_s, "exposure_s": frame.exposure_s}
            self._json(f"/{camera}/exposure", schemas.EXPOSURE, frame.t_s, content)

    def spots(self, camera: str, t_s: float, names: Sequence[str], spots: Spots) -> None:
        """Add the spots of one image, named in their order (no names: not matched)."""
        content = {
            "t_s": t_s,
            "camera": camera,
            "names": list(names),
            "uv_px": spots.uv_px,
            "covariance_px2": spots.covariance_px2,
            "peak": spots.peak,
            "size_px": spots.size_px,
            "model": list(spots.model),
            "rejected": spots.rejected,
        }
        self._json(f"/{camera}/spots", schemas.SPOTS, t_s, content)
        marks = {
            "timestamp": schemas.time_json(self._ns(t_s)),
            "type": POINTS_MARK,
            "points": [{"x": u, "y": v} for u, v in spots.uv_px.tolist()],
            "outline_color": MARK_COLOUR,
            "outline_colors": [],
            "fill_color": MARK_COLOUR,
            "thickness": 4.0,
        }
        self._json(f"/{camera}/annotations", schemas.ANNOTATIONS, t_s, {"circles": [], "points": [marks], "texts": []})
        self.tick()

    def points(self, t_s: float, points: Points) -> None:
        """Add the points of one moment, in rig axes."""
        content = {
            "t_s": t_s,
            "names": list(points.names),
            "xyz_m": points.xyz_m,
            "covariance_m2": points.covariance_m2,
        }
        self._json("/target/points", schemas.POINTS, t_s, content)
        self.tick()

    def pose(self, pose: TargetPose) -> None:
        """Add the target's pose with all that is known of it; a whole one also in Foxglove's form."""
        for topic, content in schemas.pose_contents(pose, self._ns(pose.t_s)).items():
            self._json(topic, schemas.SCHEMA_OF[topic], pose.t_s, content)
        self.tick()

    def joints(self, reading: JointReading) -> None:
        """Add what the robot says its joints are."""
        self._json(
            schemas.JOINTS,
            schemas.SCHEMA_OF[schemas.JOINTS],
            reading.t_s,
            schemas.joints_content(reading),
            reading.sequence,
        )
        self.tick()

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Add what was sent to the robot: its kind and its values as JSON knows them."""
        self._json("/robot/command", schemas.COMMAND, t_s, {"t_s": t_s, "kind": kind, "values": dict(values)})
        self.tick()

    def event(self, t_s: float, message: str, level: str = "info", name: str = "armsight") -> None:
        """Add something that happened; level: one of LEVELS."""
        self._json(
            schemas.EVENTS,
            schemas.SCHEMA_OF[schemas.EVENTS],
            t_s,
            schemas.event_content(self._ns(t_s), message, level, name),
        )
        self.tick()

    def rig(self, t_s: float, rig: Rig) -> None:
        """Add the cameras' calibration and places in Foxglove's forms, for viewers; attach rig.yaml for ourselves."""
        for side in rig.names:
            camera = rig.camera(side)
            fx, fy, cx, cy, skew = camera.intrinsics[:5].tolist()
            k = [fx, skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
            calibration = {
                "timestamp": schemas.time_json(self._ns(t_s)),
                "frame_id": side,
                "width": camera.width,
                "height": camera.height,
                "distortion_model": FOXGLOVE_MODEL[camera.lens],
                "D": camera.distortion,
                "K": k,
                "R": np.eye(3).ravel(),
                "P": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
            }
            self._json(f"/{side}/calibration", schemas.CALIBRATION, t_s, calibration)
            xyz, quat = xyz_quat(rig.T_rig_camera(side))
            transform = {
                "timestamp": schemas.time_json(self._ns(t_s)),
                "parent_frame_id": "rig",
                "child_frame_id": side,
                "translation": schemas.vector_json(xyz.tolist()),
                "rotation": schemas.vector_json(quat.tolist()),
            }
            self._json("/tf", schemas.TRANSFORM, t_s, transform)
        self.tick()

    def attach(self, name: str, data: bytes, *, media_type: str = "application/yaml") -> None:
        """Put a file into the recording, such as rig.yaml and target.yaml."""
        self._file.add_attachment(name, media_type, data, self._origin_ns)

    def tick(self) -> None:
        """Write what is due."""
        self._file.flush_due()

    def flush(self) -> None:
        """Write all that waits."""
        self._file.flush()

    def sync(self) -> None:
        """Wait for the disk; may be called from another thread."""
        self._file.sync()

    def close(self) -> None:
        """Write what waits and the index; a second call does nothing."""
        self._file.close()

    def _ns(self, t_s: float) -> int:
        return self._origin_ns + round(t_s * schemas.NS)

    def _json(self, topic: str, schema: str, t_s: float, content: Any, sequence: int | None = None) -> None:
        channel = self._channel(topic, schema)
        number = self._counts.get(channel, 0) if sequence is None else sequence
        self._counts[channel] = number + 1
        data = json_text(content, indent=None).encode("utf-8")
        self._file.add_message(channel, self._ns(t_s), number, data)

    def _channel(self, topic: str, schema: str) -> int:
        key = (topic, schema)
        if key not in self._channels:
            message_encoding, encoding, data = schemas.schema_of(schema)
            if schema not in self._schemas:
                self._schemas[schema] = self._file.add_schema(schema, encoding, data)
            self._channels[key] = self._file.add_channel(topic, message_encoding, self._schemas[schema])
        return self._channels[key]
