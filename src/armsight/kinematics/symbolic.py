"""The forward kinematics and the Jacobian of an arm as formulas: readable Python and LaTeX.

What Kapucu's control software writes for itself (Kapucu 2005 sections 1 and 5). Turns about parallel axes are added up
before they are expanded, so that c234 stands where the papers print it.
"""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass
from functools import partial
from typing import Any

import sympy as sp  # type: ignore[import-untyped]  # sympy ships no types
from sympy.printing.pycode import PythonCodePrinter  # type: ignore[import-untyped]  # likewise

from armsight.errors import UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.joints import JointType, distal_rows

QUARTER_TOLERANCE = 1e-12
"""Twists this close to a quarter turn are written as one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Formulas:
    """T_world_tool (4, 4) and the Jacobian (6, n) in world axes as sympy matrices; the symbols and their values.

    joints: the symbols q1..qn. constants: symbol to value in m or rad. short: c234 and the like to what they stand for.
    """

    T: Any
    J: Any
    joints: tuple[Any, ...]
    constants: dict[Any, float]
    short: dict[Any, Any]


def formulas(arm: Arm) -> Formulas:
    """Return the arm's forward kinematics and Jacobian; lengths as symbols a1, d1.., but those that are zero."""
    values: dict[Any, float] = {}
    constant = partial(_constant, values)
    joints = sp.symbols(f"q1:{arm.n + 1}", real=True)
    base, links, tool = distal_rows(
        arm.convention,
        arm.T_world_frame0,
        [(joint.a_m, joint.alpha_rad, joint.beta_rad) for joint in arm.joints],
        arm.T_flange_tool.as_matrix(),
    )

    R, p = _fixed(base, "base", constant)
    phi = sp.Integer(0)
    axes, kinds = [], []
    for i, (joint, (a, alpha, beta)) in enumerate(zip(arm.joints, links, strict=True), start=1):
        q = _sign(joint.sign) * joints[i - 1]
        axes.append(R[:, 2])
        kinds.append(joint.type)
        theta = _angle(joint.theta_rad, f"theta{i}", constant)
        d = constant(f"d{i}", joint.d_m)
        if joint.type is JointType.REVOLUTE:
            theta = theta + q
        else:
            d = d + q
        phi = phi + theta
        reach = constant(f"a{i}", a)
        p = p + R * sp.Matrix([reach * sp.cos(phi), reach * sp.sin(phi), d])
        twist, tilt = _angle(alpha, f"alpha{i}", constant), _angle(beta, f"beta{i}", constant)
        if twist != 0 or tilt != 0:
            R = R * _turn(2, phi) * _turn(0, twist) * _turn(1, tilt)
            phi = sp.Integer(0)
    R = R * _turn(2, phi)
    tool_R, tool_p = _fixed(tool, "tool", constant)
    p = p + R * tool_p
    R = R * tool_R
    return _gathered(arm, R, p, axes, kinds, joints, values)


def _constant(values: dict[Any, float], name: str, value: float) -> Any:
    if value == 0.0:
        return sp.Integer(0)
    symbol = sp.Symbol(name, real=True)
    values[symbol] = value
    return symbol


def _gathered(
    arm: Arm, R: Any, p: Any, axes: list[Any], kinds: list[JointType], joints: Any, constants: dict[Any, float]
) -> Formulas:
    columns = []
    for q, axis, kind, joint in zip(joints, axes, kinds, arm.joints, strict=True):
        turn = _sign(joint.sign) * axis if kind is JointType.REVOLUTE else sp.zeros(3, 1)
        columns.append(sp.Matrix([p.diff(q), turn]))
    T = sp.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    J = sp.Matrix.hstack(*columns)
    short: dict[Any, Any] = {}
    for call in sorted(T.atoms(sp.sin, sp.cos) | J.atoms(sp.sin, sp.cos), key=str):
        short[sp.Symbol(_short_name(call, joints), real=True)] = call
    back = {call: name for name, call in short.items()}
    return Formulas(
        T=T.subs(back).applyfunc(sp.expand_mul).applyfunc(sp.factor_terms),
        J=J.subs(back).applyfunc(sp.expand_mul).applyfunc(sp.factor_terms),
        joints=tuple(joints),
        constants=constants,
        short=short,
    )


