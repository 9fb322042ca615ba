"""What a browser may say to the console: one strict model for each message; all else is refused in words."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from armsight.control.session.operator_session import Push
from armsight.drivers.remote.protocol import MAX_JOINTS
from armsight.errors import UsageError

LONGEST = 2000
"""Characters of a message; ours have a tenth."""
LARGEST_PX = 1e5
"""Farthest corner of a rectangle drawn on a picture: ten times the widest camera."""
BROWSER = r"^[0-9A-Za-z_-]{1,64}$"
"""A browser's name: the identifier of a page's connection."""

Seconds = Annotated[float, Field(ge=-1e12, le=1e12, allow_inf_nan=False)]
"""A time on the loop's clock; a machine that was on for 30 years has 1e9."""
Pixel = Annotated[float, Field(ge=-LARGEST_PX, le=LARGEST_PX, allow_inf_nan=False)]


class _Said(BaseModel):
    """No key more, no type but the one that is written: "1" is no number and 1 is no truth."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class JogKey(_Said):
    """A jog key that is held; axis from 0: the joint, or x y z rx ry rz."""

    frame: Literal["joints", "base", "tool"]
    axis: int = Field(ge=0, lt=MAX_JOINTS)
    sense: Literal["-1", "1"]  # as text, since true is the number 1 to a literal

    def held(self) -> Push:
        """Return the key as the session takes it."""
        return Push(frame=self.frame, axis=self.axis, sense=float(self.sense))


class Beat(_Said):
    """The page is alive. enable: whether its button is held; seen: t of the newest state that it had, None of none.

    number: of the beat, which the page says on the line for stops as well; one that was overtaken does not count.
    """

    do: Literal["beat"]
    enable: bool
    push: JogKey | None = None
    seen: Seconds | None = None
    number: int | None = Field(None, ge=1, lt=2**53)


class Stop(_Said):
    """Stop the robot."""

    do: Literal["stop"]


class Reset(_Said):
    """Release the stop."""

    do: Literal["reset"]


class Override(_Said):
    """Another share of every speed."""

    do: Literal["override"]
    share: float = Field(ge=0.0, le=1.0)


class Drawn(_Said):
    """A rectangle drawn on a picture: corners u0, v0, u1, v1 in px, in which nothing is looked for."""

    side: str = Field(max_length=16)
    mask: tuple[Pixel, Pixel, Pixel, Pixel] = Field(strict=False)


RobotMessage = Beat | Stop | Reset | Override
"""What a page may say of the robot."""

_ROBOT: TypeAdapter[RobotMessage] = TypeAdapter(Annotated[RobotMessage, Field(discriminator="do")])
_DRAWN: TypeAdapter[Drawn] = TypeAdapter(Drawn)
Model = TypeVar("Model")


def robot_message(text: str | None) -> RobotMessage:
    """Return what a page says of the robot; None stands for bytes, which it never sends. Raises UsageError."""
    if text is None:
        raise _refused("it is no text")
    if len(text) > LONGEST:
        raise _refused(f"it is longer than {LONGEST} characters")
    try:
        said = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise _refused(str(error)) from None
    return _validated(_ROBOT, said)


def drawn(said: Any) -> Drawn:
    """Return the rectangle that a page tells of. Raises UsageError."""
    return _validated(_DRAWN, said)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object's content. Raises ValueError for a key that stands twice: which is meant is not known."""
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _validated(adapter: TypeAdapter[Model], said: Any) -> Model:
    try:
        return adapter.validate_python(said)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise _refused(f"{where}: {first['msg']}" if where else first["msg"]) from None


def _refused(why: str) -> UsageError:
    return UsageError(
        f"the page said what is no message: {why}"[:300], consequence="Nothing was done", cure="Load the page anew"
    )
