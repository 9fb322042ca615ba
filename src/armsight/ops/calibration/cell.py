"""One recording of a moving arm, and what earlier calibrations say of its cell, as the calibration takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import combinations
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell import CellPriors, CellResult
from armsight.calibrate.handeye import Setup
from armsight.drivers import is_live
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.geometry.poses import skew
from armsight.kinematics import Arm
from armsight.ops.action import Given
from armsight.ops.calibration.spots_of_frames import SpotSearch, side_by_side, spots_of_frames
from armsight.ops.flags import point_of
from armsight.ops.given import as_arm
from armsight.ops.sources.cameras import named_cameras
from armsight.ops.sources.frames import is_recording, recording_path
from armsight.optics import SIDES, LensKind, Rig
from armsight.records import Frame, Motion, NamedCovariance, Progress, SpotTrack, checked_array, require_count
from armsight.store import read_rig, read_spot_track, read_world
from armsight.store.foreign.storage import kind_of
from armsight.store.handeye_file import read_handeye, read_tip
from armsight.store.interpret import TableFormat
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints

Size = tuple[int, int]
Source = TypeVar("Source")

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


def named_tables(text: str) -> Sequence[Path]:
    """Return the file of NAME=CSV, whose hash goes into the result."""
    return [Path(text.partition("=")[2])]


def require_centred(done: CellResult) -> None:
    """Raise Inconsistent where a lens's middle is far from that of the images whose size was typed."""
    for side in done.rig.names:
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
    given = [kind for kind in (frames, [one is not None for one in tables]) if any(kind)]
    if len(given) != 1 or not all(given[0]):
        raise UsageError(
            "which frames?",
            cure="Give --left and --right, or --left-spots and --right-spots, one of each camera; or --camera "
            "NAME=SRC, or --spots NAME=CSV, of each of one to eight cameras",
        )
    if any(is_live(text or "") for text in frames):
        raise UsageError(
            "a cell is not calibrated from live cameras: they and the robot's log are of one motion",
            consequence="Nothing is calibrated",
            cure="Record first, while the robot moves and logs its joints: armsight record --left ... --right ... "
            "-o cell.mcap; then give --left cell.mcap --right cell.mcap",
        )
    if tables and tables[0] is not None and size is None:
        raise UsageError(
            "tables of spots do not tell how large the images are",
            consequence="Nothing is calibrated",
            cure="Add --size 1280x720, and --right-size where the right camera's is another",
        )


def by_camera(
    left: Source | None, right: Source | None, named: Mapping[str, Source] | None
) -> dict[str, Source | None]:
    """Return what is given of each camera; left and right are short for cameras of these names.

    Raises UsageError for a camera that is given twice, one source of two and more than a rig has, Inconsistent for what
    is no name.
    """
    short = {} if left is None and right is None else {"left": left, "right": right}
    if not named:
        return short
    own = {name: one for name, one in short.items() if one is not None}
    if all(isinstance(one, str) for one in named.values()):
        texts = {name: str(one) for name, one in named.items()}
        named_cameras(texts, *(None if one is None else str(one) for one in (left, right)))
    else:
        # tables are no devices: they are told apart by the cameras' names alone
        if twice := sorted(set(own) & set(named)):
            raise UsageError(
                f"the table of {twice[0]} is given twice",
                consequence="It is open which are its spots",
                cure="Leave one of the two away",
            )
        named_cameras({name: name for name in (*own, *named)})
    given: dict[str, Source | None] = {**own, **named}
    return {side: given[side] for side in SIDES} if set(given) == set(SIDES) else given


def joints_of(log: Path, arm: Arm, format_: TableFormat) -> Motion:
    """Return the log; of a recording the readings of its robot."""
    if not is_recording(str(log)):
        return read_joints(log, format_.of_arm(arm), measured=True)
    with Recording(recording_path(str(log))) as recording:
        readings = list(recording.joints())
    return Motion(t_s=np.array([one.t_s for one in readings]), q=np.array([one.q for one in readings]))


def spots_of_tables(
    tables: Mapping[str, Path | SpotTrack], sizes: Sequence[Size]
) -> tuple[dict[str, SpotTrack], Sequence[Size]]:
    """Return the spots by camera, whose images are of these sizes (w, h) px. Raises Inconsistent, BadFile."""
    tracks = {}
    for (name, table), size in zip(tables.items(), sizes, strict=True):
        tracks[name] = table if isinstance(table, SpotTrack) else read_spot_track(table)
        _require_inside(tracks[name], f"the table of {name}" if isinstance(table, SpotTrack) else table, size)
    return tracks, sizes


def spots_and_sizes(
    search: SpotSearch, sources: Mapping[str, str], progress: Progress
) -> tuple[dict[str, SpotTrack], Sequence[Size]]:
    """Return the spots in frames by camera, and the sizes of their images. Raises UsageError, Inconsistent."""
    seen: dict[str, list[Size]] = {name: [] for name in sources}

    def look(name: str, text: str, progress: Progress) -> SpotTrack:
        return spots_of_frames(search, name, text, progress, _one_size(seen[name]))

    tracks = side_by_side(look, sources, progress)
    for name, sizes in seen.items():
        if not sizes:
            raise UsageError(f"{sources[name]} holds no frames", cure="Give the frames of the recording")
    return tracks, [sizes[0] for sizes in seen.values()]


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


