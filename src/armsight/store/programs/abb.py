"""ABB: RAPID modules (.mod, .sys, .prg): robtarget [[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[eax]], jointtarget.

Positions in mm, q1 the scalar of the quaternion, joints in degrees, 9E9 an axis that is not there (Technical reference
manual, RAPID instructions, functions and data types: pos, orient, robtarget, jointtarget, extjoint). Which tool and
work object a target is of, the motion says that goes there.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from armsight.errors import BadFile
from armsight.store.programs.points import Listed, Point, line_of, numbers, require_end, wrong_count

_DECLARED = re.compile(r"\b(robtarget|jointtarget)\s+(\w+)\s*(\{[\d,\s]+\})?\s*:=\s*", re.IGNORECASE)
_MOTION = re.compile(r"\bMove(?P<kind>L|J|C|AbsJ)\w*\s*(?P<args>[^;]*);", re.IGNORECASE)
_COMMENT = re.compile(r"\"[^\"\n]*\"|!.*")
_TOOL = re.compile(r"\s*(\w+)\s*(?:\\\s*WObj\s*:=\s*(\w+))?.*", re.IGNORECASE | re.DOTALL)
_DEEPEST = 4


def rapid_points(text: str, where: str) -> Listed:
    """Return the targets of a module. Raises BadFile."""
    code = _COMMENT.sub(lambda match: match[0] if match[0][0] == '"' else " " * len(match[0]), text)
    found = Listed(where=where)
    for declared in _DECLARED.finditer(code):
        line, joints = line_of(code, declared.start()), declared[1].lower() == "jointtarget"
        value, _ = _bracket(found, code, declared.end(), line)
        targets = value if declared[3] else [value]
        for k, target in enumerate(targets, 1):
            name = f"{declared[2]}{{{k}}}" if declared[3] else declared[2]
            found.points.append(_target(found, line, name, target, joints=joints))
    _motions(found, code)
    if re.search(r"^[ \t]*MODULE\b", code, re.MULTILINE | re.IGNORECASE):
        require_end(
            found, re.search(r"^[ \t]*ENDMODULE\b", code, re.MULTILINE | re.IGNORECASE) is not None, "ENDMODULE"
        )
    found.points.sort(key=lambda point: point.line)
    return found


def _motions(found: Listed, code: str) -> None:
    """Add the targets that stand in motions themselves, and tool and work object to those that they name."""
    used: dict[str, list[tuple[str, str]]] = {}
    computed = 0
    for motion in _MOTION.finditer(code):
        args, line = _split(motion["args"]), line_of(code, motion.start())
        tool = _TOOL.fullmatch(args[-1]) if len(args) > 1 else None
        setting = (tool[1] if tool else "", (tool[2] or "wobj0") if tool else "")
        joints = motion["kind"].lower() == "absj"
        for k, arg in enumerate(args[: 2 if motion["kind"].lower() == "c" else 1]):
            target = arg.strip().lstrip("\\").strip()
            if target.startswith("["):
                value, _ = _bracket(found, target, 0, line)
                name = f"line {line}{'ab'[k] if k else ''}"
                point = _target(found, line, name, value, joints=joints)
                found.points.append(point if joints else replace(point, tool=setting[0], frame=setting[1]))
            elif re.fullmatch(r"\w+(?:\s*\\\s*NoEOffs)?", target):
                used.setdefault(target.split("\\")[0].strip().lower(), []).append(setting)
            else:
                computed += 1
    for k, point in enumerate(found.points):
        if not point.joints and point.name.lower() in used:
            tools, frames = (" and ".join(sorted(set(names))) for names in zip(*used[point.name.lower()], strict=True))
            found.points[k] = replace(point, tool=tools, frame=frames)
    if computed:
        found.notes.append(f"{computed} targets of motions are computed (Offs, RelTool ...) and not used")


def _split(args: str) -> list[str]:
    """Return arguments apart by commas outside brackets."""
    out, depth = [""], 0
    for letter in args:
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and depth == 0:
            out.append("")
        else:
            out[-1] += letter
    return out


def _bracket(found: Listed, text: str, at: int, line: int) -> tuple[Any, int]:
    """Return the nested lists of cells that begin at a place, and where they end."""
    stack: list[list[Any]] = []
    cell = ""
    for k in range(at, len(text)):
        letter = text[k]
        if letter == "[" and len(stack) < _DEEPEST:
            stack.append([])
        elif letter in ",]" and stack:
            if cell.strip():
                stack[-1].append(cell.strip())
            cell = ""
            if letter == "]":
                done = stack.pop()
                if not stack:
                    return done, k + 1
                stack[-1].append(done)
        elif letter == ";" or not stack:
            break
        else:
            cell += letter
    raise BadFile(
        f"{found.location(line)}: a target's brackets do not close", cure="Export the module again: it is cut"
    )


def _target(found: Listed, line: int, name: str, value: Any, *, joints: bool) -> Point:
    where, sizes = found.location(line), (6, 6) if joints else (3, 4, 4, 6)
    if not isinstance(value, list) or len(value) != len(sizes) or not all(isinstance(part, list) for part in value):
        parts = len(value) if isinstance(value, list) else 0
        raise wrong_count(parts, where, f"the parts of {name}", (len(sizes),))
    for part, size in zip(value, sizes, strict=True):
        if len(part) != size:
            raise wrong_count(len(part), where, f"a part of {name}", (size,))
    outer = numbers(value[-1], where, name)
    if joints:
        return Point(line=line, name=name, joints=numbers(value[0], where, name), outer=outer)
    xyz, turn = numbers(value[0], where, name), numbers(value[1], where, name)
    return Point(line=line, name=name, xyz=xyz, turn=turn, outer=outer)
