"""Files, written so that a crash cannot eat them.

What is here is loaded when it is first used: a command that reads one small file need not load cameras and tables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from armsight.fields import loaded_names

if TYPE_CHECKING:
    from armsight.store.atomic import json_text as json_text
    from armsight.store.atomic import sha256 as sha256
    from armsight.store.atomic import write_bytes as write_bytes
    from armsight.store.atomic import write_json as write_json
    from armsight.store.atomic import write_text as write_text
    from armsight.store.rigs import CameraFile as CameraFile
    from armsight.store.rigs import World as World
    from armsight.store.rigs import add_noise as add_noise
    from armsight.store.rigs import read_camera as read_camera
    from armsight.store.rigs import read_camera_file as read_camera_file
    from armsight.store.rigs import read_rig as read_rig
    from armsight.store.rigs import read_world as read_world
    from armsight.store.rigs import read_zoom_rig as read_zoom_rig
    from armsight.store.rigs import rig_from_mapping as rig_from_mapping
    from armsight.store.rigs import rig_mapping as rig_mapping
    from armsight.store.rigs import write_camera as write_camera
    from armsight.store.rigs import write_rig as write_rig
    from armsight.store.rigs import write_world as write_world
    from armsight.store.spots_csv import read_spot_track as read_spot_track
    from armsight.store.tables import Table as Table
    from armsight.store.tables import read_table as read_table
    from armsight.store.targets import BOARD_FORMS as BOARD_FORMS
    from armsight.store.targets import board_text as board_text
    from armsight.store.targets import parse_board as parse_board
    from armsight.store.targets import read_target as read_target
    from armsight.store.targets import target_from_mapping as target_from_mapping
    from armsight.store.targets import target_mapping as target_mapping
    from armsight.store.targets import write_target as write_target
    from armsight.store.tracks import MovingPosesWriter as MovingPosesWriter
    from armsight.store.tracks import PointsWriter as PointsWriter
    from armsight.store.tracks import PosesWriter as PosesWriter
    from armsight.store.tracks import SpotsWriter as SpotsWriter
    from armsight.store.tracks import read_joints as read_joints
    from armsight.store.tracks import read_poses as read_poses
    from armsight.store.tracks import read_times as read_times
    from armsight.store.tracks import read_tum as read_tum
    from armsight.store.tracks import restate_points as restate_points
    from armsight.store.tracks import write_joints as write_joints
    from armsight.store.tracks import write_poses as write_poses
    from armsight.store.tracks import write_tum as write_tum
    from armsight.store.zoom import ZoomCameraFile as ZoomCameraFile
    from armsight.store.zoom import is_zoom_camera as is_zoom_camera
    from armsight.store.zoom import read_zoom_camera as read_zoom_camera
    from armsight.store.zoom import write_zoom_camera as write_zoom_camera

_NAMES = {
    "atomic": "json_text sha256 write_bytes write_json write_text",
    "rigs": "CameraFile World add_noise read_camera read_camera_file read_rig read_world read_zoom_rig "
    "rig_from_mapping rig_mapping write_camera write_rig write_world",
    "spots_csv": "read_spot_track",
    "tables": "Table read_table",
    "targets": "BOARD_FORMS board_text parse_board read_target target_from_mapping target_mapping write_target",
    "tracks": "MovingPosesWriter PointsWriter PosesWriter SpotsWriter read_joints read_poses read_times read_tum "
    "restate_points write_joints write_poses write_tum",
    "zoom": "ZoomCameraFile is_zoom_camera read_zoom_camera write_zoom_camera",
}
_PLACES = {name: module for module, names in _NAMES.items() for name in names.split()}

if not TYPE_CHECKING:  # type checkers know the names above, and refuse all others
    __all__ = sorted(_PLACES)
    __getattr__ = loaded_names(__name__, _PLACES)
