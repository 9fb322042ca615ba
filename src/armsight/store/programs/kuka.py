"""KUKA: KRL (.src, .dat) and what RSI sends (XML, or its elements as columns).

KRL: positions in mm, A about z, B about the new y, C about the new x, in degrees; axes A1..A6 in degrees (KUKA System
Software, operating and programming instructions: data types FRAME, POS, E6POS, AXIS, E6AXIS). A point XP1 has its tool
and base in FP1 (FDAT: TOOL_NO, BASE_NO; IPO_FRAME #TCP: the tool stands outside and the part moves). RSI: RIst the
pose that is, RSol the one asked for, AIPos and ASPos the axes (RobotSensorInterface manual); IPOC counts ms.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from armsight.errors import BadFile, Inconsistent
from armsight.store.interpret.raw import RawTable, parse_text
from armsight.store.programs.points import Listed, Point, numbers, require_end

_DECLARED = re.compile(
    r"(?:(?:GLOBAL|CONST)\s+)*DECL\s+(?:GLOBAL\s+)?(?:CONST\s+)?(?P<type>\w+)\s+(?P<name>\w+(?:\[\d+\])?)\s*=\s*"
    r"(?P<body>\{[^{}]*\})|(?P<short>\w+)\s+(?P<name2>\w+)\s*=\s*(?P<body2>\{[^{}]*\})",
    re.IGNORECASE,
)
_ASSIGNED = re.compile(r"(?P<name>[$\w]+(?:\[\d+\])?)\s*=\s*(?P<value>.+?)\s*$")
_MOVED = re.compile(r"S?(?P<how>PTP|LIN|CIRC|SPL)(?P<relative>_REL)?\s+(?P<rest>.*\{.*)", re.IGNORECASE)
_POSE, _AXES = ("X", "Y", "Z", "A", "B", "C"), tuple(f"A{k}" for k in range(1, 7))
_OUTER = tuple(f"E{k}" for k in range(1, 7))
POSITIONS = ("POS", "E6POS", "AXIS", "E6AXIS")


def krl_points(text: str, where: str) -> Listed:
    """Return the positions of a .src or .dat. Raises BadFile, Inconsistent."""
    found, settings, flange = Listed(where=where), {"$TOOL": "", "$BASE": ""}, {}
    skipped = 0
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        code = line.split(";", 1)[0].strip()
        declared = _DECLARED.fullmatch(code)
        moved = _MOVED.match(code)
        if declared is not None:
            kind = (declared["type"] or declared["short"]).upper()
            name, body = declared["name"] or declared["name2"], declared["body"] or declared["body2"]
            if kind == "FDAT":
                flange[f"X{name[1:]}".upper()] = _words(body)
            elif kind in POSITIONS:
                found.points.append(_point(found, number, name, body, settings))
        elif moved is not None:
            if moved["relative"]:
                skipped += 1
                continue
            for k, body in enumerate(re.findall(r"\{[^{}]*\}?", moved["rest"])):
                found.points.append(_point(found, number, f"line {number}{'ab'[k] if k else ''}", body, settings))
        elif (assigned := _ASSIGNED.fullmatch(code)) is not None and assigned["name"].upper() in settings:
            settings[assigned["name"].upper()] = assigned["value"].upper()
    _require_ends(found, lines)
    if skipped:
        found.notes.append(f"{skipped} relative motions are not used: where they begin the program does not say")
    found.points = [_with_flange(found, point, flange.get(point.name.upper())) for point in found.points]
    return found


def _require_ends(found: Listed, lines: list[str]) -> None:
    first = [line.split(";", 1)[0].split() for line in lines]
    words = [line[0].upper() for line in first if line]
    for head, end in (("DEFDAT", "ENDDAT"), ("DEF", "END"), ("DEFFCT", "ENDFCT")):
        if head in words:
            require_end(found, words.count(end) >= words.count(head), end)


def _components(found: Listed, line: int, body: str) -> dict[str, str]:
    """Return the numbers of '{X 1,Y 2,S 2}' by name; S and T too."""
    where = found.location(line)
    if not body.endswith("}"):
        raise BadFile(f"{where}: the position has no closing bracket", cure="Export the program again: it is cut")
    out = {}
    for part in re.sub(r"^\{\s*(?:\w+\s*:)?", "", body).rstrip("}").split(","):
        words = part.split()
        if len(words) != 2:
            raise BadFile(
                f"{where}: {part.strip()[:20]!r} is no name and number; decimal commas make two of one",
                consequence="The position is not known",
                cure="Write numbers with a decimal point: X 513.8",
            )
        if words[0].upper() in out:
            raise BadFile(f"{where}: {words[0][:10]} stands twice in one position")
        out[words[0].upper()] = numbers(words[1:], where, "the position")[0]
    return out


def _point(found: Listed, line: int, name: str, body: str, settings: Mapping[str, str]) -> Point:
    values = _components(found, line, body)
    outer = tuple(values[key] for key in _OUTER if key in values)
    if set(_AXES) <= set(values):
        return Point(line=line, name=name, joints=tuple(values[key] for key in _AXES), outer=outer)
    missing = [key for key in (_AXES if "A1" in values or "A2" in values else _POSE) if key not in values]
    if missing:
        raise Inconsistent(
            f"{found.location(line)}: the position of {name} has no {', '.join(missing)}",
            consequence="What is not said stays as it was before, which the file does not tell",
            cure="Give every position all of its components",
        )
    return Point(
        line=line,
        name=name,
        xyz=tuple(values[key] for key in _POSE[:3]),
        turn=tuple(values[key] for key in _POSE[3:]),
        tool=settings["$TOOL"],
        frame=settings["$BASE"],
        outer=outer,
    )


def _words(body: str) -> dict[str, str]:
    pairs = (part.split(None, 1) for part in body.strip("{}").split(","))
    return {pair[0].upper(): pair[1].strip() for pair in pairs if len(pair) == 2}


def _with_flange(found: Listed, point: Point, flange: Mapping[str, str] | None) -> Point:
    """Return a point with the tool and base of its FDAT."""
    if flange is None or point.joints:
        return point
    if flange.get("IPO_FRAME", "#BASE").upper() == "#TCP":
        raise Inconsistent(
            f"{found.location(point.line)}: {point.name} is of a tool that stands outside the arm (IPO_FRAME #TCP)",
            consequence="Its numbers are no pose of the tool in the base",
            cure="Leave such points out, or teach them with the tool on the flange",
        )
    tool, base = flange.get("TOOL_NO", ""), flange.get("BASE_NO", "")
    return replace(
        point,
        tool=f"TOOL_DATA[{tool}]" if tool else point.tool,
        frame=f"BASE_DATA[{base}]" if base else point.frame,
    )


RSI = re.compile(r"\A\s*(?:<Rob\s+Type=|[^\n]*\b(?:RIst\.X|AIPos\.A1)\b)", re.IGNORECASE)
"""What a file of RSI begins with: a packet, or a line of elements."""
_RSI_NAMES: Mapping[str, str] = {
    **{f"rist.{key}": f"{key}_mm" for key in "xyz"},
    **{f"rist.{key}": f"euler_{k}_deg" for k, key in enumerate("abc", 1)},
    **{f"aipos.a{k}": f"q{k}_deg" for k in range(1, 7)},
    "ipoc": "time_ms",
}
"""Elements of RSI that are measured, by the names of our columns."""
_PACKET = re.compile(r"<Rob\b.*?</Rob>", re.DOTALL)
_ELEMENT = re.compile(r"<(\w+)((?:\s+\w+=\"[^\"]*\")+)\s*/>")
_ATTRIBUTE = re.compile(r"(\w+)=\"([^\"]*)\"")


def rsi_table(text: str, where: str) -> RawTable:
    """Return RSI's packets, or its elements as columns, with our names for what is measured. Raises BadFile."""
    raw = _packets(text, where) if text.lstrip().startswith("<") else parse_text(text.encode(), where)
    names = tuple(_RSI_NAMES.get(name.strip().lower(), name) for name in raw.names)
    return replace(raw, how=f"RSI, {len(raw)} rows", names=names, csv=False)


def _packets(text: str, where: str) -> RawTable:
    rows: list[dict[str, str]] = []
    lines: list[int] = []
    for packet in _PACKET.finditer(text):
        row: dict[str, str] = {}
        for element, attributes in _ELEMENT.findall(packet[0]):
            row |= {f"{element}.{key}": value for key, value in _ATTRIBUTE.findall(attributes)}
        ipoc = re.search(r"<IPOC>\s*(\d+)\s*</IPOC>", packet[0])
        if ipoc is not None:
            row["IPOC"] = ipoc[1]
        rows.append(row)
        lines.append(len(rows) + 1)
    if not rows or text.count("<Rob ") != len(rows):
        raise BadFile(f"{where}: a packet of RSI is not complete", cure="Record it again: the file is cut")
    for row, line in zip(rows, lines, strict=True):
        if tuple(row) != tuple(rows[0]):
            raise BadFile(f"{where}, packet {line - 1}: it has other elements than the first one")
    columns = tuple([row[name] for row in rows] for name in rows[0])
    return RawTable(where=where, how="", names=tuple(rows[0]), columns=columns, lines=tuple(lines))
