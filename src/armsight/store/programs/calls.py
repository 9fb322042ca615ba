"""Mitsubishi, Denso, Nachi, Doosan, Universal Robots, LinuxCNC: programs whose positions stand in their statements.

Mitsubishi MELFA-BASIC: P1=(X,Y,Z,A,B,C)(flags), A about x, B about y, C about z, fixed: R = Rz(C) Ry(B) Rx(A) (rc_cube
manual, pose formats; RoboDK's Mitsubishi). Denso PacScript: P(X,Y,Z,RX,RY,RZ[,FIG]), J(...): sources contradict each
other on the order, so it is asked for. Nachi: MOVEX ... M1X,L,(X,Y,Z,r,p,y): about z, the new y, the new x (RoboDK's
Nachi_AX_FD), M1J: joints. Doosan DRL: posx(X,Y,Z,A,B,C), about z, the new y, the new z; posj (vathos, rotation
representations; visose/Robots SystemDoosan). mm and degrees, all of them. URScript: p[x,y,z,rx,ry,rz], m and a rotation
vector in rad; joints in rad. LinuxCNC: G1 X Y Z A B C in mm (G21) and degrees, A, B, C about the fixed x, y, z
(genserkins: roll, pitch, yaw).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armsight.errors import Ambiguous, BadFile, Inconsistent
from armsight.store.programs.points import NUMBER, Listed, Point, line_of, listed_numbers, numbers, require_end

MELFA_LINE = r"^[ \t]*(?:\d+[ \t]+)?(?:DEF[ \t]+(?:POS|JNT)[ \t]+)?"
"""How a line with a position begins."""
_MELFA = re.compile(
    MELFA_LINE + r"(?P<name>[PJ]\w*)[ \t]*=[ \t]*\((?P<cells>[^()\n]*)(?P<end>\))?", re.MULTILINE | re.IGNORECASE
)


def melfa_points(text: str, where: str) -> Listed:
    """Return the positions P and J of a MELFA-BASIC program. Raises BadFile."""
    found = Listed(where=where)
    for match in _MELFA.finditer(text):
        line = line_of(text, match.start("name"))
        require_end(found, match["end"] is not None, ")")
        kind = match["name"][0].upper()
        values = found.values(line, match["name"], match["cells"], (6, 7, 8), kind)
        found.points.append(_either(line, match["name"], values, joints=kind == "J"))
    return found


def require_six_axes(points: Sequence[Point], where: str) -> None:
    """Raise Ambiguous for poses as a Mitsubishi of five axes has them: C is 0 and A anything.

    A public RV-2AJ's points that look down have A 201.45, B 180.14, C 0.00: about x, y, z they would look up.
    """
    A, _, C = (np.array([float(point.turn[k]) for point in points]) for k in range(3))
    if not C.any() and (np.abs(np.sin(np.radians(A))) > 1e-3).any():
        raise Ambiguous(
            f"{where}: C is 0 at every point and A is not, as arms of five axes have it",
            consequence="Their A and B are a roll and a pitch, and the rotations would be others",
            cure="Give --euler xyz-fixed if the arm has six axes; of five, use its joint values (J)",
        )


def _either(line: int, name: str, values: tuple[str, ...], *, joints: bool) -> Point:
    if joints:
        return Point(line=line, name=name, joints=values[:6], outer=values[6:])
    return Point(line=line, name=name, xyz=values[:3], turn=values[3:6], outer=values[6:])


_DENSO = re.compile(r"(?<![\w.])(?P<kind>[PJ])\((?P<cells>[^()\n]*)(?P<end>\))?", re.IGNORECASE)


def denso_points(text: str, where: str) -> Listed:
    """Return the positions P(...) and J(...) of a PacScript program. Raises BadFile."""
    code = re.sub(r"'.*", lambda match: " " * len(match[0]), text)
    found = Listed(where=where)
    for match in _DENSO.finditer(code):
        line, joints = line_of(code, match.start()), match["kind"].upper() == "J"
        require_end(found, match["end"] is not None, ")")
        counts = (6,) if joints else (6, 7)  # the last one of a pose is its figure
        values = found.values(line, f"line {line}", match["cells"], counts, match["kind"].upper())
        found.points.append(_either(line, f"line {line}", values[:6], joints=joints))
    return found


_NACHI = re.compile(
    r"^[ \t]*(?:\d+\s+)?MOVEX\b(?P<head>[^(\n]*)\((?P<cells>[^()\n]*)(?P<end>\))?(?P<tail>.*)", re.M | re.I
)


def nachi_points(text: str, where: str) -> Listed:
    """Return the positions of MOVEX statements. Raises BadFile."""
    found = Listed(where=where)
    for match in _NACHI.finditer(text):
        line = line_of(text, match.start("head"))
        require_end(found, match["end"] is not None, ")")
        values = listed_numbers(match["cells"], found.location(line), f"line {line}", (6,))
        tool = re.search(r"\bH\s*=\s*(\d+)", match["head"] + match["tail"], re.IGNORECASE)
        point = _either(line, f"line {line}", values, joints="M1J" in match["head"].upper())
        found.points.append(point if point.joints or tool is None else replace(point, tool=f"H={tool[1]}"))
    return found


_DOOSAN = re.compile(r"\bpos(?P<kind>[xj])\s*\(\s*\[?(?P<cells>[^()\[\]\n]*)(?P<end>\]?\s*\))?", re.IGNORECASE)
_RELATIVE = re.compile(r"\ba?move\w*\s*\(\s*(?:(?:\w+\.)*(?P<name>\w+)\s*,)?.*\bmod\s*=\s*(?:DR_MV_MOD_REL|1)\b.*")
"""A movement by so much, whose position is none."""
_SETTING = {
    "doosan tool": re.compile(r"\bset_tcp\s*\(\s*([^)\n]*)\)"),
    "doosan frame": re.compile(r"\bset_ref_coord\s*\(\s*([^)\n]*)\)|\bref\s*=\s*(\w+)"),
    "ur tool": re.compile(r"\bset_tcp\s*\(\s*(p\[[^\]\n]*\]|\w+)"),
}


def _settings(found: Listed, text: str, key: str) -> str:
    """Return the one tool or frame that a program sets, '' for none. Raises Inconsistent for several."""
    names = sorted({next(group for group in match.groups() if group) for match in _SETTING[key].finditer(text)})
    if len(names) > 1:
        raise Inconsistent(
            f"{found.where}: the program sets {len(names)} of its {key.split()[1]}s: {', '.join(names)[:200]}",
            consequence="Which points are of which is not known",
            cure="Leave the points of one of them in the file",
        )
    return names[0] if names else ""


def doosan_points(text: str, where: str) -> Listed:
    """Return the positions posx and posj of a DRL program. Raises BadFile, Inconsistent."""
    found = Listed(where=where)
    code = re.sub(r"#.*", "", text)
    relative = list(_RELATIVE.finditer(code))
    if relative:
        found.notes.append(f"{len(relative)} relative movements (DR_MV_MOD_REL) are not used")
    named = "|".join(match["name"] for match in relative if match["name"])
    code = _RELATIVE.sub("", re.sub(rf"\b(?:{named})\s*=\s*pos[xj]\b.*", "", code) if named else code)
    tool, frame = _settings(found, code, "doosan tool"), _settings(found, code, "doosan frame")
    for match in _DOOSAN.finditer(code):
        line = line_of(code, match.start())
        require_end(found, match["end"] is not None, ")")
        values = listed_numbers(match["cells"], found.location(line), f"line {line}", (6,))
        point = _either(line, f"line {line}", values, joints=match["kind"].lower() == "j")
        found.points.append(point if point.joints else replace(point, tool=tool, frame=frame))
    return found


_UR_MOVED = re.compile(r"\b(?:move[jlpc]|servoc)\s*\(\s*(?P<what>p?\[(?P<cells>[^\]\n]*)(?P<end>\])?|\w+)")
_UR_NAMED = re.compile(r"\b(?P<name>\w+)\s*=\s*(?P<pose>p)?\[(?P<cells>[^\]\n]*)(?P<end>\])?")


def urscript_points(text: str, where: str) -> Listed:
    """Return the positions that motions go to, in them or by name; PolyScript's waypoints. Raises BadFile."""
    code = re.sub(r"#.*", "", text)
    found = Listed(where=where)
    tool = _settings(found, code, "ur tool")
    moved = {match["what"] for match in _UR_MOVED.finditer(code)}
    for match in _UR_MOVED.finditer(code):
        if match["cells"] is not None:
            joints = not match["what"].startswith("p")
            _add_ur(found, line_of(code, match.start()), "", match, joints=joints, tool=tool)
    for match in _UR_NAMED.finditer(code):
        named = match["name"]
        if named in moved or re.fullmatch(r"Waypoint\w*_[pq]", named):
            _add_ur(found, line_of(code, match.start()), named, match, joints=match["pose"] is None, tool=tool)
    found.points.sort(key=lambda point: point.line)
    if re.match(r"\s*(?:global\s+)?def\s+\w+", code):
        require_end(found, re.search(r"^[ \t]*end\b", code, re.MULTILINE) is not None, "end")
    if "pose_trans" in code or "pose_add" in code:
        found.notes.append("poses that the program computes (pose_trans, pose_add) are not used")
    return found


