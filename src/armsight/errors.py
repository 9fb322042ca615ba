"""The one exception tree. Every message says cause, consequence and cure.

ArmsightError                     exit code 1
├── UsageError                    exit code 2   the call itself is wrong
├── DataRefused                   exit code 3   the data cannot carry the answer asked for
│   ├── BadFile                   a file that cannot be read, or that says something impossible
│   ├── BadImage                  an image that cannot be used
│   ├── NotEnoughData             too few views, spots, readings
│   ├── Degenerate                the data leave some direction of the answer open
│   │   └── Undetermined          ... and these are the parameters that cannot be told apart
│   ├── Ambiguous                 two answers fit, neither may be guessed
│   ├── Inconsistent              the inputs contradict each other (sizes, units, swapped views)
│   └── NotConverged              the solver stopped before it had an answer
├── DeviceFailed                  exit code 4   camera, link, disk or robot
│   ├── DeviceNotFound            no such camera or robot
│   ├── DeviceLost                it was there and is gone
│   ├── RecordingFailed           exit code 5   all went on, and the disk took no more of its recording
│   └── StaleData                 it answers, with old data
└── Cancelled                     exit code 130 the person stopped it
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import ClassVar


class ArmsightError(Exception):
    """Root of every error that armsight raises on purpose.

    cause: what is wrong, with the place (file, row, key, image).
    consequence: what does not happen because of it.
    cure: what the person can do.
    kept: the result of what was done until then, which an action writes all the same; None where nothing was.
    """

    exit_code: ClassVar[int] = 1
    usual: ClassVar[str] = ""
    """The consequence of an error that says none."""
    kept: object = None

    def __init__(self, cause: str, *, consequence: str = "", cure: str = "") -> None:
        self.cause = cause
        self.consequence = consequence or self.usual
        self.cure = cure
        super().__init__(cause)

    def __str__(self) -> str:
        return " ".join(_sentence(part) for part in (self.cause, self.consequence, self.cure) if part)

    def __reduce__(self) -> tuple[object, ...]:
        return (rebuilt, (type(self), self.cause, self.consequence, self.cure), self.__dict__)


@contextmanager
def leads_to(consequence: str) -> Iterator[None]:
    """Give the errors raised within that say no consequence this one."""
    try:
        yield
    except ArmsightError as error:
        error.consequence = error.consequence or consequence
        raise


def _sentence(text: str) -> str:
    text = text.strip()
    return text if text.endswith((".", "!", "?")) else text + "."


def rebuilt(kind: type[ArmsightError], cause: str, consequence: str, cure: str) -> ArmsightError:
    """Unpickle an error that crossed a process border, whatever its constructor."""
    error = kind.__new__(kind)
    ArmsightError.__init__(error, cause, consequence=consequence, cure=cure)
    return error


class UsageError(ArmsightError):
    """The call itself is wrong."""

    exit_code = 2
    usual = "Nothing was done"


def not_one_of(name: str, value: object, words: Iterable[str]) -> UsageError:
    """Return the error of a value that is none of the words."""
    return UsageError(f"{name} is {value!r}, which is not known", cure=f"Use one of: {', '.join(words)}")


class DataRefused(ArmsightError):
    """The data cannot carry the answer asked for."""

    exit_code = 3


class BadFile(DataRefused):
    """A file that cannot be read, or that says something impossible."""

    usual = "The file is not used"


class Unseen(StrEnum):
    """What kept a board or a target from being seen, or its pose from being taken: the kinds that files count."""

    OTHER = "other"
    BLURRED = "blurred"
    IN_PART = "in_part"
    """The board is there in part, or half out of the image."""
    BEYOND_SIZE = "beyond_size"
    """Corners go on beyond the board's in an image of two views."""
    ONLY_ONCE = "only_once"
    """The board is there in one view of two."""
    THRICE = "thrice"
    """It is there more than once in each view."""
    NO_SPOT = "no_spot"
    DARK_PATH = "dark_path"
    """There are spots, but none of both views."""
    AMBIGUOUS = "ambiguous"
    OVERLAPPING = "overlapping"
    """A spot of one view may lie on one of the other's."""
    LIGHTS_MISSING = "lights_missing"
    UNREADABLE = "unreadable"
    """The image cannot be read."""
    NO_BOARD = "no_board"
    CROWD = "crowd"
    """So much is bright that which of it is the target would be chance."""
    DEADLINE = "deadline"
    """More is bright than can be looked at in the time that a live picture has."""
    UNPAIRED = "unpaired"
    """No spot of one view belongs to one of the other."""
    SWAPPED = "swapped"
    """Left and right look exchanged."""
    WRONG_TARGET = "wrong_target"
    """Lights are seen whose size, distance or order is not the target's."""
    MISFIT = "misfit"
    """The spots do not fit the target, the calibration or the moment."""
    ONE_OFF = "one_off"
    """One of the spots is off, and it is not clear which."""
    ROTATION_OPEN = "rotation_open"
    """The spots leave the rotation open."""
    SMALL_TARGET = "small_target"
    """A target of one or two lights has no rotation."""
    NO_POINT = "no_point"
    """The spots give no place before the cameras."""
    HALF_HIDDEN = "half_hidden"
    """Something covers a part of a light."""
    MOTION = "motion"
    """The lights are not where the target's motion puts them."""
    GAP = "gap"
    """No view for too long, with cameras that run free."""
    BEYOND_CLAIMS = "beyond_claims"
    """There is a pose, and its residuals are far beyond what the spots claim."""
    INCONSISTENT = "inconsistent"
    """There is a pose, and the whole run says that rig or target are wrong."""


