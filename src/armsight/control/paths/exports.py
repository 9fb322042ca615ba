"""A path as a program in KRL (KUKA), RAPID (ABB; MoveL, MoveAbsJ, robtarget, zonedata) or URScript, or in Python."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.control.guard.limits import JointBounds
from armsight.control.paths.linuxcnc import MARGINS, STOP_S, Axes, LinuxcncPlan
from armsight.control.paths.program import (
    APPROACH_SPEED_M_S,
    JOINT_SPEED,
    NAME,
    Program,
    ascii_only,
    decimals,
    in_degrees,
    tag_line,
)
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.records import TaughtPath
from armsight.units import DEG, MM

PTP_PERCENT = 10


def krl(program: Program) -> str:
    """Return the program as a .src: millimetres, A, B, C in degrees, poses in $ROBROOT.

    A turns about z, B about the new y, C about the new x: R = Rz(A) Ry(B) Rx(C). The tool is a number of TOOL_DATA.
    Raises UsageError where tool or weld output are no numbers that KRL takes.
    """
    tool, T = _number("tool", program.tool, 1, 16), program.T_flange_tool
    if tool is None:
        raise UsageError(
            "KRL names its tool by number, and none is given",
            cure="Give the number of TOOL_DATA that holds this tool (--tool)",
        )
    weld = _number("weld output", program.weld_output, 1, 4096)
    lines = [
        "&ACCESS RVP",
        f"DEF {program.name}()",
        "; Poses are of the tool's tip in the robot's base ($ROBROOT), mm and degrees.",
        f"; TOOL_DATA[{tool}] must be {'the tool the path was taught with.' if T is None else krl_frame(T)}",
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
            lines.append(
                f"LIN {krl_frame(RigidTransform.from_matrix(move.T_base_tip))}{' C_DIS' * (move.blend_m > 0.0)}"
            )
        if move.tag:
            lines.append(tag_line(move.tag, weld, lambda on: f"$OUT[{weld}]={str(on).upper()}", "; {}"))
    return "\r\n".join([*lines, "END", ""])


def krl_frame(T: RigidTransform) -> str:
    """Return {X .., Y .., Z .., A .., B .., C ..}, mm and degrees."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at B = 90 degrees only A - C is fixed, and C = 0 is as good
        a, b, c = in_degrees(np.asarray(T.rotation.as_euler("ZYX")))
    x, y, z = (decimals(float(value) / MM, 4) for value in T.translation)
    return f"{{X {x},Y {y},Z {z},A {a},B {b},C {c}}}"


def _number(what: str, text: str | None, lowest: int, highest: int) -> int | None:
    if text is None:
        return None
    if not (text.isascii() and text.isdecimal() and lowest <= int(text) <= highest):
        raise UsageError(
            f"{text[:20]!r} is no {what} of a KUKA controller", cure=f"Give a number from {lowest} to {highest}"
        )
    return int(text)


SIGNAL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
REST = "5000,1000"
"""Speeds of outer axes, of which there are none."""


