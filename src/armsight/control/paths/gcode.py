"""A planned path as G-code for LinuxCNC, which refuses by itself to run where it was not planned for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armsight.control.guard.limits import JointBounds
from armsight.control.paths.linuxcnc import MARGINS, STOP_S, Axes, LinuxcncPlan
from armsight.control.paths.program import ascii_only, decimals, tag_line
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.units import DEG, MM

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
