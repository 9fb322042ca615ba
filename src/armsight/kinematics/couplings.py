"""How joints' own values follow a controller's readings: coupled readings, and joints that only follow others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.kinematics.joints import Joint

MOST_SHARE, MOST_FOLLOWED = 2.0, 1e3
"""Largest shares of couplings: of a joint's own reading and another's, and of a joint without a drive (rad per m)."""

FOLLOWED = 1e-3
"""Readings (rad or m) of a joint without a drive that miss what it follows by more are not its own: logs have three
digits and more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """A controller's reading that is not the joint's own: value of joint = its reading + share * reading of by.

    A joint without a drive has no reading to add; by may be one, and its value then takes the place of its reading.
    """

    joint: str
    by: str
    share: float = 1.0


def check_couplings(couplings: Sequence[Coupling], joints: Sequence[Joint]) -> None:
    """Raise Inconsistent where couplings name no joints, or one that does not come before, or are no drive's."""
    names = [joint.name for joint in joints]
    driven = {joint.name: joint.driven for joint in joints}
    for coupling in couplings:
        known = coupling.joint in names and coupling.by in names
        if not known or names.index(coupling.by) >= names.index(coupling.joint):
            raise Inconsistent(
                f"{coupling.joint} is coupled to {coupling.by}, which is no joint before it",
                consequence="Its readings cannot be turned into values",
                cure=f"Name joints in their order from the base: {', '.join(names)}",
            )
        if not abs(coupling.share) <= (MOST_SHARE if driven[coupling.joint] else MOST_FOLLOWED):  # also for NaN
            raise Inconsistent(
                f"{coupling.joint} is coupled to {coupling.by} by {coupling.share:g}",
                consequence="Its readings cannot be turned into values",
                cure="Give a share of about one, in rad per rad",
            )
    followers = {coupling.joint for coupling in couplings}
    for name in names:
        if not driven[name] and name not in followers:
            raise Inconsistent(
                f"joint {name} has no drive, and is coupled to no other joint",
                consequence="Its value is not known",
                cure="Name the joint that it follows under coupled, or leave driven out",
            )


def gearing(joints: Sequence[Joint], couplings: Sequence[Coupling]) -> Array:
    """Return (n, n): how the joints' values follow the controller's readings; zeros for one without a drive's own."""
    index = {joint.name: i for i, joint in enumerate(joints)}
    own = np.eye(len(joints))
    out = np.diag([float(joint.driven) for joint in joints])
    for coupling in sorted(couplings, key=lambda one: index[one.joint]):
        by = index[coupling.by]
        out[index[coupling.joint]] += coupling.share * (own[by] if joints[by].driven else out[by])
    return out


def gearing_back(joints: Sequence[Joint], couplings: Sequence[Coupling]) -> Array:
    """Return (n, n): how readings follow the joints' values; a joint without a drive reads its own value."""
    out = gearing(joints, couplings)
    for i, joint in enumerate(joints):
        if not joint.driven:
            out[i] = np.eye(len(joints))[i]
    return np.asarray(np.linalg.inv(out), dtype=np.float64)


def require_followed(joints: Sequence[Joint], couplings: Sequence[Coupling], readings: Array, values: Array) -> None:
    """Raise Inconsistent where what is given, (n,) or (m, n), for a joint without a drive is neither 0 nor follows."""
    for i, joint in enumerate(joints):
        given, off = readings[..., i], readings[..., i] - values[..., i]
        follows = np.ptp(off) <= FOLLOWED and (off.size > 1 or np.abs(off).max() <= FOLLOWED)
        if joint.driven or follows or np.abs(given).max() <= FOLLOWED:
            continue
        what = ", ".join(f"{one.by} by {one.share:g}" for one in couplings if one.joint == joint.name)
        raise Inconsistent(
            f"joint {joint.name} has no drive and follows {what}, and its readings do not",
            consequence="Where the arm stands cannot be told",
            cure=f"Give 0 for {joint.name}, or the value that it has; where it has a drive, make it driven: true and "
            "leave coupled out in the arm's file",
        )
