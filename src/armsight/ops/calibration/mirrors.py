"""The board, or the lit target, in complex images: what the calibration of a mirror rig and its check look at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import cast

from armsight.calibrate.mirrors.diagnosis import Adjustment, Alignment, adjust_to_parallel, check_alignment
from armsight.calibrate.mirrors.result import reasons
from armsight.drivers import CameraSettings
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, Unseen, UsageError
from armsight.ops.calibration.board_images import in_parallel, see_board, see_two_boards
from armsight.ops.calibration.board_pictures import BoardPictures
from armsight.ops.calibration.cameras import Moments, count, open_images
from armsight.optics import Camera, Plate, Rig
from armsight.optics.mirrors import Mirrors
from armsight.records import BoardView, Frame, NotSeen, Progress, Silent, Target
from armsight.store.cell_file import CellMirrors
from armsight.store.targets import board_text

KEPT = 8
"""Frames that a live check looks back on: a turned screw should show."""
LEAST_BOARDS = 3
"""Images of the board below which nothing is calibrated."""

CURES: Mapping[Unseen, str] = {
    Unseen.BEYOND_SIZE: "Check the counts of --board, or look for a third reflection of the board",
    Unseen.THRICE: "Look for a third reflection: show the board once in each view",
    Unseen.ONLY_ONCE: "Open both paths; where each image shows one view, give --left-only and --right-only",
    Unseen.IN_PART: "Show the whole board in both views",
    Unseen.BLURRED: "Hold the board still, shorten the exposure or focus the lens",
}
"""What helps against what kept the board from being seen."""
OTHER_CURE = "Show the whole board in both views, lit evenly, and check the counts of --board"

Pair = tuple[BoardView, BoardView]
Source = str | Sequence[Frame]
Missed = tuple[str, NotSeen]
"""Which image, and why."""


def require_board(board: object) -> None:
    """Raise UsageError where it is not told which board the images show."""
    if board is None:
        raise UsageError("there is no board", cure="Give --board, for instance checkerboard:9x6:0.025")


def require_shown(board: object, lit: object, image: object, left_only: object, right_only: object) -> None:
    """Raise UsageError where it is not told what the images show, or which images there are."""
    if lit is not None and board is not None:
        raise UsageError("--target and --board are both given", cure="Give the one that the images show")
    if lit is not None and not left_only is right_only is None:
        raise UsageError("--target goes with complex images only", cure="Give --image, or covered views with --board")
    if lit is not None:
        return
    require_board(board)
    if (left_only is None) != (right_only is None):
        given, missing = ("--left-only", "--right-only") if right_only is None else ("--right-only", "--left-only")
        raise UsageError(
            f"{given} is given without {missing}",
            cure=f"Give {missing} too, with the images of the same places of the board, or --image with complex images",
        )
    if image is None and left_only is None:
        raise UsageError("there are no images", cure="Give --image, or --left-only and --right-only")


def complex_views(
    moments: Moments, board: Target, pictures: BoardPictures, every: int, limit: int | None, workers: int | None
) -> Iterator[tuple[str, Pair | NotSeen]]:
    """Yield each complex image's name with the board in both of its views, or why there are not two."""

    def see(frame: Frame) -> tuple[str, Pair | NotSeen]:
        return frame.source, see_two_boards(frame, board, pictures)

    stop = None if limit is None else limit * every
    yield from in_parallel(see, islice(cast(Iterator[Frame], moments), 0, stop, every), workers=workers)


