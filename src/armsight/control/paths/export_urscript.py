"""A path as URScript, the language of Universal Robots (e-Series script manual: movej, movel, set_tcp)."""

from __future__ import annotations

from scipy.spatial.transform import RigidTransform

from armsight.control.paths.program import JOINT_SPEED, Program, ascii_only, decimals, weld_state
from armsight.errors import UsageError

JOINT_ACCELERATION = 0.5


def urscript(program: Program) -> str:
    """Return the program as a URScript function: metres, radians, rotation vectors, poses in the robot's base.

    Raises UsageError for a weld output that is no number from 0 to 7.
    """
    if program.weld_output is not None and program.weld_output not in tuple("01234567"):
        raise UsageError(
            f"{program.weld_output[:20]!r} is no standard digital output of a Universal Robots controller",
            consequence="No program is written",
            cure="Give a number from 0 to 7",
        )
    lines = [f"def {program.name}():", "  # Poses are of the tool's tip in the base frame, m and rad."]
    if program.T_flange_tool is None:
        lines.append("  # The tool centre point must be the one the path was taught with.")
    else:
        lines.append(f"  set_tcp({_pose(program.T_flange_tool)})")
    moves = list(program.moves)
    if program.start is not None:
        joints = ", ".join(decimals(float(q), 6) for q in program.start)
        lines.append(f"  movej([{joints}], a={JOINT_ACCELERATION:g}, v={JOINT_SPEED:g})")
    for number, move in enumerate(moves):
        if number or program.start is None:
            lines.append(
                f"  movel({_pose(RigidTransform.from_matrix(move.T_base_tip))}, a={program.acceleration_m_s2:g}, "
                f"v={move.speed_m_s:.6g}, r={decimals(move.blend_m, 6)})"
            )
        if move.tag:
            lines += _tag(move.tag, program.weld_output)
    return "\n".join([*lines, "end", ""])


def _pose(T: RigidTransform) -> str:
    values = [*T.translation, *T.rotation.as_rotvec()]
    return f"p[{', '.join(decimals(float(value), 6) for value in values)}]"


def _tag(tag: str, output: str | None) -> list[str]:
    on = weld_state(tag)
    if on is None or output is None:
        return [f"  # {ascii_only(tag)}"]
    return [f"  set_standard_digital_out({output}, {on})"]
