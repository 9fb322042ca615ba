"""The contract of every source of frames and of pairs of frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Any

import numpy as np

from armsight.drivers import FrameSource, MomentSource
from armsight.errors import ArmsightError
from armsight.records import Frame
from armsight.testing.checks import check

SEEN = 8
"""Frames that are looked at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCase:
    """A source not yet opened.

    opened: tells whether the device behind it is open; None where the test cannot know. moves: whether every frame is
    known to differ from the one before (a noisy or moving picture), so that a frozen camera shows. again: whether it
    may be opened a second time and then begins anew.
    """

    source: FrameSource | MomentSource
    opened: Callable[[], bool] | None = None
    moves: bool = False
    again: bool = True


class CameraContract:
    """Subclass it in a test file as Test..., and return a new case from make(); pytest then runs every test."""

    def make(self) -> CameraCase:
        """Return a new source, not opened, of SEEN frames or more."""
        raise NotImplementedError("return a CameraCase from make()")

    def test_the_constructor_opens_nothing(self) -> None:
        """The device is open only within `with`."""
        case = self.make()
        check(bool(case.source.name), "it has a name")
        if case.opened is None:
            return
        check(not case.opened(), "the constructor opens nothing")
        with case.source:
            check(case.opened(), "`with` opens it")
        check(not case.opened(), "leaving `with` closes it")

    def test_frames_carry_time_number_and_source(self) -> None:
        """Times and numbers increase, every frame names its source, exposures are times."""
        views = _read(self.make().source, SEEN)
        check(all(len(frames) >= 2 for frames in views), "it yields two frames at least")
        for frames in views:
            for frame in frames:
                check(bool(frame.source), "every frame names its source")
                check(bool(np.isfinite(frame.t_s)), "every frame has a time")
                check(bool(frame.exposure_s >= 0.0), "an exposure is not negative")
            for before, after in pairwise(frames):
                check(after.t_s > before.t_s, "the time of frames increases")
                check(after.sequence > before.sequence, "the number of frames increases")

    def test_numbers_begin_at_zero(self) -> None:
        """The first frame is number 0."""
        check(all(frames[0].sequence == 0 for frames in _read(self.make().source, 1)), "the first frame is number 0")

    def test_all_frames_are_of_one_shape(self) -> None:
        """A camera does not change the size or the colours of its images."""
        for frames in _read(self.make().source, SEEN):
            check(len({frame.image.shape for frame in frames}) == 1, "all frames of a camera are of one shape")

    def test_a_frame_is_not_written_over(self) -> None:
        """A frame keeps its image when the next ones come, and nobody can write on it."""
        with self.make().source as source, closing(iter(source)) as items:  # type: ignore[type-var]  # generators
            first = _frames(next(items))
            kept = [frame.image.copy() for frame in first]
            for _ in islice(items, SEEN - 1):
                pass
            for frame, image in zip(first, kept, strict=True):
                check(bool((frame.image == image).all()), "a frame keeps its image when the next ones come")
                check(not frame.image.flags.writeable, "an image cannot be written on")

    def test_the_picture_is_not_frozen(self) -> None:
        """Where the scene is known to change, so do the frames."""
        case = self.make()
        if not case.moves:
            return
        for frames in _read(case.source, SEEN):
            for before, after in pairwise(frames):
                check(not np.array_equal(before.image, after.image), "the picture changes when the scene does")

    def test_reading_may_stop_half_way(self) -> None:
        """A reader may leave in the middle; the source closes without complaint, and closing twice is legal."""
        case = self.make()
        with case.source as source:
            next(iter(source))
        case.source.__exit__(None, None, None)
        if case.opened is not None:
            check(not case.opened(), "a source left half way is closed")

    def test_it_can_be_read_again(self) -> None:
        """Opened again, it begins anew, where it is not live."""
        case = self.make()
        if not case.again:
            return
        first, second = _read(case.source, 3), _read(case.source, 3)
        for one, two in zip(first, second, strict=True):
            check([frame.t_s for frame in one] == [frame.t_s for frame in two], "opened again it begins anew")
            same = all(np.array_equal(a.image, b.image) for a, b in zip(one, two, strict=True))
            check(same, "opened again it yields the same images")

    def test_the_total_is_right(self) -> None:
        """Where it says how many frames there will be, so many come."""
        case = self.make()
        with case.source as source:
            total = source.total
            if total is None or total > 20 * SEEN:
                return
            try:
                count = sum(1 for _ in source)
            except ArmsightError as error:
                raise AssertionError(f"the driver breaks its contract: it fails before its end: {error}") from error
        check(count == total, f"it says {total} frames and yields {count}")


def _frames(item: Any) -> tuple[Frame, ...]:
    """Return the frames of one step: one of a camera, two of a pair."""
    return (item,) if isinstance(item, Frame) else tuple(item)


def _read(source: FrameSource | MomentSource, count: int) -> Sequence[tuple[Frame, ...]]:
    """Return up to count frames of each view of a source."""
    with source as opened:
        items = [_frames(item) for item in islice(iter(opened), count)]
    check(bool(items), "it yields a frame at least")
    return list(zip(*items, strict=True))
