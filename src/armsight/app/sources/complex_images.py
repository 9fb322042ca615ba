"""Images that hold both views of a rig: one upon the other, or side by side."""

from __future__ import annotations

from collections.abc import Callable

from armsight.drivers import FrameSource, Overlaid, PairSource, SplitImages
from armsight.errors import Inconsistent
from armsight.optics import Rig, RigKind
from armsight.records import Frame


def complex_pairs(open_images: Callable[[], FrameSource], rig: Rig) -> tuple[PairSource, bool]:
    """Return the pairs in complex images, not yet open, and whether both views lie one upon the other in them.

    With a mirror rig they always do. With two cameras the first image's size tells: that of one camera, or that of both
    side by side. Raises Inconsistent for any other size.
    """
    if rig.kind is RigKind.MIRROR:
        return Overlaid(open_images()), True
    left, right = ((camera.width, camera.height) for camera in (rig.left, rig.right))
    with open_images() as frames:
        first = next(iter(frames), None)
    if first is not None and left == right == (first.width, first.height):
        return Overlaid(open_images()), True
    if first is not None:
        _require_both(first, left, right)
    return SplitImages(open_images(), left, right), False


def _require_both(frame: Frame, left: tuple[int, int], right: tuple[int, int]) -> None:
    width = left[0] + right[0]
    if (frame.width, frame.height) == (width, left[1]) and left[1] == right[1]:
        return
    one = f"{left[0]}x{left[1]} px with one view upon the other, or " if left == right else ""
    raise Inconsistent(
        f"{frame.source} is {frame.width}x{frame.height} px; an image of both views of this rig is {one}"
        f"{width}x{max(left[1], right[1])} px with the views side by side",
        consequence="The image cannot be taken for its two views",
        cure="Give the rig that was calibrated with this camera at this resolution",
    )
