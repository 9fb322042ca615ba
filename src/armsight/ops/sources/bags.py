"""Topics of ROS bags as sources of frames and of joint values, whose joints are told by name."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self

from armsight.drivers import FileSource
from armsight.drivers.sources import size_text
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame, Motion
from armsight.store import read_joints
from armsight.store.bags import COMPRESSED, IMAGE, JOINTS, BagTopic, JointStates, bag_origin_ns, bag_topic, is_bag

UNIVERSAL_ROBOTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The names of ur_robot_driver, from the base on; all other makers' drivers count their joints."""


class BagFrames(FileSource):
    """The images of a topic, with their headers' stamps. text: bag:FILE:/topic.

    origin_of: text of another topic whose bag's start is t_s = 0; None: its own. Opening raises as BagTopic does;
    reading raises Inconsistent at the first image of another size than the first one's.
    """

    def __init__(self, text: str, *, colour: bool = False, origin_of: str | None = None) -> None:
        super().__init__(text)
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

    def _close(self) -> None:
        if self._topic is not None:
            self._topic.__exit__()
            self._topic = None

    def _frames(self) -> Iterator[Frame]:
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


def columns_of(wanted: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return where in a driver's names each of the arm's joints is: by its name, else in the order from the base on.

    That order is the one of Universal Robots' names, or of numbers: joint_1 .., panda_joint1 .., joint_a1 .., with any
    prefix; a gripper's joints beside them do not matter. Raises Inconsistent where neither tells.
    """
    if set(wanted) <= set(names):
        return [names.index(name) for name in wanted]
    orders = _orders(names, len(wanted))
    if _orders(wanted, len(wanted)) == [[*range(len(wanted))]] and len(orders) == 1:
        return orders[0]
    raise Inconsistent(
        f"the arm's joints are called {', '.join(wanted)}, the bag's {', '.join(names)}",
        consequence="Which value belongs to which joint is not known",
        cure="Give the joints in arm.yaml the names that the robot's driver publishes",
    )


def _orders(names: Sequence[str], n: int) -> list[list[int]]:
    """Return each way in which n of the names follow each other from the base on, as their places."""
    found = []
    for ur in {name.removesuffix(UNIVERSAL_ROBOTS[0]) for name in names if name.endswith(UNIVERSAL_ROBOTS[0])}:
        full = [f"{ur}{name}" for name in UNIVERSAL_ROBOTS]
        if n == len(full) and set(full) <= set(names):
            found.append([names.index(name) for name in full])
    counted: dict[tuple[str, str], dict[int, int]] = defaultdict(dict)
    for place, name in enumerate(names):
        if number := re.fullmatch(r"(.*?)(\d+)(\D*)", name):
            counted[number[1], number[3]][int(number[2])] = place
    whole = [one for one in counted.values() if sorted(one) in ([*range(n)], [*range(1, n + 1)])]
    return found + [[places[k] for k in sorted(places)] for places in whole]