class BadImage(DataRefused):
    """An image that cannot be used.

    unseen: what kept the board from being seen. size: larger and smaller count of the points of the board that is seen
    in its place.
    """

    def __init__(
        self,
        cause: str,
        *,
        consequence: str = "",
        cure: str = "",
        unseen: Unseen = Unseen.OTHER,
        size: tuple[int, int] | None = None,
    ) -> None:
        self.unseen = unseen
        self.size = size
        super().__init__(cause, consequence=consequence, cure=cure)


def unused_image(
    cause: str,
    *,
    cure: str = "Show the whole board, sharp and evenly lit, and count its inner corners",
    unseen: Unseen = Unseen.OTHER,
    size: tuple[int, int] | None = None,
) -> BadImage:
    """Return the error of an image that is not used, such as one of a board."""
    return BadImage(cause, consequence="The image is not used", cure=cure, unseen=unseen, size=size)


class NotEnoughData(DataRefused):
    """Too few views, spots or readings."""


class Degenerate(DataRefused):
    """The data leave some direction of the answer open."""


class Undetermined(Degenerate):
    """Parameters that the data cannot tell apart, in groups by name."""

    def __init__(self, groups: Iterable[Sequence[str]], *, consequence: str = "", cure: str = "") -> None:
        self.groups = tuple(tuple(group) for group in groups)
        text = "; ".join(", ".join(group) for group in self.groups)
        super().__init__(
            f"the data cannot tell these parameters apart: {text}",
            consequence=consequence or "No value is given for any of them",
            cure=cure or "Add data that move them independently, or fix one of each group",
        )


class Ambiguous(DataRefused):
    """Two answers fit; neither may be guessed."""


class Inconsistent(DataRefused):
    """The inputs contradict each other."""


class NotConverged(DataRefused):
    """The solver stopped before it had an answer."""


class DeviceFailed(ArmsightError):
    """Camera, link, disk or robot failed."""

    exit_code = 4


class DeviceNotFound(DeviceFailed):
    """No such camera or robot."""


class DeviceLost(DeviceFailed):
    """It was there and is gone."""


class RecordingFailed(DeviceFailed):
    """All went on, and the disk took no more of its recording: what was done is not to be read there."""

    exit_code = 5


class StaleData(DeviceFailed):
    """The device answers, but with old data."""


class Cancelled(ArmsightError):
    """The person stopped the work."""

    exit_code = 130
