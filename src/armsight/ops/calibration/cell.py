"""One recording of a moving arm, and what earlier calibrations say of its cell, as the calibration takes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cell import CellPriors, CellResult
from armsight.calibrate.handeye import Setup
from armsight.drivers import is_live
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.ops.action import Given
from armsight.ops.calibration.spots_of_frames import SpotSearch, spots_of_frames
from armsight.ops.flags import point_of
from armsight.ops.given import as_arm
from armsight.ops.sources.frames import is_recording, recording_path
from armsight.optics import RIGHT_POSE, SIDES
from armsight.records import Frame, Motion, NamedCovariance, Progress, SpotTrack, checked_array, require_count
from armsight.store import read_rig, read_spot_track, read_world
from armsight.store.foreign.storage import kind_of
from armsight.store.handeye_file import read_handeye, read_tip
from armsight.store.interpret import TableFormat
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints

Size = tuple[int, int]

OFF_CENTRE = 0.1
"""Of the image's size: webcams' lenses are within 0.05 of its middle; 1280x720 taken for 1920x1080 is 0.16 off."""
READ = "armsight/rig, armsight/world, armsight/handeye"


def given_arm(name: str, value: Any, given: Given, undo: ExitStack) -> Arm:
    """Return an arm, that of a file, or the one known by that name. Raises UsageError, BadFile."""
    return as_arm(name, value)


def given_tip(name: str, value: Any, given: Given, undo: ExitStack) -> Array | None:
    """Return the tip (3,) in target axes, m, of X,Y,Z, a tip.yaml or numbers; None of an empty text.

    Raises UsageError, BadFile, Inconsistent.
    """
    if not isinstance(value, str | PathLike):
        return checked_array(name, value, (3,))
    text = fspath(value)
    if not text:
        return None
    return read_tip(Path(text)).tip_m if text.lower().endswith((".yaml", ".yml")) else np.array(point_of(text))


def given_files(name: str, value: Any, given: Given, undo: ExitStack) -> list[Path]:
    """Return paths."""
    return [Path(fspath(one)) for one in value]


def require_centred(done: CellResult) -> None:
    """Raise Inconsistent where a lens's middle is far from that of the images whose size was typed."""
    for side in SIDES:
        camera = done.rig.camera(side)
        size = np.array([camera.width, camera.height])
        off = camera.intrinsics[2:4] - (size - 1.0) / 2.0
        if (np.abs(off) > OFF_CENTRE * size).any():
            raise Inconsistent(
                f"the {side} lens's middle is ({off[0]:.0f}, {off[1]:.0f}) px from that of images of "
                f"{size[0]}x{size[1]} px",
                consequence="The size is hardly that of the images, and no cell is calibrated",
                cure="Give the size of the images in which the spots were found: --size, or --right-size of the right "
                "one; give frames where images are cut out of larger ones",
            )


def require_size(name: str, value: Any) -> None:
    """Raise UsageError, Inconsistent for what is no size of images (w, h) px, nor None."""
    for pixels in [] if value is None else checked_array(name, value, (2,)).tolist():
        require_count(name, int(pixels) if pixels == int(pixels) else pixels, least=1)


def require_sources(frames: Sequence[Any], tables: Sequence[Any], size: Size | None) -> None:
    """Raise UsageError for frames that are none, or live ones."""
    if not (all(frames) and not any(tables)) and not (all(tables) and not any(frames)):
        raise UsageError(
            "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
        )
    if any(is_live(text or "") for text in frames):
        raise UsageError(
            "a cell is not calibrated from live cameras: they and the robot's log are of one motion",
            consequence="Nothing is calibrated",
            cure="Record first, while the robot moves and logs its joints: armsight record --left ... --right ... "
            "-o cell.mcap; then give --left cell.mcap --right cell.mcap",
        )
    if all(tables) and size is None:
        raise UsageError(
            "tables of spots do not tell how large the images are",
            consequence="Nothing is calibrated",
            cure="Add --size 1280x720, and --right-size where the right camera's is another",
        )


def joints_of(log: Path, arm: Arm, format_: TableFormat) -> Motion:
    """Return the log; of a recording the readings of its robot."""
    if not is_recording(str(log)):
        return read_joints(log, format_.of_arm(arm), measured=True)
    with Recording(recording_path(str(log))) as recording:
        readings = list(recording.joints())
    return Motion(t_s=np.array([one.t_s for one in readings]), q=np.array([one.q for one in readings]))


def spots_of_tables(paths: tuple[Path, Path], sizes: tuple[Size, Size]) -> tuple[SpotTrack, SpotTrack]:
    """Return the spots of both cameras, whose images are of these sizes (w, h) px. Raises Inconsistent, BadFile."""
    left, right = read_spot_track(paths[0]), read_spot_track(paths[1])
    for track, path, size in ((left, paths[0], sizes[0]), (right, paths[1], sizes[1])):
        _require_inside(track, path, size)
    return left, right


