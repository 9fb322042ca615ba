"""Yaskawa (Motoman): jobs (.JBI), //POS with C00000=... after ///POSTYPE, ///USER, ///TOOL, ///PULSE or ///RECTAN.

RECTAN: mm and Rx, Ry, Rz in degrees about the fixed x, y, z: R = Rz Ry Rx (DX100, easy offline teaching, 4.3.1: turned
in the order Rz, Ry, Rx). PULSE: encoder pulses from the zero position, S L U R B T; how many make a degree stands in
the controller's parameters and in no job. ANGLE: degrees. ///NPOS counts C, BC, EC, P, BP and EX.
"""

from __future__ import annotations

import re
from dataclasses import replace

from armsight.errors import BadFile, Inconsistent
from armsight.store.programs.points import Listed, Point, listed_numbers, require_end

_POSITION = re.compile(r"(B|E)?(C|P|X)(\d+)\s*=\s*(.*)")
PULSE = "pulse"
"""The frame of a point in pulses."""
ANGLE = "angle"
AXES = ("s", "l", "u", "r", "b", "t")
"""Names of a Motoman's axes, which head a table of pulses."""


def jbi_points(text: str, where: str) -> Listed:
    """Return the positions of a job; frame 'pulse' or 'angle' for joint values. Raises BadFile."""
    found = Listed(where=where)
    tool, user, kind, counted, outer, read = "", "", "", [0] * 6, {}, [0] * 6
    for line, raw in enumerate(text.splitlines(), 1):
        row = raw.strip()
        if row.startswith("//INST"):
            break
        word, _, value = row.lstrip("/").partition(" ")
        if row.startswith("///NPOS"):
            counted = [int(cell) for cell in listed_numbers(value, found.location(line), "///NPOS", (6,))]
        elif row.startswith("///TOOL"):
            tool = f"TOOL {value.strip()}"
        elif row.startswith("///USER"):
            user = f" {value.strip()}"
        elif row.startswith("///POSTYPE"):
            kind = value.strip().upper()
        elif row.startswith(("///PULSE", "///ANGLE", "///RECTAN")):
            _require_kind(found, line, kind, word.upper())
        elif (match := _POSITION.fullmatch(row)) is not None:
            read[("C", "BC", "EC", "P", "BP", "EX").index(f"{match[1] or ''}{match[2]}")] += 1
            if match[1]:
                outer.setdefault(f"{'C' if match[2] == 'C' else 'P'}{match[3]}", []).extend(match[4].split(","))
                continue
            found.points.append(_point(found, line, f"{match[2]}{match[3]}", match[4], (kind, user, tool)))
    require_end(found, "//INST" in text, "//INST")
    if read != counted:
        raise BadFile(
            f"{where}: ///NPOS counts {counted[0]} positions C and {counted[3]} P, and there are {read[0]} and {read[3]}",
            consequence="The job is cut, or was changed by hand",
            cure="Export it again, or correct ///NPOS",
        )
    found.points = [
        replace(point, outer=tuple(cell.strip() for cell in outer.get(point.name, ()))) for point in found.points
    ]
    return found


def _require_kind(found: Listed, line: int, kind: str, word: str) -> None:
    """Raise Inconsistent where ///POSTYPE and what follows it are of two kinds."""
    if word != (kind if kind in ("PULSE", "ANGLE") else "RECTAN"):
        raise Inconsistent(
            f"{found.location(line)}: ///{word} under ///POSTYPE {kind or 'none'}",
            consequence="What the numbers are is not known",
            cure="Export the job again",
        )


def _point(found: Listed, line: int, name: str, cells: str, setting: tuple[str, str, str]) -> Point:
    kind, user, tool = setting
    if not kind:
        raise BadFile(
            f"{found.location(line)}: no ///POSTYPE stands before {name}",
            consequence="Whether it is in pulses or in mm is not known",
            cure="Export the job again",
        )
    values = listed_numbers(cells, found.location(line), name, (6,))
    if kind in ("PULSE", "ANGLE"):
        return Point(line=line, name=name, joints=values, frame=PULSE if kind == "PULSE" else ANGLE)
    frame = f"{kind}{user if kind == 'USER' else ''}"
    return Point(line=line, name=name, xyz=values[:3], turn=values[3:], tool=tool, frame=frame)
