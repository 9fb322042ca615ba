"""Still frames in, the noise of the camera into its file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.camera_noise.photon_transfer import NoiseResult, calibrate_noise
from armsight.drivers import AUTOMATIC, CameraSettings, is_live, list_images
from armsight.drivers.sources import VIDEO_SUFFIXES
from armsight.errors import BadFile, Cancelled, Inconsistent, UsageError
from armsight.ops.sources.frames import is_recording, open_source, recording_path
from armsight.optics import SIDES, Camera, RigKind
from armsight.records import Progress, Silent
from armsight.store import add_noise, is_zoom_camera, read_camera_file, read_zoom_camera, read_zoom_rig
from armsight.store.bags import bag_topic, is_bag
from armsight.store.rigs import CAMERA_YAML, RIG_YAML
from armsight.store.yamls import read_yaml

FRAMES = 50
"""Frames taken where nothing else is said: with 20 the variance is known to 1 %, more are not needed."""

SETTLING_FRAMES = 15
"""First frames of a live camera that are left out: its exposure still settles."""

FILES = (".yaml", ".yml")


def run_noise(
    frames: str,
    out: Path,
    *,
    side: str | None = None,
    every: int = 1,
    limit: int | None = None,
    settings: CameraSettings = AUTOMATIC,
    progress: Progress | None = None,
) -> NoiseResult:
    """Find a camera's noise and add it to its camera.yaml or rig.yaml, there to one side; return what was found.

    Raises UsageError, DataRefused or DeviceFailed, Cancelled.
    """
    sides = _sides(out, side)
    found = find_noise(frames, side=side, every=every, limit=limit, settings=settings, progress=progress)
    for size in sides.values():
        if size is not None:
            require_size(found, size, str(out))
    add_noise(out, dict.fromkeys(sides, found.model), inputs=found.inputs)
    return found


def find_noise(
    frames: str,
    *,
    side: str | None = None,
    every: int = 1,
    limit: int | None = None,
    settings: CameraSettings = AUTOMATIC,
    progress: Progress | None = None,
) -> NoiseResult:
    """Return the noise that still frames (a source as on the command line) show, or that a side of a file holds.

    Raises as run_noise does.
    """
    path = Path(frames)
    if path.suffix.lower() in FILES:
        return _from_file(path, side)
    size: list[tuple[int, int]] = []
    progress = progress or Silent()

    def images() -> Iterator[NDArray[np.uint8]]:
        first = SETTLING_FRAMES if is_live(frames) else 0
        with open_source(frames, settings=settings) as source:
            for i, frame in enumerate(islice(source, first, first + (limit or FRAMES) * every, every)):
                progress.update(i + 1, 0, "reading still frames")
                if progress.cancelled():
                    raise Cancelled(f"stopped after {i} frames", consequence="Nothing was written")
                if not size:
                    size.append((frame.width, frame.height))
                yield frame.image

    found = calibrate_noise(images())
    return NoiseResult(noise=found, size=size[0], inputs=tuple(input_files(frames)))


def require_size(found: NoiseResult, size: tuple[int, int], where: str) -> None:
    """Raise Inconsistent where the noise is of frames of another size than the camera's (width, height)."""
    if found.size != size:
        raise Inconsistent(
            f"the still frames have {found.size[0]} x {found.size[1]} px, the camera of {where} has "
            f"{size[0]} x {size[1]}",
            consequence="A camera that scales its image has another noise, so nothing was written",
            cure="Take the still frames in the mode the camera is used in",
        )


def input_files(text: str) -> Sequence[Path]:
    """Return the files behind a source, whose hashes go into the result."""
    if is_live(text):
        return ()
    if is_bag(text):
        path = bag_topic(text)[0]
        return sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]
    if is_recording(text):
        return [recording_path(text)]
    return [Path(text)] if Path(text).suffix.lower() in (*VIDEO_SUFFIXES, *FILES) else list_images(text)


def _sides(out: Path, side: str | None) -> dict[str, tuple[int, int] | None]:
    """Return the places in the file that get the noise, each with its camera's size, None where any will do."""
    if not out.exists():
        raise UsageError(
            f"there is no file {out} that the noise could be added to",
            consequence="Nothing was done",
            cure="Give the camera.yaml or rig.yaml of the camera with -o; SRC and --board make one",
        )
    content = read_yaml(out)
    format_ = content.get("format")
    if format_ == CAMERA_YAML.format:
        if side is not None:
            raise UsageError(f"{out} holds one camera", cure="Leave --side away")
        of_lens = is_zoom_camera(content)
        return {"": read_zoom_camera(out).lens.size if of_lens else _size(read_camera_file(out).camera)}
    if format_ != RIG_YAML.format:
        raise BadFile(
            f"{out}: says format {str(format_)[:60]!r}, which is no camera's and no rig's",
            consequence="Nothing was written",
            cure="Give a camera.yaml or a rig.yaml",
        )
    rig = read_zoom_rig(out)
    if rig.kind is RigKind.MIRROR:  # one camera, seen twice; a view may be a part of its image
        return dict.fromkeys(SIDES)
    if side not in rig.names:
        raise UsageError(
            f"{out} holds the cameras {', '.join(rig.names)}, and it is not said which one the frames are of",
            cure="Add " + " or ".join(f"--side {name}" for name in rig.names),
        )
    return {side: _size(rig.camera(side))}


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def _from_file(path: Path, side: str | None) -> NoiseResult:
    """Return the noise that a camera.yaml, or the side of a rig.yaml, holds. Raises BadFile."""
    content = read_yaml(path)
    if content.get("format") == RIG_YAML.format:
        rig = read_zoom_rig(path)
        if rig.kind is not RigKind.MIRROR and side not in rig.names:
            raise UsageError(
                f"{path} holds the cameras {', '.join(rig.names)}, and it is not said whose noise is meant",
                cure="Add --side where the noise goes into a rig.yaml; for a camera.yaml give still frames",
            )
        at = rig.names.index(side) if side in rig.names else 0
        noise, size = rig.noise[at], _size(rig.cameras[at].camera)
    elif is_zoom_camera(content):
        zoomed = read_zoom_camera(path)
        noise, size = zoomed.noise, zoomed.lens.size
    else:
        file = read_camera_file(path)
        noise, size = file.noise, _size(file.camera)
    if noise is None:
        raise BadFile(f"{path}: holds no noise", consequence="Nothing was written", cure="Give still frames instead")
    return NoiseResult(noise=noise, size=size, inputs=(path,))