def _add_ur(found: Listed, line: int, name: str, match: re.Match[str], *, joints: bool, tool: str) -> None:
    require_end(found, match["end"] is not None, "]")
    name = name or f"line {line}"
    values = listed_numbers(match["cells"], found.location(line), name, (6,))
    point = _either(line, name, values, joints=joints)
    found.points.append(point if joints else replace(point, tool=tool, frame="the base"))


_GCODE = re.compile(
    r"^[ \t]*(?:N\d+\s*)?(?:G53\s*)?G0*[01](?=[\sXYZ])(?P<words>[^(;\n]*)", re.MULTILINE | re.IGNORECASE
)
_WORD = re.compile(rf"([XYZABCF])\s*({NUMBER.pattern})(?![\d.])", re.IGNORECASE)


def gcode_points(text: str, where: str) -> Listed:
    """Return the positions of G0 and G1 with all six words. Raises BadFile, Inconsistent."""
    found = Listed(where=where)
    code = re.sub(r"\([^()\n]*\)|;.*", lambda match: " " * len(match[0]), text)
    if re.search(r"\bG20\b", code) or not re.search(r"\bG21\b", code):
        raise Inconsistent(
            f"{where}: the program is not in mm: it has no G21, or G20",
            consequence="Its lengths are not known",
            cure="Write G21 where its lengths are in mm",
        )
    for match in _GCODE.finditer(code):
        line = line_of(code, match.start("words"))
        words = {key.upper(): value for key, value in _WORD.findall(match["words"])}
        rest = _WORD.sub("", match["words"]).strip()
        if rest:
            raise BadFile(
                f"{found.location(line)}: {rest[:20]!r} in a motion is no word of X Y Z A B C F with a number",
                consequence="Where it goes is not known",
                cure="Write numbers with a decimal point, and other words in lines of their own",
            )
        missing = [key for key in "XYZABC" if key not in words]
        if missing:
            raise Inconsistent(
                f"{found.location(line)}: the motion has no {', '.join(missing)}",
                consequence="What is not said stays as it was before",
                cure="Give every motion X Y Z A B C",
            )
        values = numbers([words[key] for key in "XYZABC"], found.location(line), f"line {line}")
        point = _either(line, f"line {line}", values, joints=False)
        found.points.append(replace(point, tool="the flange", frame="the machine"))
    require_end(found, re.search(r"^[ \t]*(?:M0*2\b|M30\b|%)", code, re.MULTILINE) is not None, "M2")
    return found
