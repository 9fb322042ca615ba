"""A path as KRL, the language of KUKA (KUKA System Software, programming instructions: PTP, LIN, C_DIS)."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.control.paths.program import Program, ascii_only, decimals, in_degrees, weld_state
from armsight.errors import UsageError
from armsight.units import DEG, MM

PTP_PERCENT = 10


def krl(program: Program) -> str:
    """Return the program as a .src: millimetres, A, B, C in degrees, poses in $ROBROOT.

    A turns about z, B about the new y, C about the new x: R = Rz(A) Ry(B) Rx(C). The tool is a number of TOOL_DATA.
    Raises UsageError where tool or weld output are no numbers that KRL takes.
    """
    tool, output = _number("tool", program.tool, 1, 16), program.weld_output
    if tool is None:
        raise UsageError(
            "KRL names its tool by number, and none is given",
            consequence="No program is written",
            cure="Give the number of TOOL_DATA that holds this tool (--tool)",
        )
    weld = _number("weld output", output, 1, 4096)
    lines = [
        "&ACCESS RVP",
        f"DEF {program.name}()",
        "; Poses are of the tool's tip in the robot's base ($ROBROOT), mm and degrees.",
        *_tool_note(program.T_flange_tool, tool),
        "BAS(#INITMOV,0)",
        f"BAS(#VEL_PTP,{PTP_PERCENT})",
        f"BAS(#ACC_PTP,{PTP_PERCENT})",
        "$BASE=$ROBROOT",
        f"$TOOL=TOOL_DATA[{tool}]",
        f"$ACC.CP={program.acceleration_m_s2:g}",
        f"$VEL.ORI1={program.turn_rad_s / DEG:.6g}",
        f"$VEL.ORI2={program.turn_rad_s / DEG:.6g}",
    ]
    if program.start is not None:
        names = (f"A{i + 1} {angle}" for i, angle in enumerate(in_degrees(program.start)))
        lines.append(f"PTP {{{','.join(names)}}}")
    speed = blend = 0.0
    for number, move in enumerate(program.moves):
        if number or program.start is None:
            if move.speed_m_s != speed:
                speed = move.speed_m_s
                lines.append(f"$VEL.CP={speed:.6g}")
            if move.blend_m > 0.0 and move.blend_m != blend:
                blend = move.blend_m
                lines.append(f"$APO.CDIS={decimals(blend / MM, 4)}")
            lines.append(f"LIN {_frame(RigidTransform.from_matrix(move.T_base_tip))}{' C_DIS' * (move.blend_m > 0.0)}")
        if move.tag:
            lines += _tag(move.tag, weld)
    return "\r\n".join([*lines, "END", ""])


def _frame(T: RigidTransform) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at B = 90 degrees only A - C is fixed, and C = 0 is as good
        a, b, c = in_degrees(np.asarray(T.rotation.as_euler("ZYX")))
    x, y, z = (decimals(float(value) / MM, 4) for value in T.translation)
    return f"{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}"


def _tool_note(T: RigidTransform | None, tool: int) -> list[str]:
    if T is None:
        return [f"; TOOL_DATA[{tool}] must be the tool the path was taught with."]
    return [f"; TOOL_DATA[{tool}] must be {_frame(T)}"]


def _number(what: str, text: str | None, lowest: int, highest: int) -> int | None:
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and lowest <= int(text) <= highest):
        raise UsageError(
            f"{text[:20]!r} is no {what} of a KUKA controller",
            consequence="No program is written",
            cure=f"Give a number from {lowest} to {highest}",
        )
    return int(text)


def _tag(tag: str, output: int | None) -> list[str]:
    on = weld_state(tag)
    if on is None or output is None:
        return [f"; {ascii_only(tag)}"]
    return [f"$OUT[{output}]={'TRUE' if on else 'FALSE'}"]