def covered_views(
    lefts: Moments, rights: Moments, board: Target, pictures: BoardPictures
) -> Iterator[tuple[str, Pair | NotSeen]]:
    """Yield the pairs of images taken with one path covered after the other. Raises Inconsistent."""
    if count(lefts) != count(rights):
        raise Inconsistent(
            f"{count(lefts)} images of the left view and {count(rights)} of the right one do not pair up",
            consequence="Nothing was calibrated",
            cure="Cover one path after the other at every place of the board",
        )
    for left, right in zip(cast(Iterable[Frame], lefts), cast(Iterable[Frame], rights), strict=True):
        seen = [see_board(frame, board, pictures=pictures) for frame in (left, right)]
        lost = [(frame.source, one) for frame, one in zip((left, right), seen, strict=True) if isinstance(one, NotSeen)]
        both = [one for one in seen if isinstance(one, BoardView)]
        yield left.source, _joined(lost) if lost else (both[0], both[1])


def _joined(lost: Sequence[Missed]) -> NotSeen:
    """Return what was not seen in one image or two as one reason; its cause is the first that has a cure of its own."""
    causes = [one.cause for _, one in lost if one.cause in CURES]
    return NotSeen("; ".join(f"{source}: {one.why}" for source, one in lost), causes[0] if causes else Unseen.OTHER)


def board_views(
    sources: tuple[Source | None, Source | None, Source | None],
    board: Target,
    pictures: BoardPictures,
    settings: CameraSettings,
    search: tuple[int, int | None, int | None],
    progress: Progress | None,
) -> tuple[list[Pair], list[Missed]]:
    """Return the board in both views, and the images in which it is not.

    sources: complex images, and those of the left and of the right view. search: every so many of the complex ones, so
    many at most, on so many threads. Raises NotEnoughData, Inconsistent, Cancelled.
    """
    views: list[Pair] = []
    missed: list[Missed] = []
    image, left, right = sources
    progress, limit = progress or Silent(), search[1]

    def seen() -> Iterator[tuple[str, Pair | NotSeen]]:
        if image is not None:
            with open_images(image, settings=settings) as moments:
                yield from complex_views(moments, board, pictures, *search)
        if left is not None and right is not None:
            with open_images(left, settings=settings) as lefts, open_images(right, settings=settings) as rights:
                yield from covered_views(lefts, rights, board, pictures)

    for name, one in seen():
        if isinstance(one, NotSeen):
            missed.append((name, one))
        else:
            views.append(one)
        progress.update(len(views) + len(missed), limit or 0, "finding the board")
        if progress.cancelled():
            raise Cancelled("stopped", consequence="Nothing was written")
    if len(views) < LEAST_BOARDS:
        raise _too_few(board, len(views), missed)
    return views, missed


def _too_few(board: Target, n: int, missed: Sequence[Missed]) -> NotEnoughData:
    """Return the refusal of too few images that show the board in both views, with the commonest reasons."""
    total = n + len(missed)
    found = reasons([seen for _, seen in missed])
    said = "; ".join(f"{seen.why} (in {count})" for seen, count in found[:3])
    cure = "Take ten to twenty images, with the board tilted in different directions"
    if found:
        cure = CURES.get(found[0][0].cause, OTHER_CURE)
    counted = f"{n or 'none'} of {total} image{'' if total == 1 else 's'} show{'s' if n == 1 else ''}"
    return NotEnoughData(
        f"{counted} the board {board_text(board)} in both views, {LEAST_BOARDS} are needed"
        + (f": {said}" if said else ""),
        consequence="Nothing was calibrated",
        cure=cure,
    )


def lit_design(built: CellMirrors, camera: Camera | None, *, image: bool) -> Rig:
    """Return the rig as it was designed, its lens known. Raises UsageError that names what is missing."""
    needed = {
        "--camera": (camera is not None, "camera.yaml, the lens"),
        "--baseline-mm": (built.baseline_m is not None, "the baseline as designed"),
        "--image": (image, "the complex images"),
    }
    missing = {name: what for name, (given, what) in needed.items() if not given}
    if camera is None or built.baseline_m is None or missing:
        raise UsageError(
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing: "
            "the lit target alone does not tell the rig",
            cure=f"Give {' and '.join(f'{name} ({what})' for name, what in missing.items())}",
        )
    design = _mirrors(built, built.baseline_m, None).rig(camera)
    bare = design.with_each(camera=[replace(one.camera, plate=None) for one in design.cameras])
    return bare if built.plate_m == 0.0 else design


