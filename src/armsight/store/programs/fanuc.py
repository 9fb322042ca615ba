"""FANUC: programs as text (.ls): /POS with P[n]{ GP1: UF, UT, CONFIG, X Y Z W P R, or J1 .. J6 }.

W, P, R turn about the fixed x, y, z: R = Rz(R) Ry(P) Rx(W). J3 is the forearm's angle against the horizontal, whatever
J2 is: the angle between upper arm and forearm is J3 + J2 (ros-industrial/fanuc #186, fanuc_experimental #17, where the
pendant shows J3 -33.342 deg and the joint turns to -2.018 deg with J2 at 31.324 deg). Further groups are other
machines; a track of the same group stands in E1. A position never taught is written as asterisks.
"""

from __future__ import annotations

import re
from decimal import Decimal

from armsight.errors import BadFile, Inconsistent
from armsight.store.programs.points import POINTS, Listed, Point, line_of, numbers, require_end, wrong_count

_OPENED = re.compile(r"^[ \t]*P\[(\d+)(?:\s*:\s*\"([^\"]*)\")?\]\s*\{", re.MULTILINE)
_GROUP = re.compile(r"GP(\d+)\s*:")
_FRAMES = re.compile(r"UF\s*:\s*(\w+)\s*,\s*UT\s*:\s*(\w+)")
_VALUE = re.compile(r"\b([XYZWPR]|[JE]\d)\s*=\s*([^\s,]+(?:,\d+)?)\s*(mm|deg)?")
_POSE = ("X", "Y", "Z", "W", "P", "R")


def ls_points(text: str, where: str) -> Listed:
    """Return the positions of a .ls, J3 as it stands there. Raises BadFile, Inconsistent."""
    found, untaught, others = Listed(where=where), [], set()
    for opened in _OPENED.finditer(text):
        end = text.find("};", opened.end())
        follow = _OPENED.search(text, opened.end())
        if end < 0 or (follow is not None and follow.start() < end):
            raise BadFile(
                f"{found.location(line_of(text, opened.start()))}: P[{opened[1]}] has no end", cure="Export it again"
            )
        groups = _groups(text[opened.end() : end])
        others |= set(groups) - {"1"}
        if "1" not in groups:
            continue
        name, line = f"P[{opened[1]}]", line_of(text, opened.start())
        if "*" in re.sub(r"\bUF.*?UT\s*:\s*\w+", "", groups["1"]):
            untaught.append(name)
            continue
        found.points.append(_point(found, line, name, groups["1"]))
    require_end(found, re.search(r"^/END\b", text, re.MULTILINE) is not None, "/END")
    if untaught:
        found.notes.append(f"never taught and not used: {', '.join(untaught)[:200]}")
    if others:
        found.notes.append(f"groups of axes that are other machines, not used: {', '.join(sorted(others))}")
    return found


def _groups(body: str) -> dict[str, str]:
    """Return the text of each group of a position; one without any is of the first."""
    parts = _GROUP.split(body)
    return dict(zip(parts[1::2], parts[2::2], strict=True)) if len(parts) > 1 else {"1": body}


def _point(found: Listed, line: int, name: str, body: str) -> Point:
    where = found.location(line)
    frames = _FRAMES.search(body)
    values: dict[str, str] = {}
    for key, cell, unit in _VALUE.findall(re.sub(r"CONFIG\s*:\s*'[^']*'", "", body)):
        if "," in cell:
            raise BadFile(f"{where}: {name} has the decimal comma {cell[:20]!r}", cure=POINTS)
        expected = "mm" if key in "XYZ" else "deg"
        if not key.startswith("E") and unit and unit != expected:
            raise Inconsistent(
                f"{where}: {key} of {name} is in {unit}",
                consequence=f"A value in {expected} is wanted there",
                cure="Give joint values of arms with sliding joints as a table of columns q1_deg, q2_mm ...",
            )
        values[key] = cell
    outer = numbers([values[key] for key in sorted(values) if key[0] == "E"], where, name)
    joints = [values[key] for key in sorted(values) if key[0] == "J"]
    if joints:
        if len(joints) != 6 or any(f"J{k}" not in values for k in range(1, 7)):
            raise wrong_count(len(joints), where, f"the joints of {name}", (6,))
        return Point(line=line, name=name, joints=numbers(joints, where, name), outer=outer)
    missing = [key for key in _POSE if key not in values]
    if missing:
        raise BadFile(f"{where}: {name} has no {', '.join(missing)}", cure="Export the program again: it may be cut")
    return Point(
        line=line,
        name=name,
        xyz=numbers([values[key] for key in "XYZ"], where, name),
        turn=numbers([values[key] for key in "WPR"], where, name),
        tool=f"UT {frames[2]}" if frames else "",
        frame=f"UF {frames[1]}" if frames else "",
        outer=outer,
    )


J3 = "J3 is against the horizontal: q3 is J3 + J2, the angle between the links"


def between_links(point: Point) -> Point:
    """Return a point whose third value is the angle between upper arm and forearm."""
    q = list(point.joints)
    q[2] = str(Decimal(q[2]) + Decimal(q[1]))
    return Point(line=point.line, name=point.name, joints=tuple(q), outer=point.outer)
