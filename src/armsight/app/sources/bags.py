"""Topics of ROS bags as sources of frames and of joint values."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Self

from armsight.drivers.sources import size_text
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame, Motion
from armsight.store import read_joints
from armsight.store.bags import COMPRESSED, IMAGE, JOINTS, BagTopic, JointStates, bag_origin_ns, bag_topic, is_bag


class BagFrames:
    """The images of a topic, with their headers' stamps. text: bag:FILE:/topic.

    origin_of: text of another topic whose bag's start is t_s = 0; None: its own. Opening raises as BagTopic does;
    reading raises Inconsistent at the first image of another size than the first one's.
    """

    def __init__(self, text: str, *, colour: bool = False, origin_of: str | None = None) -> None:
        self.name = text
        self._colour = colour
        self._origin_of = origin_of
        self._origin_ns: int | None = None
        self._topic: BagTopic | None = None

    @property
    def opened(self) -> bool:
        """Whether it is open."""
        return self._topic is not None

    @property
    def total(self) -> int | None:
        """How many images there are; None before it is opened."""
        return self._topic.count if self._topic else None

    def __enter__(self) -> Self:
        self._origin_ns = origin_ns(self._origin_of)
        self._topic = BagTopic(self.name, (IMAGE, COMPRESSED)).__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._topic is not None:
            self._topic.__exit__(*error)
            self._topic = None

    def __iter__(self) -> Iterator[Frame]:
        if self._topic is None:
            raise DeviceFailed(f"{self.name} is not open", consequence="There are no frames", cure="Open it first")
        shape: tuple[int, ...] | None = None
        for frame in self._topic.frames(colour=self._colour, origin_ns=self._origin_ns):
            shape = shape or frame.image.shape
            if frame.image.shape != shape:
                raise Inconsistent(
                    f"{frame.source} is {size_text(frame.image.shape)} px, those before it {size_text(shape)}",
                    consequence="Images of one camera must all be of one size, so reading stops here",
                    cure="Record each camera on a topic of its own",
                )
            yield frame


def origin_ns(text: str | None) -> int | None:
    """Return the start in ns of the bag that a text names; None for a text of another kind."""
    return bag_origin_ns(bag_topic(text)[0]) if text is not None and is_bag(text) else None


def joint_states(text: str, *, origin_of: str | None = None) -> JointStates:
    """Return the joint states of bag:FILE:/topic; origin_of: as of BagFrames. Raises as BagTopic does."""
    zero_ns = origin_ns(origin_of)
    with BagTopic(text, (JOINTS,)) as topic:
        return topic.joint_states(origin_ns=zero_ns)


def read_motion(path: Path, *, origin_of: str | None = None) -> Motion:
    """Return the joint values of a joints.csv or of bag:FILE:/topic, in the order they have there."""
    return (
        joint_states(str(path), origin_of=origin_of).motion if is_bag(str(path)) else read_joints(path, measured=True)
    )