def python_source(arm: Arm, *, name: str = "forward") -> str:
    """Return a Python module with one function that computes T_world_tool and the Jacobian with `math` alone."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise UsageError(f"{name!r} is not a name for a Python function")
    f = formulas(arm)
    text = PythonCodePrinter({"fully_qualified_modules": False})
    lines = [
        f'"""Forward kinematics and Jacobian of {_plain(arm.name)}, written by armsight. m, rad."""',
        "",
        "from math import cos, pi, sin",
        "",
    ]
    lines += [f"{symbol} = {value!r}" for symbol, value in sorted(f.constants.items(), key=lambda item: str(item[0]))]
    arguments = ", ".join(str(q) for q in f.joints)
    lines += ["", "", f"def {name}({arguments}):"]
    lines += ['    """Return T_world_tool (4 rows) and the Jacobian (6 rows) in world axes."""']
    lines += [
        f"    {symbol} = {text.doprint(call)}" for symbol, call in sorted(f.short.items(), key=lambda s: str(s[0]))
    ]
    for label, matrix in (("T", f.T), ("J", f.J)):
        lines.append(f"    {label} = [")
        for row in range(matrix.rows):
            lines.append("        [")
            lines += [f"            {text.doprint(matrix[row, column])}," for column in range(matrix.cols)]
            lines.append("        ],")
        lines.append("    ]")
    lines += ["    return T, J", ""]
    return "\n".join(lines)


def latex_source(arm: Arm) -> str:
    """Return the same as LaTeX: one aligned display for the pose, one for the Jacobian."""
    f = formulas(arm)
    entries = ("n", "o", "a", "p")
    names = {
        symbol: re.sub(r"^([a-zA-Z]+?)_?(\d+)$", r"\1_{\2}", str(symbol))
        .replace("theta", r"\theta")
        .replace("alpha", r"\alpha")
        .replace("beta", r"\beta")
        for symbol in [*f.short, *f.constants, *f.joints]
    }
    lines = [f"% forward kinematics of {_plain(arm.name)}", r"\begin{align}"]
    for column, entry in enumerate(entries):
        for row, axis in enumerate("xyz"):
            lines.append(rf"{entry}_{axis} &= {sp.latex(f.T[row, column], symbol_names=names)} \\")
    lines += [r"\end{align}", r"\begin{align}"]
    for row in range(6):
        for column in range(len(f.joints)):
            lines.append(rf"j_{{{row + 1}{column + 1}}} &= {sp.latex(f.J[row, column], symbol_names=names)} \\")
    lines += [r"\end{align}", ""]
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Return text without anything that could end a comment or a string."""
    return re.sub(r"[^\w .,()+-]", " ", text)


def _sign(sign: float) -> Any:
    return sp.Integer(int(sign)) if abs(sign) == 1.0 else sp.Float(sign, 17)


def _angle(value: float, name: str, constant: Any) -> Any:
    """Return an angle, exact where it is a number of quarter turns."""
    quarters = value / (float(sp.pi) / 2)
    if abs(quarters - round(quarters)) < QUARTER_TOLERANCE:
        return sp.pi * round(quarters) / 2
    return constant(name, value)


def _turn(axis: int, angle: Any) -> Any:
    """Return the rotation matrix about x, y or z (0, 1, 2)."""
    if angle == 0:
        return sp.eye(3)
    c, s = sp.cos(angle), sp.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = sp.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def _fixed(T: Any, name: str, constant: Any) -> tuple[Any, Any]:
    """Return rotation and translation of a fixed transform; entries of 0 and 1 stay numbers."""

    def entry(row: int, column: int) -> Any:
        value = float(T[row, column])
        if abs(value - round(value)) < QUARTER_TOLERANCE and column < 3:
            return sp.Integer(round(value))
        return constant(f"{name}_{row + 1}{column + 1}", value)

    return sp.Matrix(3, 3, lambda r, c: entry(r, c)), sp.Matrix(3, 1, lambda r, _: entry(r, 3))


def _short_name(call: Any, joints: tuple[Any, ...]) -> str:
    """Return c234 for cos(q2 + q3 + q4); other arguments keep their letters."""
    letter = "s" if isinstance(call, sp.sin) else "c"
    argument = call.args[0]
    terms = argument.as_coefficients_dict()
    if all(term in joints and factor == 1 for term, factor in terms.items()):
        return letter + "".join(str(joints.index(term) + 1) for term in sorted(terms, key=joints.index))
    return letter + "_" + re.sub(r"\W+", "_", str(argument).replace("-", "m").replace("+", "p")).strip("_")