def _mirrors(built: CellMirrors, baseline_m: float, plate: Plate | None) -> Mirrors:
    plate = plate or Plate(thickness_m=built.plate_m or 1e-3, index=built.index)
    return Mirrors(baseline_m=baseline_m, near_m=built.near_m, gap_m=built.gap_m, plate=plate)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reference:
    """What the mirrors are held against: a rig as it was calibrated; or, None, parallel axes seen through a lens that
    is known. design: where the mirrors stand."""

    design: Mirrors
    rig: Rig | None = None
    camera: Camera | None = None


def reference_of(built: CellMirrors, rig: Rig | None, camera: Camera | None, *, parallel: bool) -> Reference:
    """Return what mirrors are held against. Raises UsageError where too little is known."""
    if rig is not None:
        design = _mirrors(built, built.baseline_m or rig.baseline_m, rig.left.plate)
        return Reference(camera=rig.left, design=design) if parallel else Reference(rig=rig, design=design)
    if camera is None or built.baseline_m is None:
        raise UsageError(
            "nothing to hold the mirrors against",
            cure="Give --rig rig.yaml, as it was calibrated; or, to make the axes parallel, --camera camera.yaml (the "
            "lens) and --baseline-mm (as designed)",
        )
    return Reference(camera=camera, design=_mirrors(built, built.baseline_m, None))


@dataclass(slots=True, kw_only=True)
class AlignmentWatch:
    """Holds the mirrors against a reference, by the last views of a board; back: how many of them, None all."""

    reference: Reference
    board: Target
    back: int | None = KEPT
    _kept: list[Pair] = field(default_factory=list)

    def see(self, pair: Pair) -> Alignment | Adjustment:
        """Return how the mirrors stand with one more pair of views. Raises Inconsistent, NotEnoughData."""
        self._kept = [*self._kept, pair][-(self.back or 0) :]
        left, right = [a for a, _ in self._kept], [b for _, b in self._kept]
        reference = self.reference
        if reference.rig is not None:
            return check_alignment(reference.rig, left, right, self.board, design=reference.design)
        if reference.camera is None:
            raise UsageError("nothing to hold the mirrors against", cure="Give a rig, or the lens")
        return adjust_to_parallel(reference.camera, reference.design, left, right, self.board)


def watched(
    watch: AlignmentWatch, seen: Iterator[tuple[str, Pair | NotSeen]], limit: int | None, progress: Progress
) -> tuple[Alignment | Adjustment, list[str]]:
    """Return how the mirrors stand by the last frames, and which frames did not show the board, and why.

    Goes on until the frames end, of a live camera until it is cancelled. Raises NotEnoughData where none shows it, and
    Cancelled.
    """
    missed: list[str] = []
    last: Alignment | Adjustment | None = None
    for number, (source, one) in enumerate(seen, 1):
        if isinstance(one, NotSeen):
            missed.append(f"{source}: {one.why}")
            progress.update(number, limit or 0, one.why)
        else:
            last = watch.see(one)
            progress.update(number, limit or 0, _line(last))
        if progress.cancelled():
            if watch.back is None:
                raise Cancelled(f"stopped after {number} images", consequence="The alignment is not known")
            break
    if last is None:
        raise NotEnoughData(
            f"the board was found in both views of none of the images; {missed[0] if missed else 'there are none'}",
            consequence="The alignment is not known",
            cure="Show the whole board in both views",
        )
    return last, missed


def _line(found: Alignment | Adjustment) -> str:
    now = found.now
    return (
        f"convergence {1e3 * now.convergence_rad:+.2f} mrad, vertical {now.vertical_px:+.2f} px, "
        f"roll {1e3 * now.roll_rad:+.2f} mrad; {found.advice()}"
    )
