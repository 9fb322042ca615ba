"""A path as RAPID, the language of ABB (technical reference manual: MoveL, MoveAbsJ, robtarget, zonedata)."""

from __future__ import annotations

import re

from scipy.spatial.transform import RigidTransform

from armsight.control.paths.program import (
    APPROACH_SPEED_M_S,
    JOINT_SPEED,
    NAME,
    Program,
    ascii_only,
    decimals,
    in_degrees,
    weld_state,
)
from armsight.errors import UsageError
from armsight.units import DEG, MM

SIGNAL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
REST = "5000,1000"
"""Speeds of outer axes, of which there are none."""


def rapid(program: Program) -> str:
    """Return the program as a module: millimetres, quaternions with w first, poses in wobj0.

    The tool is a tooldata's name, which the module does not declare: its mass is not known here. Zones are of the place
    blend_m wide, and half as much again for rotations, as ABB's own. wobj0 is the world: the robot's base where the
    controller has not moved it. Raises UsageError where tool or weld output are no names.
    """
    if program.tool is None or NAME.fullmatch(program.tool) is None:
        raise UsageError(
            "RAPID names its tool, and no name that it takes is given",
            consequence="No program is written",
            cure="Give the name of the tooldata of this tool (--tool)",
        )
    if program.weld_output is not None and SIGNAL.fullmatch(program.weld_output) is None:
        raise UsageError(
            f"{program.weld_output[:20]!r} is no name of a signal",
            consequence="No program is written",
            cure="Give the name of the digital output in the controller",
        )
    lines = [
        f"MODULE {program.name}_module",
        "  ! Poses are of the tool's tip in wobj0, mm; quaternions have w first.",
        "  ! wobj0 must be the robot's base: no base frame moved in the controller.",
        f"  ! {program.tool} must be {_tool_note(program.T_flange_tool)}",
        f"  PROC {program.name}()",
        "    ConfJ\\Off;",
        "    ConfL\\Off;",
    ]
    if program.start is not None:
        target = f"[[{','.join(in_degrees(program.start))}],{NO_AXES}]"
        speed = f"[{decimals(APPROACH_SPEED_M_S / MM, 3)},{decimals(JOINT_SPEED / DEG, 3)},{REST}]"
        lines.append(f"    MoveAbsJ {target},{speed},fine,{program.tool};")
    for number, move in enumerate(program.moves):
        if number or program.start is None:
            speed = f"[{decimals(move.speed_m_s / MM, 3)},{decimals(program.turn_rad_s / DEG, 3)},{REST}]"
            target = f"[{_pose(RigidTransform.from_matrix(move.T_base_tip))},[0,0,0,0],{NO_AXES}]"
            lines.append(f"    MoveL {target},{speed},{_zone(move.blend_m)},{program.tool}\\WObj:=wobj0;")
        if move.tag:
            lines += _tag(move.tag, program.weld_output)
    return "\r\n".join([*lines, "  ENDPROC", "ENDMODULE", ""])


def _pose(T: RigidTransform) -> str:
    x, y, z, w = T.rotation.as_quat(canonical=True)
    place = ",".join(decimals(float(value) / MM, 4) for value in T.translation)
    return f"[{place}],[{','.join(decimals(float(value), 9) for value in (w, x, y, z))}]"


def _zone(radius_m: float) -> str:
    if radius_m <= 0.0:
        return "fine"
    place, turn, angle = (decimals(share * radius_m / MM, 4) for share in (1.0, 1.5, 0.15))
    return f"[FALSE,{place},{turn},{turn},{angle},{turn},{angle}]"


def _tool_note(T: RigidTransform | None) -> str:
    return "the tool the path was taught with." if T is None else f"[TRUE,[{_pose(T)}], ...]"


def _tag(tag: str, output: str | None) -> list[str]:
    on = weld_state(tag)
    if on is None or output is None:
        return [f"    ! {ascii_only(tag)}"]
    return [f"    SetDO {output},{int(on)};"]