def spots_and_sizes(
    search: SpotSearch, sources: tuple[str, str], progress: Progress
) -> tuple[tuple[SpotTrack, SpotTrack], tuple[Size, Size]]:
    """Return the spots in frames of both cameras, and the sizes of their images. Raises UsageError, Inconsistent."""
    tracks, found = [], []
    for side, text in zip(SIDES, sources, strict=True):
        seen: list[Size] = []
        tracks.append(spots_of_frames(search, side, text, progress, _one_size(seen)))
        if not seen:
            raise UsageError(f"{text} holds no frames", cure="Give the frames of the recording")
        found.append(seen[0])
    return (tracks[0], tracks[1]), (found[0], found[1])


def _one_size(seen: list[Size]) -> Callable[[Frame], None]:
    """Return what keeps the size of the first frame, and refuses one of another."""

    def check(frame: Frame) -> None:
        size = (frame.width, frame.height)
        if not seen:
            seen.append(size)
        if size != seen[0]:
            raise Inconsistent(
                f"{frame.source} is {size[0]}x{size[1]} px, the frames before are {seen[0][0]}x{seen[0][1]} px",
                consequence="No cell is calibrated",
                cure="Record at one resolution",
            )

    return check


def require_two(tracks: tuple[SpotTrack, SpotTrack]) -> None:
    """Raise Inconsistent where both cameras are one."""
    left, right = tracks
    if left.uv_px.shape == right.uv_px.shape and len(left.uv_px) and (left.uv_px == right.uv_px).all():
        raise Inconsistent(
            "left and right hold the same spots: they are one camera",
            consequence="Nothing is known of a second one, and no cell is calibrated",
            cure="Give each side the frames or spots of its own camera",
        )


def _require_inside(track: SpotTrack, path: Path, size: Size) -> None:
    """Raise Inconsistent where spots are outside of images of a size."""
    most = track.uv_px.max(axis=0)
    if (most > np.array(size) - 0.5).any() or track.uv_px.min() < -0.5:
        raise Inconsistent(
            f"{path} has spots up to ({most[0]:.0f}, {most[1]:.0f}) px, outside of images of {size[0]}x{size[1]} px",
            consequence="No cell is calibrated",
            cure="Give the size of the images in which the spots were found: --size, or --right-size of the right one",
        )


def read_priors(paths: Sequence[Path], sizes: Sequence[tuple[int, int]]) -> CellPriors | None:
    """Return what files say of a cell whose images are of these sizes (w, h) px; None for no file.

    Raises UsageError for another kind of file, NotEnoughData for one without a covariance, Inconsistent for cameras of
    another size.
    """
    known = CellPriors()
    for path in paths:
        kind = kind_of(path)
        if kind == "armsight/rig":
            known = _of_rig(known, path, sizes)
        elif kind == "armsight/world":
            world = read_world(path)
            if world.parent != "base":
                raise Inconsistent(
                    f"{path}: says where the rig stands in the world, not to the base",
                    cure="Give the world.yaml that `armsight calibrate robot-world` or `calibrate cell` wrote",
                )
            known = replace(known, base_pose=(world.T_parent_rig, _told(world.covariance, path)))
        elif kind == "armsight/handeye":
            hand = read_handeye(path)
            if hand.setup is not Setup.EYE_TO_HAND:
                raise Inconsistent(
                    f"{path}: the camera is on the hand there, and here it stands",
                    cure="Leave it out, or give an eye-to-hand calibration of the left camera",
                )
            covariance = _told(hand.covariance, path)
            names = covariance.names[:6]
            pose = NamedCovariance(names=names, matrix=covariance.block(names))
            known = replace(known, base_pose=(hand.T_parent_camera, pose))
        else:
            raise UsageError(
                f"{path}: a {kind or 'file of no known kind'} tells nothing here",
                cure=f"Give {READ}; a calibrated arm as --model, a measured target as --target",
            )
    return known if paths else None


def _of_rig(known: CellPriors, path: Path, sizes: Sequence[tuple[int, int]]) -> CellPriors:
    rig = read_rig(path)
    covariance = _told(rig.covariance, path)
    lenses = []
    for side, size in zip(SIDES, sizes, strict=True):
        camera = rig.camera(side)
        if (camera.width, camera.height) != tuple(size):
            raise Inconsistent(
                f"{path}: the {side} camera has {camera.width}x{camera.height} px, the recording {size[0]}x{size[1]}",
                consequence="Its lens is not that of these images",
                cure="Give the rig.yaml of these cameras in this mode",
            )
        names = tuple(name for name in covariance.names if name.startswith(f"{side}.") and name not in RIGHT_POSE)
        short = tuple(name.partition(".")[2] for name in names)
        lenses.append((camera, NamedCovariance(names=short, matrix=covariance.block(names))) if names else None)
    pose = (
        (rig.T_rig_left.inv() * rig.T_rig_right, NamedCovariance(names=RIGHT_POSE, matrix=covariance.block(RIGHT_POSE)))
        if set(RIGHT_POSE) <= set(covariance.names)
        else None
    )
    return replace(known, lenses=(lenses[0], lenses[1]), right_pose=pose)


def _told(covariance: NamedCovariance | None, path: Path) -> NamedCovariance:
    if covariance is None:
        raise NotEnoughData(
            f"{path} brings no covariance",
            consequence="How much it is to count beside the recording is not known",
            cure="Calibrate with a current version, or leave it out",
        )
    return covariance
