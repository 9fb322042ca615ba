"""Every kind of robot's program that is read: one entry a kind, told from others by what stands in its lines.

What a file of each says stands, with its source, at the head of the module that reads it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.store.interpret.raw import RawTable
from armsight.store.interpret.table_format import TableFormat
from armsight.store.programs import abb, calls, fanuc, kuka, lists, yaskawa
from armsight.store.programs.points import Listed, Point, about_z, asked_order, chosen, one_setting, require_one_kind
from armsight.store.tables import decoded, is_number

QUATERNION, VECTOR, ASKED = "wxyz", "rotvec", ""
"""What may stand for an order of Euler angles: a quaternion, w first, or a rotation vector; asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramKind:
    """A kind of program: title for lists; needs: what has to be said beside it; unit: of its lengths and angles.

    told: what stands in its lines and in no other's. points: reads them. order: of its angles, as `euler_order` takes
    it, or QUATERNION, VECTOR, ASKED. likely: orders that sources give where they contradict each other. written: the
    kind of `path export` that writes it. source: where its form is written down. open_end: a part of it looks complete.
    """

    title: str
    told: str
    points: Callable[[str, str], Listed]
    order: str
    source: str
    needs: str = ""
    unit: str = "mm, deg"
    likely: str = ""
    written: str = ""
    open_end: bool = False


PROGRAMS: Mapping[str, ProgramKind] = {
    "krl": ProgramKind(
        title="KUKA KRL: .src, .dat",
        told=r"^[ \t]*(?:&ACCESS\b|DEFDAT\b|(?:GLOBAL\s+)?DEF\s+\w+\s*\([^)\n]*\)\s*$"
        r"|(?:GLOBAL\s+)?DECL\s+(?:GLOBAL\s+)?E?6?(?:POS|AXIS)\b)",
        points=kuka.krl_points,
        order="zyx",
        written="krl",
        source="KUKA System Software: FRAME, POS, AXIS",
    ),
    "fanuc": ProgramKind(
        title="FANUC: .ls",
        told=r"^/PROG\b",
        points=fanuc.ls_points,
        order="xyz-fixed",
        source="rc_cube manual, FANUC XYZ-WPR; J3: ros-industrial/fanuc #186, fanuc_experimental #17",
    ),
    "rapid": ProgramKind(
        title="ABB RAPID: .mod, .prg",
        told=r"^[ \t]*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\s+(?:robtarget|jointtarget)\b)",
        points=abb.rapid_points,
        order=QUATERNION,
        written="rapid",
        source="ABB, RAPID data types: robtarget, jointtarget",
    ),
    "jbi": ProgramKind(
        title="Yaskawa (Motoman) job: .JBI",
        told=r"^/JOB\b|^///POSTYPE\b",
        points=yaskawa.jbi_points,
        order="xyz-fixed",
        needs="--pulses-per-degree for positions in pulses",
        source="Yaskawa DX100, easy offline teaching, 4.3",
    ),
    "as": ProgramKind(
        title="Kawasaki AS: .as",
        told=r"^\.(?:TRANS|JOINTS)\b|^\.\*=== AS GROUP",
        points=lists.as_points,
        order="zyz",
        source="AS language: transformation values; rc_cube manual, Kawasaki XYZ-OAT",
    ),
    "val3": ProgramKind(
        title="Staubli VAL 3 data: .dtx",
        told=r"http://www\.staubli\.com/robotics/VAL3/Data|<dataList\s+xmlns=\"DataNameSpace\"",
        points=lists.dtx_points,
        order="xyz",
        source="VAL 3: trsf; RoboDK Staubli_VAL3_simplified",
    ),
    "pts": ProgramKind(
        title="Epson RC+ points: .pts",
        told=r"^[ \t]*Point\d+\s*\{",
        points=lists.pts_points,
        order=ASKED,
        likely="zyx (strangers' files), or what the manual says",
        needs="--euler",
        source="form: files of RC+ 7 (sVersion 2.0.0)",
    ),
    "melfa": ProgramKind(
        title="Mitsubishi MELFA-BASIC: .prg",
        told=calls.MELFA_LINE + r"(?:P\w*[ \t]*=[ \t]*\([-+\d., \t]+\)\(|J\w*[ \t]*=[ \t]*\([-+\d., \t]+\))",
        points=calls.melfa_points,
        open_end=True,
        order="xyz-fixed",
        source="rc_cube manual, Mitsubishi XYZ-ABC; RoboDK Mitsubishi",
    ),
    "denso": ProgramKind(
        title="Denso PacScript: .pcs, .pac",
        told=r"^[ \t]*(?:DEFPOS|MOVE\s+[PLCS]\s*,).*\b[PJ]\(",
        points=calls.denso_points,
        open_end=True,
        order=ASKED,
        likely="xyz-fixed or zyz",
        needs="--euler",
        source="form: RoboDK Denso_RC8",
    ),
    "nachi": ProgramKind(
        title="Nachi: MOVEX statements",
        told=r"^[ \t]*(?:\d+\s+)?MOVEX\b",
        points=calls.nachi_points,
        open_end=True,
        order="zyx",
        source="RoboDK Nachi_AX_FD",
    ),
    "drl": ProgramKind(
        title="Doosan DRL",
        told=r"\bpos[xj]\s*\(",
        points=calls.doosan_points,
        open_end=True,
        order="zyz",
        source="vathos, rotation representations; visose/Robots SystemDoosan",
    ),
    "urscript": ProgramKind(
        title="Universal Robots URScript: .script",
        told=r"^[ \t]*(?:global\s+)?def\s+\w+\s*\([^)\n]*\)\s*:|\bmove[jlp]\s*\(\s*p?\[",
        points=calls.urscript_points,
        order=VECTOR,
        unit="m, rad",
        written="urscript",
        source="URScript: p[x, y, z, rx, ry, rz]",
    ),
    "gcode": ProgramKind(
        title="LinuxCNC G-code with X Y Z A B C: .ngc",
        told=r"^[ \t]*(?:N\d+\s*)?(?:G53\s*)?G0*[01]\s*X.*\bA[-\d.]+\s+B",
        points=calls.gcode_points,
        order="xyz-fixed",
        written="linuxcnc",
        source="LinuxCNC genserkins: roll, pitch, yaw",
    ),
}
"""By name, in the order in which a file is tried."""
_TOLD = {name: re.compile(kind.told, re.MULTILINE | re.IGNORECASE) for name, kind in PROGRAMS.items()}