def rapid(program: Program) -> str:
    """Return the program as a module: millimetres, quaternions with w first, poses in wobj0.

    The tool is a tooldata's name, which the module does not declare: its mass is not known here. Zones are of the
    position blend_m wide, and half as much again for rotations, as ABB's own. wobj0 is the world: the robot's base
    where the controller has not moved it. Raises UsageError where tool or weld output are no names.
    """
    output = program.weld_output
    if program.tool is None or NAME.fullmatch(program.tool) is None:
        raise UsageError(
            "RAPID names its tool, and no name that it takes is given",
            cure="Give the name of the tooldata of this tool (--tool)",
        )
    if output is not None and SIGNAL.fullmatch(output) is None:
        raise UsageError(
            f"{output[:20]!r} is no name of a signal",
            cure="Give the name of the digital output in the controller",
        )
    T = program.T_flange_tool
    tool = "the tool the path was taught with." if T is None else f"[TRUE,[{rapid_pose(T)}], ...]"
    lines = [
        f"MODULE {program.name}_module",
        "  ! Poses are of the tool's tip in wobj0, mm; quaternions have w first.",
        "  ! wobj0 must be the robot's base: no base frame moved in the controller.",
        f"  ! {program.tool} must be {tool}",
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
            target = f"[{rapid_pose(RigidTransform.from_matrix(move.T_base_tip))},[0,0,0,0],{NO_AXES}]"
            lines.append(f"    MoveL {target},{speed},{_zone(move.blend_m)},{program.tool}\\WObj:=wobj0;")
        if move.tag:
            lines.append(tag_line(move.tag, output, lambda on: f"    SetDO {output},{int(on)};", "    ! {}"))
    return "\r\n".join([*lines, "  ENDPROC", "ENDMODULE", ""])


def rapid_pose(T: RigidTransform) -> str:
    """Return [x,y,z],[q1,q2,q3,q4], mm, the scalar first."""
    x, y, z, w = T.rotation.as_quat(canonical=True)
    position = ",".join(decimals(float(value) / MM, 4) for value in T.translation)
    return f"[{position}],[{','.join(decimals(float(value), 9) for value in (w, x, y, z))}]"


def _zone(radius_m: float) -> str:
    if radius_m <= 0.0:
        return "fine"
    position, turn, angle = (decimals(share * radius_m / MM, 4) for share in (1.0, 1.5, 0.15))
    return f"[FALSE,{position},{turn},{turn},{angle},{turn},{angle}]"


JOINT_ACCELERATION = 0.5


def urscript(program: Program) -> str:
    """Return a URScript function: m, rad, rotation vectors in base. Raises UsageError for an output not 0 to 7."""
    output = program.weld_output
    if output is not None and output not in tuple("01234567"):
        raise UsageError(
            f"{output[:20]!r} is no standard digital output of a Universal Robots controller",
            cure="Give a number from 0 to 7",
        )
    lines = [f"def {program.name}():", "  # Poses are of the tool's tip in the base frame, m and rad."]
    if program.T_flange_tool is None:
        lines.append("  # The tool centre point must be the one the path was taught with.")
    else:
        lines.append(f"  set_tcp({ur_pose(program.T_flange_tool)})")
    moves = list(program.moves)
    if program.start is not None:
        joints = ", ".join(decimals(float(q), 6) for q in program.start)
        lines.append(f"  movej([{joints}], a={JOINT_ACCELERATION:g}, v={JOINT_SPEED:g})")
    for number, move in enumerate(moves):
        if number or program.start is None:
            lines.append(
                f"  movel({ur_pose(RigidTransform.from_matrix(move.T_base_tip))}, a={program.acceleration_m_s2:g}, "
                f"v={move.speed_m_s:.6g}, r={decimals(move.blend_m, 6)})"
            )
        if move.tag:
            lines.append(tag_line(move.tag, output, lambda on: f"  set_standard_digital_out({output}, {on})", "  # {}"))
    return "\n".join([*lines, "end", ""])


def ur_pose(T: RigidTransform) -> str:
    """Return p[x, y, z, rx, ry, rz], m and a rotation vector."""
    values = [*T.translation, *T.rotation.as_rotvec()]
    return f"p[{', '.join(decimals(float(value), 6) for value in values)}]"


def python_module(path: TaughtPath, name: str = "PATH") -> str:
    """Return the source of a module whose NAME is this path, number for number."""
    T = ",\n        ".join(repr(rows) for rows in path.T_world_tip.tolist())
    head = f"A path of the tool's tip: {len(path)} poses in {path.parent}, {path.length_m[-1]:.4f} m."
    return f'''"""{head} Written by armsight."""

import numpy as np
from numpy import nan

from armsight.records import TaughtPath

{name} = TaughtPath(
    T_world_tip=np.array([
        {T},
    ]),
    t_s=np.array({_numbers(path.t_s)}),
    speed_m_s=np.array({_numbers(path.speed_m_s)}),
    tags={path.tags!r},
    parent={path.parent!r},
)
'''


def _numbers(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"[{', '.join(repr(value) for value in values.tolist())}]"


STANDS_DEG = 0.1
"""So near to its beginning each joint stands, or the program ends before anything moves."""
ROCK_DEG = 1e-4
"""A of every second line that goes over into the next: where A B C stand, LinuxCNC rounds corners in another way and
goes faster than is worked out here (30 mm/s for 25 seen)."""
OUTPUTS = 64


def gcode(
    name: str, plan: LinuxcncPlan, controller: Arm, axes: Axes, bounds: JointBounds, weld_output: str | None
) -> str:
    """Return the program; controller: in Craig's convention, for genserkins. Raises UsageError for no output."""
    if weld_output is not None and not (weld_output.isdecimal() and int(weld_output) < OUTPUTS):
        raise UsageError(
            f"{weld_output[:20]!r} is no digital output of LinuxCNC",
            cure=f"Give the number of a motion.digital-out, from 0 to {OUTPUTS - 1}",
        )
    blend_m = max(line.blend_m for line in plan.lines)
    mode = f"G64 P{decimals(blend_m / MM, 4)} Q0" if blend_m > 0.0 else "G61.1"
    lines = [*_head(name, plan, controller, bounds), *_guards(plan, axes), f"G21 G90 G94 G17 G40 G49 G80 {mode}"]
    for k, line in enumerate(plan.lines):
        far = np.linalg.norm(line.xyz_m - plan.lines[k - 1].xyz_m) if k else 1.0
        feed = line.speed / MM if far > 1e-9 else line.speed / DEG
        rock = ROCK_DEG * (k % 2) if blend_m > 0.0 else 0.0
        xyz_mm, abc_deg = (line.xyz_m / MM).tolist(), np.rad2deg(line.abc_rad).tolist()
        values = zip("XYZABC", (*xyz_mm, abc_deg[0] + rock, *abc_deg[1:]), strict=True)
        words = [f"{letter}{decimals(value, 5)}" for letter, value in values]
        lines.append(f"G53 G1 {' '.join(words)} F{decimals(60.0 * feed, 4)}")
        if line.tag or (blend_m > 0.0 and line.blend_m == 0.0):
            lines.append(f"G4 P{STOP_S:g}")  # it stops, and whatever follows waits for that
        if line.tag:
            tag = line.tag.replace("(", "[").replace(")", "]")
            lines.append(
                tag_line(tag, weld_output, lambda on: f"{'M64' if on else 'M65'} P{int(weld_output or 0)}", "( {} )")
            )
    return "\n".join([*lines, "M2", ""])


def _head(name: str, plan: LinuxcncPlan, controller: Arm, bounds: JointBounds) -> list[str]:
    """Return what the program says of itself: what it was planned for, and what each joint will do."""
    said = [
        f"{name}: LinuxCNC in world mode with genserkins, poses of the flange in machine coordinates",
        f"worked out: {plan.t_s[-1]:.2f} s, the tip at most {plan.off_m / MM:.3f} mm from the path",
        "genserkins has to be set to:",
        *(
            f"  A-{j} {decimals(joint.a_m / MM, 5)}, ALPHA-{j} {decimals(joint.alpha_rad, 7)}, "
            f"D-{j} {decimals(joint.d_m / MM, 5)}"
            for j, joint in enumerate(controller.joints)
        ),
        "joints, from 0: speed and limit in deg/s, acceleration and limit in deg/s^2",
        *(
            f"  {j}: {plan.speed[j] / DEG:.2f} of {bounds.speed[j] / DEG:.2f}, "
            f"{plan.acceleration[j] / DEG:.1f} of {bounds.acceleration[j] / DEG:.1f}"
            for j in range(len(plan.speed))
        ),
    ]
    return [f"( {ascii_only(text).replace('(', '[').replace(')', ']')} )" for text in said]


def _guards(plan: LinuxcncPlan, axes: Axes) -> list[str]:
    """Return what ends the program before anything moves: joints that stand elsewhere or may do less, quicker axes.

    The pins of the joints need [RS274NGC]HAL_PIN_VARS, the INI's numbers INI_VARS: without them it ends as well.
    """
    q, lines = np.rad2deg(plan.q[0]).tolist(), ["o1 if [#<_metric_machine> EQ 1]", "#<_unit> = 1", "o1 else"]
    lines += ["#<_unit> = 25.4", "o1 endif"]
    stand = ", ".join(decimals(value, 3) for value in q)
    off = [f"ABS[#<_hal[joint.{j}.pos-fb]> - {decimals(value, 4)}] GT {STANDS_DEG:g}" for j, value in enumerate(q)]
    lines += _ended(2, off, f"the joints do not stand at {stand} deg, where this program begins")
    for number, letters, most, unit, scale in (
        (3, "XYZ", axes.acceleration_m_s2 / MM, "mm/s^2", " * #<_unit>"),
        (4, "ABC", axes.acceleration_rad_s2 / DEG, "deg/s^2", ""),
    ):
        quick = [f"#<_ini[AXIS_{one}]MAX_ACCELERATION>{scale} GT {1.0001 * most:.6g}" for one in letters]
        told = f"MAX_ACCELERATION of {' '.join(letters)} is more than the planned {most:.6g} {unit}"
        lines += _ended(number, quick, told)
    for number, key, values, margin in (
        (5, "MAX_VELOCITY", plan.speed, MARGINS[0]),
        (6, "MAX_ACCELERATION", plan.acceleration, MARGINS[1]),
    ):
        planned = enumerate((margin * np.rad2deg(values)).tolist())
        less = [f"#<_ini[JOINT_{j}]{key}> LT {value:.6g}" for j, value in planned]
        lines += _ended(number, less, f"a joint will need more than its {key}: see the head of this program")
    return lines


def _ended(number: int, any_of: Sequence[str], why: str) -> list[str]:
    """Return what ends the program where any of these holds; a line of G-code has 255 characters at most."""
    lines = ["#<_no> = 0", *(f"#<_no> = [#<_no> OR [{one}]]" for one in any_of)]
    return [*lines, f"o{number} if [#<_no>]", f"(abort, {why})", f"o{number} endif"]
