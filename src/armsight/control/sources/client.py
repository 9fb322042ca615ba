"""Set points that come over a network, each good for a short time."""

from __future__ import annotations

from armsight.control.setpoints import CycleState, Hold, SetPoint
from armsight.units import MS

LONGEST_S = 0.25
"""A set point older than this is followed no longer: a client that falls silent is a stop."""


class ClientSource:
    """Holds the newest set point of a client; whoever receives it calls post, from any thread."""

    name = "client"

    def __init__(self, longest_s: float = LONGEST_S) -> None:
        self._longest_s = longest_s
        self._posted: tuple[float, SetPoint] | None = None

    def post(self, wanted: SetPoint, t_s: float) -> None:
        """Take a set point that was received at t_s, on the loop's clock, in place of the one before."""
        self._posted = (t_s, wanted)

    def clear(self) -> None:
        """Forget the set point: the client is gone."""
        self._posted = None

    def next(self, now: CycleState) -> SetPoint:
        """Return the newest set point while it is fresh; else Hold, with why."""
        posted = self._posted
        if posted is None:
            return Hold()
        age_s = now.t_s - posted[0]
        if age_s > self._longest_s:
            return Hold(why=f"no set point from the client for more than {self._longest_s / MS:.0f} ms")
        return posted[1]