def require_own(tracks: Mapping[str, SpotTrack]) -> None:
    """Raise Inconsistent where two cameras are one."""
    for (name, one), (other, two) in combinations(tracks.items(), 2):
        if one.uv_px.shape == two.uv_px.shape and len(one.uv_px) and (one.uv_px == two.uv_px).all():
            raise Inconsistent(
                f"{name} and {other} hold the same spots: they are one camera",
                consequence="Nothing is known of a second one, and no cell is calibrated",
                cure="Give each side the frames or spots of its own camera",
            )


def _require_inside(track: SpotTrack, path: Path | str, size: Size) -> None:
    """Raise Inconsistent where spots are outside of images of a size."""
    most = track.uv_px.max(axis=0)
    if (most > np.array(size) - 0.5).any() or track.uv_px.min() < -0.5:
        raise Inconsistent(
            f"{path} has spots up to ({most[0]:.0f}, {most[1]:.0f}) px, outside of images of {size[0]}x{size[1]} px",
            consequence="No cell is calibrated",
            cure="Give the size of the images in which the spots were found: --size, or --right-size of the right one",
        )


def read_priors(
    paths: Sequence[Path], sizes: Sequence[tuple[int, int]], names: Sequence[str] = SIDES
) -> CellPriors | None:
    """Return what files say of a cell whose cameras have these names and sizes (w, h) px; None for no file.

    Raises UsageError for another kind of file, NotEnoughData for one without a covariance, Inconsistent for cameras of
    another size.
    """
    known, world_pose, first = CellPriors(), None, names[0]
    for path in paths:
        kind = kind_of(path)
        if kind == "armsight/rig":
            rig, first = _of_rig(path, sizes, names)
            known = replace(known, rig=rig)
        elif kind == "armsight/world":
            world = read_world(path)
            if world.parent != "base":
                raise Inconsistent(
                    f"{path}: says where the rig stands in the world, not to the base",
                    cure="Give the world.yaml that `armsight calibrate robot-world` or `calibrate cell` wrote",
                )
            world_pose = (world.T_parent_rig, _told(world.covariance, path))
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
    if world_pose is not None:
        known = replace(known, base_pose=_of_first(world_pose, known.rig, first, names[0]))
    return known if paths else None


def _of_rig(path: Path, sizes: Sequence[tuple[int, int]], names: Sequence[str]) -> tuple[Rig, str]:
    """Return what a rig's file says of the cameras that were recorded, and which camera is the first one there."""
    rig = read_rig(path, any_cameras=True)
    _told(rig.covariance, path)
    for name, size in zip(names, sizes, strict=True):
        if name not in rig.names:
            continue
        camera = rig.camera(name)
        if camera.lens is not LensKind.PINHOLE:
            raise Inconsistent(
                f"{path}: the {name} camera has a {camera.lens} lens",
                consequence="A cell's cameras are fitted with k1, k2, p1, p2, k3: its coefficients say nothing here",
                cure="Leave the rig out, or give one that was calibrated as pinholes",
            )
        if (camera.width, camera.height) != tuple(size):
            raise Inconsistent(
                f"{path}: the {name} camera has {camera.width}x{camera.height} px, the recording {size[0]}x{size[1]}",
                consequence="Its lens is not that of these images",
                cure="Give the rig.yaml of these cameras in this mode",
            )
    both = [name for name in names if name in rig.names]
    if not both:
        raise Inconsistent(
            f"{path} is of the cameras {', '.join(rig.names)}, and the recording of {', '.join(names)}",
            consequence="It tells nothing of these cameras",
            cure="Name each camera as in the rig's file; or leave it out",
        )
    return rig.only(*both), rig.names[0]


def _of_first(
    pose: tuple[RigidTransform, NamedCovariance], rig: Rig | None, first: str, recorded: str
) -> tuple[RigidTransform, NamedCovariance]:
    """Return where the camera that was recorded first stands by where the axes of a rig do, with the covariance.

    first: the rig's own first camera, which stands in these axes exactly.
    """
    T, covariance = pose
    if first != recorded:
        raise Inconsistent(
            f"world.yaml says where the axes of rig.yaml stand, and its camera {recorded} is not the one that has them",
            consequence="How well its place is known is open",
            cure="Give the cameras of the recording in the order of rig.yaml; or leave world.yaml out",
        )
    T_rig_first = RigidTransform.identity() if rig is None else rig.cameras[0].T_rig_camera
    if not np.any(T_rig_first.as_matrix() - np.eye(4)):
        return pose
    J = np.eye(6)
    J[:3, 3:] = -skew(T.rotation.apply(T_rig_first.translation))
    return T * T_rig_first, NamedCovariance(names=covariance.names, matrix=J @ covariance.matrix @ J.T)


def _told(covariance: NamedCovariance | None, path: Path) -> NamedCovariance:
    if covariance is None:
        raise NotEnoughData(
            f"{path} brings no covariance",
            consequence="How much it is to count beside the recording is not known",
            cure="Calibrate with a current version, or leave it out",
        )
    return covariance
