"""A mirror rig from complex images of a printed board."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike, fspath
from types import NoneType

from armsight.app.calibrate.board_images import count_again, in_parallel
from armsight.app.calibrate.mirrors import mirrors_output
from armsight.app.calibrate.results import MirrorsOutput
from armsight.app.requests.calibrate_cameras import MirrorsJob
from armsight.app.sources.frames import open_source
from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.mirrors import calibration as mirror_solver
from armsight.calibrate.mirrors.calibration import MirrorCalibration
from armsight.errors import BadImage, NotEnoughData, UsageError
from armsight.measure.boards import find_two_boards
from armsight.ops.arrays import Image, ImageLike, as_images
from armsight.ops.checks import speaks_python
from armsight.records import BoardView, Frame, NotSeen, Target, require_kind
from armsight.records.result_parts import RejectedFile
from armsight.store import parse_board

Images = ImageLike | Iterable[ImageLike]
Rejected = tuple[RejectedFile, ...]


@speaks_python(MirrorsJob)
def calibrate_mirrors(
    images: Images,
    board: str | Target,
    *,
    thickness_m: float | None = None,
    options: BoardOptions | None = None,
) -> MirrorsOutput:
    """Return the mirror rig whose complex images show the board in both views.

    Parameters
    ----------
    images
        As calibrate_camera takes them, each of both views over each other.
    board
        As calibrate_camera takes it.
    thickness_m
        Of the glass plate in m; None to find it, 0 for none.
    options
        What is held fixed, and how outliers are rejected.

    Raises
    ------
    NotEnoughData
        The board is seen twice in too few images; else as calibrate_camera.
    """
    target, options = _board(board), _options(options)
    seen = list(in_parallel(lambda frame: (frame.source, _two(frame.image, target)), _frames(images)))
    missed = tuple(RejectedFile(name, views.why) for name, views in seen if isinstance(views, NotSeen))
    found = [views for _, views in seen if not isinstance(views, NotSeen)]
    _require([left for left, _ in found], missed, target)
    done: MirrorCalibration = mirror_solver.calibrate_mirrors(
        [left for left, _ in found], [right for _, right in found], target, thickness_m=thickness_m, options=options
    )
    return mirrors_output(done, missed)


def _frames(images: Images) -> Sequence[Frame]:
    if not isinstance(images, str | PathLike):
        return as_images(images, "image")  # type: ignore[arg-type]  # one that is not many is refused
    with open_source(fspath(images)) as source:
        return list(source)


def _board(board: str | Target) -> Target:
    require_kind("board", board, str, Target, cure="Give 'checkerboard:9x6:0.025' or a Target, see calibrate_camera")
    target = parse_board(board) if isinstance(board, str) else board
    if not target.is_board:
        raise UsageError(
            "the board is a target of lights", consequence="It is in no image", cure="Give a printed board"
        )
    return target


def _options(options: BoardOptions | None) -> BoardOptions | None:
    require_kind("options", options, BoardOptions, NoneType, cure="Give BoardOptions(...)")
    return options


def _two(image: Image, board: Target) -> tuple[BoardView, BoardView] | NotSeen:
    try:
        return find_two_boards(image, board)
    except BadImage as error:
        return NotSeen(error.cause, error.unseen)


def _require(views: list[BoardView], missed: Rejected, board: Target) -> None:
    if not views:
        first = f"; in the first, {missed[0][0]}: {missed[0][1]}" if missed else ": there are none"
        raise NotEnoughData(
            f"the board was found in none of the images{first}",
            consequence="Nothing was calibrated",
            cure=count_again(board),
        )
