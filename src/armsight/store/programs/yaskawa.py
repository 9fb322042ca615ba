"""Yaskawa (Motoman): jobs (.JBI), //POS with C00000=... after ///POSTYPE, ///USER, ///TOOL, ///PULSE or ///RECTAN.

RECTAN: mm and Rx, Ry, Rz in degrees about the fixed x, y, z: R = Rz Ry Rx (DX100, easy offline teaching, 4.3.1: turned
in the order Rz, Ry, Rx). PULSE: encoder pulses from the zero position, S L U R B T; how many make a degree stands in
the controller's parameters and in no job. ANGLE: degrees. ///NPOS counts C, BC, EC, P, BP and EX.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from armsight.errors import BadFile, Inconsistent
from armsight.store.programs.points import Listed, Point, listed_numbers, numbers, require_end

COUNTED = ("C", "BC", "EC", "P", "BP", "EX")
"""Kinds of positions in the order of ///NPOS: of the arm, its track and other axes, and the same as variables."""
_POSITION = re.compile(rf"({'|'.join(sorted(COUNTED, key=len, reverse=True))})(\d+)\s*=\s*(.*)")
ANGLE = "angle"
"""The frame of joint values in degrees, where others are pulses."""
AXES = ("s", "l", "u", "r", "b", "t")
"""Names of a Motoman's axes, which head a table of pulses."""


def jbi_points(text: str, where: str) -> Listed:
    """Return the positions of a job; frame 'pulse' or 'angle' for joint values. Raises BadFile."""
    found, setting = Listed(where=where), {"TOOL": "", "USER": "", "POSTYPE": ""}
    counted: tuple[int, ...] = (0,) * 6
    read = dict.fromkeys(COUNTED, 0)
    outer: dict[str, list[str]] = {}
    body, inst, _ = text.partition("//INST")
    require_end(found, bool(inst), "//INST")
    for line, raw in enumerate(body.splitlines(), 1):
        row = raw.strip()
        word, _, value = row.removeprefix("///").partition(" ")
        position = _POSITION.fullmatch(row)
        if word.upper() in setting and row.startswith("///"):
            setting[word.upper()] = value.strip().upper()
        elif row.startswith("///NPOS"):
            counted = tuple(map(int, listed_numbers(value, found.location(line), "///NPOS", (6,))))
        elif row.startswith(("///PULSE", "///ANGLE", "///RECTAN")):
            _require_kind(found, line, setting["POSTYPE"], word.upper())
        elif position is not None:
            kind, number, cells = position.groups()
            read[kind] += 1
            if kind in ("C", "P"):
                found.points.append(_point(found, line, f"{kind}{number}", cells, setting))
            else:
                outer.setdefault(f"{'C' if kind[-1] == 'C' else 'P'}{number}", []).extend(cells.split(","))
    if tuple(read.values()) != counted:
        raise BadFile(
            f"{where}: ///NPOS counts {', '.join(map(str, counted))} positions {', '.join(COUNTED)}, and there are "
            f"{', '.join(map(str, read.values()))}",
            consequence="The job is cut, or was changed by hand",
            cure="Export it again, or correct ///NPOS",
        )
    found.points = [
        replace(point, outer=numbers(outer.get(point.name, ()), found.location(point.line), point.name))
        for point in found.points
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


def _point(found: Listed, line: int, name: str, cells: str, setting: Mapping[str, str]) -> Point:
    kind, where = setting["POSTYPE"], found.location(line)
    if not kind:
        raise BadFile(
            f"{where}: no ///POSTYPE stands before {name}",
            consequence="Whether it is in pulses or in mm is not known",
            cure="Export the job again",
        )
    if kind in ("PULSE", "ANGLE"):
        return Point(line=line, name=name, joints=listed_numbers(cells, where, name, (6,)), frame=kind.lower())
    values = found.values(line, name, cells, (6, 7), kind)  # the seventh is the elbow's angle
    frame = f"{kind} {setting['USER']}" if kind == "USER" else kind
    return Point(line=line, name=name, xyz=values[:3], turn=values[3:6], tool=f"TOOL {setting['TOOL']}", frame=frame)
