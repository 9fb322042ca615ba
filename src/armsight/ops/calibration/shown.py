"""What is shown to some cameras: a board, a plate with a board on each side, or a target's lights in place of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from armsight.calibrate.cameras.preconditions import LEAST_POINTS
from armsight.calibrate.cameras.two_sides import TwoSided, require_two_sides
from armsight.errors import UsageError
from armsight.measure.settings import SpotSettings
from armsight.ops.calibration.board_images import Keeper, Seen, count_again, require_counts, see_board
from armsight.optics import Rig
from armsight.optics.mounted import MountedCamera
from armsight.records import BoardView, Frame, NotSeen, PoseStatus, Spots, Target
from armsight.store.targets import board_text

if TYPE_CHECKING:
    from armsight.measure.poses.setup import Setup


def shown_of(board: Target | None, back: Target | None, target: Target | None) -> Target | TwoSided:
    """Return what is shown; raises UsageError where it is not one thing, or would not be told."""
    if board is not None and target is None:
        if back is None:
            return board
        require_two_sides(board, back)
        return TwoSided(board, back)
    if target is None or board is not None:
        raise UsageError(
            "what do the cameras see?" if target is None else "the cameras see a board and a target",
            cure="Give --board, or --target with lights at known places",
        )
    if back is not None:
        raise UsageError("a target of lights has no back", cure="Leave --back away, or give --board")
    if target.is_board or not target.model_known or len(target.names) < LEAST_POINTS:
        raise UsageError(
            "one camera alone names and places lights where there are four and more at known places",
            consequence="Nothing was calibrated",
            cure="Give a target.yaml of such lights, some off the others' plane (armsight calibrate target); a board's "
            "with --board",
        )
    return target


def words_of(shown: Target | TwoSided) -> str:
    """Return what is shown, as it is asked for."""
    if isinstance(shown, TwoSided):
        return f"{board_text(shown.front)}, on its back {board_text(shown.back)}"
    return board_text(shown) if shown.is_board else f"of the lights {', '.join(shown.names)}"


def front_of(shown: Target | TwoSided) -> Target:
    """Return the side that poses are of."""
    return shown.front if isinstance(shown, TwoSided) else shown


class Glimpse(NamedTuple):
    """The spots of one frame, before it is known which of them stand still."""

    spots: Spots
    frame: tuple[int, int, str]


class Eye:
    """Finds what is shown in the frames of one camera. camera: its lens, which lights need; settings: of spots."""

    def __init__(
        self,
        shown: Target | TwoSided,
        detector: str,
        pictures: Keeper,
        known: MountedCamera | None,
        spots: SpotSettings,
    ) -> None:
        self.shown, self.detector, self.pictures = shown, detector, pictures
        self.setup: Setup | None = None
        if isinstance(shown, Target) and not shown.is_board and known is not None:
            from armsight.measure.poses.setup import Setup  # with all of lights, which take longer than a few boards

            self.setup = Setup(rig=Rig(cameras=(known,)), target=shown, settings=spots)

    @property
    def noun(self) -> str:
        """What is looked for."""
        return "board" if self.setup is None else "target"

    def see(self, frame: Frame) -> Seen | Glimpse:
        """Return what one frame shows, or why it shows nothing; frames of several threads may come at once."""
        if self.setup is not None:
            from armsight.measure.poses.pipeline import check_size
            from armsight.measure.spots import find_spots

            if frame.unreadable:
                return NotSeen(frame.unreadable)
            check_size(self.setup.rig, self.setup.rig.names[0], frame, "The lens is of other images")
            self.pictures.keep(frame)
            return Glimpse(find_spots(frame.image, self.setup.sides[0]), (frame.width, frame.height, frame.source))
        if isinstance(self.shown, Target):
            return see_board(frame, self.shown, self.detector, self.pictures)
        front, back = self.shown
        seen = see_board(frame, front, self.detector, self.pictures)
        if isinstance(seen, BoardView):
            return seen
        behind = see_board(frame, back, self.detector, self.pictures)
        if isinstance(behind, BoardView):
            return replace(behind, index=behind.index + len(front.names))
        return behind if behind.size is not None and seen.size is None else seen

    def told(self, seen: Sequence[Seen | Glimpse]) -> list[Seen]:
        """Return the views of all frames: of lights those that do not stand still, named in each view by itself."""
        if self.setup is None:
            return [one for one in seen if not isinstance(one, Glimpse)]
        from armsight.measure.poses.beacon import without_standing

        moving = iter(without_standing([one.spots for one in seen if isinstance(one, Glimpse)]))
        return [_named(self.setup, next(moving), one.frame) if isinstance(one, Glimpse) else one for one in seen]


def _named(setup: Setup, spots: Spots, frame: tuple[int, int, str]) -> Seen:
    from armsight.measure.poses.views import MOST_ALONE, measure_views

    # the strongest come first: in a lit room edges and labels are seen beside the lights
    found = measure_views(setup, 0.0, [spots.take(np.arange(min(len(spots), MOST_ALONE)))])
    if found.pose.status is not PoseStatus.OK:
        return NotSeen(found.pose.why, found.cause)
    width, height, source = frame
    # a view's points weigh alike: by the mean variance of a coordinate
    variance = np.trace(found.spots[0].covariance_px2, axis1=1, axis2=2).mean() / 2.0
    return BoardView(
        uv_px=found.spots[0].uv_px,
        index=np.array([setup.target.names.index(name) for name in found.names], np.intp),
        sigma_px=float(np.sqrt(variance)),
        width=width,
        height=height,
        source=source,
    )


def require_shown(seen: Sequence[Seen], shown: Target | TwoSided) -> None:
    """Raise Inconsistent where more images show a board of another size than what is shown."""
    if isinstance(shown, Target):
        if shown.is_board:
            require_counts(seen, shown, board_text(shown))
        return
    n = len(shown.front.names)
    is_back = [isinstance(one, BoardView) and int(one.index.min()) >= n for one in seen]
    for side, board in enumerate(shown):
        other = NotSeen("the other side")
        own = [
            other if isinstance(one, BoardView) and back != side else one
            for one, back in zip(seen, is_back, strict=True)
        ]
        require_counts(own, board, board_text(board))


def look_again(shown: Target | TwoSided, why: str) -> str:
    """Return what to do where no image of a camera shows it; why: of the first."""
    if "mirrored" in why:
        return (
            "Switch off the camera's mirror mode; a print that is itself mirrored, as of a back that is to fit its "
            "front, is not taken: print another board there, and give it as --back"
        )
    if isinstance(shown, TwoSided):
        return ". ".join(dict.fromkeys(map(count_again, shown)))
    return (
        count_again(shown) if shown.is_board else "Darken the room, shorten the exposure, and show four lights or more"
    )


def require_lenses(names: Sequence[str], lenses: Mapping[str, object], shown: Target | TwoSided) -> None:
    """Raise UsageError where lights are shown to cameras whose lens is not known."""
    unknown = [name for name in names if name not in lenses]
    if isinstance(shown, Target) and not shown.is_board and unknown:
        raise UsageError(
            f"the lens of {', '.join(unknown)} is not given",
            consequence="Lights that are waved place cameras, they do not calibrate lenses",
            cure=f"Give --lens {unknown[0]}=camera.yaml, from armsight calibrate camera; or show a board",
        )
