"""Elements of a URDF that several others have: numbers, origins, masses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadFile
from armsight.store.interpret import looks_like_degrees, looks_like_mm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mass:
    """What a link weighs, and its centre of mass (3,) in the link's frame."""

    kg: float
    com_m: Array


def masses(root: ElementTree.Element, where: str) -> Mapping[str, Mass]:
    """Return the masses of the links that have one, by the link's name; BadFile where one is no mass."""
    found = {}
    for link in root.findall("link"):
        inertial = link.find("inertial")
        mass = None if inertial is None else inertial.find("mass")
        if inertial is None or mass is None:
            continue
        at = f"{where}: link {link.get('name')}: its inertial"
        kg = float(numbers(mass.get("value"), "", 1, f"{at}: mass")[0])
        if kg < 0.0:
            raise BadFile(f"{at}: mass is {kg:g} kg", consequence="How the arm sags under its weight is not known")
        found[str(link.get("name"))] = Mass(kg=kg, com_m=origin_of(inertial, at)[:3, 3])
    return found


def together(parts: Sequence[tuple[Array, Mass]]) -> Mass:
    """Return several masses as one, each with the place (4, 4) of its link."""
    kg = sum(mass.kg for _, mass in parts)
    if not kg > 0.0:
        return Mass(kg=0.0, com_m=np.zeros(3))
    moment = sum((mass.kg * (T[:3, :3] @ mass.com_m + T[:3, 3]) for T, mass in parts), np.zeros(3))
    return Mass(kg=kg, com_m=moment / kg)


def origin_of(element: ElementTree.Element, at: str) -> Array:
    """Return the (4, 4) matrix of an element's origin; the identity where it has none."""
    origin = element.find("origin")
    xyz = numbers(origin.get("xyz") if origin is not None else None, "0 0 0", 3, f"{at}: origin xyz")
    rpy = numbers(origin.get("rpy") if origin is not None else None, "0 0 0", 3, f"{at}: origin rpy")
    if looks_like_degrees(rpy) or looks_like_mm(xyz):
        what, unit = ("rpy", "degrees") if looks_like_degrees(rpy) else ("xyz", "millimetres")
        raise BadFile(
            f"{at}: origin {what} looks like {unit}",
            consequence="Taken as URDF means it the arm would be another",
            cure="Write metres and radians",
        )
    return matrix(xyz, rpy)


def numbers(text: str | None, default: str, count: int, what: str) -> Array:
    """Return so many finite numbers from an attribute."""
    try:
        values = np.array([float(part) for part in (text if text is not None else default).split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise BadFile(f"{what} is {str(text)[:40]!r}, not {count} finite numbers", consequence="The file is not used")
    return values


def matrix(xyz: Array, rpy: Array) -> Array:
    """Return the (4, 4) matrix of an origin: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = xyz
    return T
