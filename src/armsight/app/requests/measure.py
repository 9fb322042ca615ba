"""What `armsight measure` and `armsight record` are told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag, Flags, loaded
from armsight.ops.flags import (
    A_SRC,
    Bits,
    CameraFlags,
    Cameras,
    Fps,
    Inverted,
    Left,
    Limit,
    MaxSkew,
    OutFolder,
    Right,
    Strict,
    Threshold,
    automatic,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.drivers import ImageReading, PairSettings
    from armsight.store.recording import ImageFormat


def image_reading(bits: int | None, *, strict: bool) -> ImageReading:
    """Return how image files are read."""
    from armsight.drivers import ImageReading

    return ImageReading(bits=bits, strict=strict)


@dataclass(frozen=True, kw_only=True)
class ZoomsFlags:
    """Where the zoom lenses of a rig stand."""

    zoom_left: Annotated[float | None, Doc("Where the left zoom lens stands, of a rig with them.")] = None
    zoom_right: Annotated[float | None, Doc("Where the right zoom lens stands.")] = None

    def made(self, notify: Callable[[str], None]) -> tuple[float | None, float | None]:
        """Return both."""
        return self.zoom_left, self.zoom_right


@dataclass(frozen=True, kw_only=True)
class MeasureJob:
    """What to measure, with what, and where to put it: left and right, or image, or tables of spots.

    fps: of folders. camera_settings: what is asked of live cameras, or of each. With free cameras poses are at rate_hz,
    or at the times of the table `at`, or at those of the left frames.
    """

    rig: Annotated[Path, Doc("rig.yaml of the two cameras, from `armsight calibrate stereo`.")]
    target: Annotated[
        Path, Doc("target.yaml: the lights or the board that is looked for; or a board as checkerboard:9x6:0.025.")
    ]
    out: OutFolder
    left: Left = None
    right: Right = None
    image: Annotated[
        str | None, Doc("Images that hold both views: side by side, or one upon the other (mirror rig)."), A_SRC
    ] = None
    times: Annotated[Path | None, Doc("times.csv with a column t_s, one row per frame.")] = None
    world: Annotated[Path | None, Doc("world.yaml: give the poses in this frame.")] = None
    fps: Fps = None
    limit: Limit = None
    threshold: Threshold = None
    inverted: Inverted = False
    stills: Annotated[bool, Doc("The frames are single shots, not a motion: measure each by itself.")] = False
    bits: Bits = None
    strict: Strict = False
    mask: Annotated[Path | None, Doc("Image that is black where no light may be looked for.")] = None
    max_skew_s: MaxSkew = None
    method: Annotated[
        str, Doc("likelihood (a light's model is fitted) or seed (Pachidis 2005: threshold, cross, mean).")
    ] = "likelihood"
    timing: Annotated[
        str,
        Doc(
            "pairs: the views of a pair are of one moment. free: each view at its own time, for cameras that no "
            "wire joins. auto: free where rig.yaml has `timing`."
        ),
    ] = "auto"
    rate_hz: Annotated[
        float | None, Doc("With free cameras: poses a second. [default: the left frames]"), Bounds(least=1e-3)
    ] = None
    at: Annotated[
        Path | None, Doc("With free cameras: poses at the t_s of this joints.csv, or of bag:FILE:/topic.")
    ] = None
    left_spots: Annotated[
        Path | None, Doc("t_s,u_px,v_px[,su_px,sv_px][,spot]: spots of the left camera found elsewhere.")
    ] = None
    right_spots: Annotated[Path | None, Doc("The same of the right camera.")] = None
    zoom: Annotated[tuple[float | None, float | None], Flags(ZoomsFlags)] = (None, None)
    camera_settings: Annotated[PairSettings, Flags(CameraFlags)] = field(default_factory=automatic)

    @property
    def reading(self) -> ImageReading:
        """How image files are read; one that cannot be is a lost frame unless the job is strict."""
        return image_reading(self.bits, strict=self.strict)


def image_format(text: str) -> ImageFormat:
    """Return how frames are kept, by its name. Raises UsageError."""
    from armsight.store.recording import ImageFormat

    try:
        return ImageFormat(text.lower())
    except ValueError:
        known = ", ".join(kind.value for kind in ImageFormat)
        raise UsageError(f"frames are not kept as {text!r}", cure=f"Choose one of {known}") from None


@dataclass(frozen=True, kw_only=True)
class RecordJob:
    """What to record: left and right, or a simulated cell; rig and target go into the recording. limit: pairs."""

    out: Annotated[Path, Doc("The recording."), Flag("-o --out", metavar="FILE.mcap")]
    left: Left = None
    right: Right = None
    cell: Annotated[str | None, Doc("A simulated cell in place of cameras, such as hand-cell.")] = None
    seed: Annotated[int, Doc("The same seed gives the same frames."), Bounds(least=0)] = 0
    rig: Annotated[Path | None, Doc("rig.yaml: its calibration goes into the recording.")] = None
    target: Annotated[Path | None, Doc("target.yaml that goes into the recording.")] = None
    kind: Annotated[
        ImageFormat,
        Doc("png (bit for bit, small), raw (bit for bit, quick) or jpeg (smallest)."),
        Flag("--format", default="png", read=image_format),
    ] = field(default_factory=loaded("armsight.store.recording:ImageFormat.PNG"))
    colour: Annotated[bool, Doc("Keep the colours; else grey is recorded.")] = False
    fps: Fps = None
    limit: Limit = None
    seconds_s: Annotated[float | None, Doc("Stop after so many seconds."), Bounds(above=0.0)] = None
    max_skew_s: MaxSkew = None
    overwrite: Annotated[bool, Doc("Replace a file of this name.")] = False
    camera_settings: Cameras = field(default_factory=automatic)
