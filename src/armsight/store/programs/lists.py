"""Kawasaki, Staubli, Epson: files that list points.

Kawasaki AS: .TRANS 'p1 X Y Z O A T', O, A, T about z, the new y, the new z; .JOINTS '#p1 JT1 ... JT6', mm and degrees
(AS language reference manual: transformation values, joint displacement values). Staubli VAL 3: .dtx, <Data
type="pointRx"> with <Value x y z rx ry rz fatherId>, about x, the new y, the new z (VAL 3 reference manual: trsf); an
attribute that is not there is 0 (RoboDK's Staubli_VAL3_simplified writes j3 and j5 alone); VAL 3 s6: <point> with
<pFather name> and <tpValue x y z rx ry rz>, <joint> with <jointValue j1 ..>, all of them (two public projects; RoboDK's
Staubli_VAL3). Epson RC+: .pts, Point1 { rX rY rZ rU rV rW nLocal }; sources contradict each other on the order of U, V,
W, so it is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree import ElementTree

from armsight.errors import BadFile
from armsight.store.programs.points import (
    Listed,
    Point,
    line_of,
    listed_numbers,
    numbers,
    require_end,
)

_BLOCK = re.compile(r"^\.(?P<kind>\w+)", re.MULTILINE)


def as_points(text: str, where: str) -> Listed:
    """Return the points of .TRANS and .JOINTS blocks. Raises BadFile."""
    found, kind = Listed(where=where), ""
    ended = True
    for line, raw in enumerate(text.splitlines(), 1):
        row = raw.strip()
        if row.startswith("."):
            kind = row[1:].split(None, 1)[0].split("(", 1)[0].upper() if row[1:].strip() else ""
            if kind in ("TRANS", "JOINTS"):
                require_end(found, ended, ".END")
                ended = False
            elif kind == "END":
                ended = True
        elif kind in ("TRANS", "JOINTS") and row:
            name, *cells = row.split()
            if any("," in cell for cell in cells):
                raise BadFile(f"{found.location(line)}: {name} has commas", cure="Write numbers apart by blanks")
            values = found.values(line, name, ",".join(cells), range(6, 13), kind)
            joints = kind == "JOINTS"
            found.points.append(
                Point(line=line, name=name, joints=values[:6], outer=values[6:])
                if joints
                else Point(line=line, name=name, xyz=values[:3], turn=values[3:6], outer=values[6:])
            )
    require_end(found, ended, ".END")
    if any(not point.joints for point in found.points):
        found.notes.append(".TRANS may hold tools, frames and shifts beside points: leave in the file what are points")
    return found


_VALUE = re.compile(r"<(?:Value|tpValue|jointValue)\b[^>]*>")
_JOINTS = tuple(f"j{k}" for k in range(1, 7))
_POSE = ("x", "y", "z", "rx", "ry", "rz")
_S6 = {"point": "tpValue", "joint": "jointValue"}


def dtx_points(text: str, where: str) -> Listed:
    """Return the points and joint values of a VAL 3 data file. Raises BadFile."""
    found = Listed(where=where)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadFile(f"{where}: declares a document type, which no controller writes", cure="Remove that part")
    try:
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError) as error:
        raise BadFile(
            f"{where}: is no complete XML: {error}", cure="Export the application again: it may be cut"
        ) from None
    order = iter([line_of(text, match.start()) for match in _VALUE.finditer(text)])
    for owner in root.iter():
        kind = owner.get("type", "") if _tag(owner) == "Data" else _tag(owner)
        for key, value, frame, absent in _values(owner):
            line = next(order, 0)
            name = f"{owner.get('name', '')}[{key}]"
            if kind in ("jointRx", "joint"):
                cells = numbers([value.get(key, absent) for key in _JOINTS], found.location(line), name)
                found.points.append(Point(line=line, name=name, joints=cells))
            elif kind in ("pointRx", "point"):
                cells = numbers([value.get(key, absent) for key in _POSE], found.location(line), name)
                found.points.append(Point(line=line, name=name, xyz=cells[:3], turn=cells[3:], frame=frame))
    if any(not point.joints for point in found.points):
        found.notes.append("lengths are taken as mm: that a project is in inches, its .pjx alone says")
    return found


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _values(owner: ElementTree.Element) -> Iterator[tuple[str, ElementTree.Element, str, str]]:
    """Yield the values of a variable: index, element, frame, and what an attribute is that is not there."""
    if _tag(owner) == "Data":
        for value in owner:
            if _tag(value) == "Value":
                yield value.get("key", ""), value, value.get("fatherId", ""), "0"
    elif _tag(owner) in _S6:
        frame = next((one.get("name", "") for one in owner if _tag(one) == "pFather"), "")
        for indexed in owner:
            for value in indexed:
                if _tag(value) == _S6[_tag(owner)]:
                    yield indexed.get("index", ""), value, frame, ""


_PTS = re.compile(r"^[ \t]*Point\d+\s*\{(?P<body>[^{}]*)(?P<end>\})?", re.MULTILINE)


def pts_points(text: str, where: str) -> Listed:
    """Return the points of an Epson point file. Raises BadFile."""
    found = Listed(where=where)
    blocks = list(_PTS.finditer(text))
    for block in blocks:
        line = line_of(text, block.start("body"))
        if block["end"] is None:
            raise BadFile(f"{found.location(line)}: a point has no end", cure="Export the file again: it is cut")
        pairs = [row.partition("=") for row in block["body"].splitlines() if "=" in row]
        values = {key.strip(): cell.strip() for key, _, cell in pairs}
        if values.get("nUndefined", "0") != "0":
            continue
        name = values.get("sLabel", "").strip('"') or f"P{values.get('nNumber', '?')}"
        keys = [key for key in ("rX", "rY", "rZ", "rU", "rV", "rW") if key in values]
        cells = listed_numbers(",".join(values[key] for key in keys), found.location(line), name, (6,))
        frame = f"Local {values.get('nLocal', '0')}"
        found.points.append(Point(line=line, name=name, xyz=cells[:3], turn=cells[3:], frame=frame))
    counted = re.search(r"^[ \t]*nNumberOfPoints\s*=\s*(\d+)", text, re.MULTILINE)
    if counted is not None and int(counted[1]) != len(blocks):
        raise BadFile(
            f"{where}: nNumberOfPoints is {counted[1]}, and there are {len(blocks)}",
            consequence="The file is cut, or was changed by hand",
            cure="Export it again, or correct nNumberOfPoints",
        )
    return found