def kind_of(head: str) -> str | None:
    """Return which kind of program a text is, by what its lines hold; None for none."""
    return next((name for name, told in _TOLD.items() if told.search(head)), None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """A program as a table, what is said of that table, and what was understood, in words."""

    raw: RawTable
    format: TableFormat
    notes: tuple[str, ...]


def program_table(data: bytes, where: str, joints: bool | None, format_: TableFormat) -> Program | None:
    """Return a program's points as a table, None for a file that is none.

    joints: whether joint values are wanted or poses, None for what it holds more of. Raises BadFile, Inconsistent,
    Ambiguous, NotEnoughData, UsageError.
    """
    head = data[:HEAD].decode("utf-8", errors="replace").lstrip("\ufeff")
    if kuka.RSI.search(head):
        raw = kuka.rsi_table(decoded(data, where), where)
        return Program(raw=raw, format=replace(format_, euler=format_.euler or PROGRAMS["krl"].order), notes=())
    name = kind_of(head)
    if name is None:
        return None
    kind = PROGRAMS[name]
    if format_.columns:
        raise UsageError(
            f"{where}: --columns names the columns of a table, and this is a program ({kind.title})",
            cure="Leave --columns away",
        )
    found = kind.points(_text(data, where), where)
    if joints is None:
        require_one_kind(found)
    points, others = chosen(found, joints)
    notes = [*one_setting(found, points, as_stated=format_.as_stated), *found.notes]
    if kind.open_end:
        notes.append(f"{len(found.points)} points: nothing in such a file shows that it was cut, so count them")
    if others:
        notes.append(f"{UNUSED}{others if len(others) < TOLD else others[:TOLD].rpartition(',')[0] + ', ...'}")
    if points[0].joints:
        points, said = _joint_values(found, name, points, format_)
        notes += said
    how = f"{kind.title}, {len(points)} points"
    euler = format_.euler or ("" if points[0].joints else _order(found, name, points))
    return Program(
        raw=_raw(found, points, kind, how),
        format=replace(format_, euler=euler, robot="", units=""),
        notes=tuple(notes),
    )


HEAD = 100_000


def _order(found: Listed, name: str, points: Sequence[Point]) -> str:
    """Return the order of a kind's angles, '' where they are none. Raises Ambiguous where no source settles it."""
    kind = PROGRAMS[name]
    if name == "melfa":
        calls.require_six_axes(points, found.where)
    if kind.order != ASKED:
        return "" if kind.order in (QUATERNION, VECTOR) else kind.order
    likely = kind.likely.split()[0]
    if not about_z(points, likely):
        raise asked_order(found, kind.title, kind.likely)
    return likely


def _text(data: bytes, where: str) -> str:
    """Return a program's text; comments of controllers may be in a code page of theirs, numbers and names are not."""
    try:
        text = decoded(data, where)
    except BadFile:
        text = decoded(data.decode("latin-1").encode(), where)
    return text.replace("\r\n", "\n").replace("\r", "\n")


TOLD = 200
"""Letters of names that a note lists."""
UNUSED = "columns not used: "
"""How a note begins that names what is left unused; `kind_of_table` counts them."""


def _raw(found: Listed, points: Sequence[Point], kind: ProgramKind, how: str) -> RawTable:
    length, angle = kind.unit.split(", ")
    if points[0].joints:
        names = tuple(f"q{k}_{angle}" for k in range(1, 1 + len(points[0].joints)))
        rows = [point.joints for point in points]
    else:
        turn = {QUATERNION: ("qw", "qx", "qy", "qz"), VECTOR: tuple(f"rotvec_{axis}_{angle}" for axis in "xyz")}
        names = tuple(f"{axis}_{length}" for axis in "xyz")
        names += turn.get(kind.order, tuple(f"euler_{k}_{angle}" for k in (1, 2, 3)))
        rows = [(*point.xyz, *point.turn) for point in points]
    columns = tuple(list(column) for column in zip(*rows, strict=True))
    lines = _ascending([point.line for point in points])
    return RawTable(where=found.where, how=how, names=names, columns=columns, lines=lines, listed=True)


def _ascending(lines: Sequence[int]) -> tuple[int, ...]:
    """Return lines from the second on, each after the one before: several points may stand in one."""
    out: list[int] = []
    for line in lines:
        out.append(max(line, out[-1] + 1 if out else 2))
    return tuple(out)


def _joint_values(found: Listed, name: str, points: list[Point], format_: TableFormat) -> tuple[list[Point], list[str]]:
    """Return joint values between the links and in degrees, and what was done to them."""
    counts = {len(point.joints) for point in points}
    if len(counts) > 1:
        raise BadFile(f"{found.where}: joint values of {' and '.join(map(str, sorted(counts)))} joints in one program")
    if name == "fanuc":
        if 2 in format_.coupled:
            return points, ["J3 is taken as the arm's file has it: coupled to joint 2"]
        return [fanuc.between_links(point) for point in points], [fanuc.J3]
    if name != "jbi":
        return points, []
    kinds = {point.frame for point in points}
    if len(kinds) > 1:
        raise Inconsistent(
            f"{found.where}: positions in pulses and in degrees in one job",
            consequence="They cannot stand in one table",
            cure="Leave one of the two kinds in the file",
        )
    if kinds == {yaskawa.ANGLE}:
        return points, []
    ratios = pulses_per_degree(found.where, len(points[0].joints), format_)
    return [
        replace(point, joints=tuple(repr(float(cell) / r) for cell, r in zip(point.joints, ratios, strict=True)))
        for point in points
    ], [f"pulses per degree: {', '.join(f'{ratio:g}' for ratio in ratios)}"]


def pulses_per_degree(where: str, count: int, format_: TableFormat) -> tuple[float, ...]:
    """Return the pulses per degree of so many axes. Raises UsageError where they are not given for each."""
    ratios = format_.pulses
    if not ratios:
        raise UsageError(
            f"{where}: joint values in pulses, and how many pulses make a degree no job says",
            consequence="Without them they are no angles",
            cure="Give --pulses-per-degree S,L,U,R,B,T from the controller's parameters (negative where an axis counts "
            "against the arm's model)",
        )
    if len(ratios) != count:
        raise UsageError(
            f"{where}: {count} axes, and --pulses-per-degree gives {len(ratios)}",
            cure="Give one number for each axis",
        )
    return ratios


def pulse_table(raw: RawTable, format_: TableFormat) -> RawTable:
    """Return a table with columns S, L, U, R, B, T, which are pulses, in degrees; any other as it is.

    Raises UsageError for pulses without pulses per degree.
    """
    low = tuple(name.strip().lower() for name in raw.names)
    if low != yaskawa.AXES or format_.columns:
        return raw
    ratios = pulses_per_degree(raw.where, len(low), format_)
    columns = tuple(
        [repr(float(cell) / ratio) if is_number(cell) else cell for cell in column]
        for column, ratio in zip(raw.columns, ratios, strict=True)
    )
    names = tuple(f"q{k}_deg" for k in range(1, 1 + len(columns)))
    return RawTable(where=raw.where, how=f"{raw.how}, of pulses", names=names, columns=columns, lines=raw.lines)
