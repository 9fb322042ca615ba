"""Which of a driver's joints is which of an arm's, by their names."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from armsight.errors import Inconsistent

UNIVERSAL_ROBOTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The names of ur_robot_driver, from the base on; all other makers' drivers count their joints."""


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
