"""Robots' programs as their controllers write them, made of poses and joint values by formulas of this file alone."""

import numpy as np
from scipy.spatial.transform import Rotation

EULER = {"krl": "ZYX", "fanuc": "xyz", "jbi": "xyz", "as": "ZYZ", "val3": "XYZ", "pts": "ZYX", "melfa": "xyz"}
EULER |= {"denso": "xyz", "nachi": "ZYX", "drl": "ZYZ"}
PULSES = (1435.1, 1140.6, -957.2, 682.7, 682.7, 455.1)


def turned(name, rotation):
    """Angles in degrees as the maker orders them: products of turns about axes, written out."""
    return rotation.as_euler(EULER[name], degrees=True)


def rows_of(name, xyz_mm, rotation):
    return [(*p, *a) for p, a in zip(xyz_mm, turned(name, rotation), strict=True)]


def krl(rows, joints=()):
    lines = ["&ACCESS RVO", "DEFDAT  MEASURE PUBLIC"]
    for k, row in enumerate(rows, 1):
        cells = ",".join(f"{key} {value:.5f}" for key, value in zip("XYZABC", row, strict=True))
        lines.append(f"DECL E6POS XP{k}={{{cells},S 2,T 35,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}")
        lines.append(f'DECL FDAT FP{k}={{TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}}')
    for k, row in enumerate(joints, 1):
        cells = ",".join(f"A{j} {value:.5f}" for j, value in enumerate(row, 1))
        lines.append(f"DECL E6AXIS XJ{k}={{{cells},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}")
    return "\r\n".join([*lines, "ENDDAT", ""])


def fanuc(rows, joints=()):
    """Joint 3 against the horizontal, as a pendant shows it: the angle between the links less that of joint 2."""
    lines = ["/PROG  MEASURE", "/ATTR", "/MN", "   1:J P[1] 20% FINE    ;", "/POS"]
    for k, row in enumerate(rows, 1):
        x, y, z, w, p, r = (f"{value:.3f}" for value in row)
        lines += [f"P[{k}]{{", "   GP1:", "\tUF : 0, UT : 4,\t\tCONFIG : 'N U T, 0, 0, 0',"]
        lines += [f"\tX = {x}  mm,\tY = {y}  mm,\tZ = {z}  mm,", f"\tW = {w} deg,\tP = {p} deg,\tR = {r} deg"]
        lines += ["   GP2:", "\tUF : 0, UT : 4,\t", f"\tJ1= {6.2 + 0.03 * k:.3f} deg", "};"]
    for k, row in enumerate(joints, 1):
        shown = [*row[:2], row[2] - row[1], *row[3:]]
        cells = [f"J{j}= {value:9.3f} deg" for j, value in enumerate(shown, 1)]
        lines += [
            f"P[{k}]{{",
            "   GP1:",
            "\tUF : 0, UT : 4,\t",
            f"\t{',	'.join(cells[:3])},",
            f"\t{',	'.join(cells[3:])}",
            "};",
        ]
    return "\n".join([*lines, "/END", ""])


def rapid(xyz_mm, rotation, joints=()):
    nine = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
    lines = ["MODULE Measure", "  ! taught on Monday; [1,2,3] was before"]
    for k, (p, (x, y, z, w)) in enumerate(zip(xyz_mm, rotation.as_quat(), strict=True), 1):
        xyz = ",".join(f"{value:.3f}" for value in p)
        lines.append(f"  CONST robtarget p{k}:=[[{xyz}],[{w:.8f},{x:.8f},{y:.8f},{z:.8f}],[0,-1,0,1],{nine}];")
    for k, row in enumerate(joints, 1):
        lines.append(f"  CONST jointtarget j{k}:=[[{','.join(f'{value:.4f}' for value in row)}],{nine}];")
    lines.append("  PROC main()")
    lines += [f"    MoveL p{k},v100,fine,tPen\\WObj:=wobj0;" for k in range(1, len(xyz_mm) + 1)]
    return "\n".join([*lines, "  ENDPROC", "ENDMODULE", ""])


def jbi(rows, joints=(), pulses=None):
    count = len(rows) + len(joints)
    lines = ["/JOB", "//NAME MEASURE", "//POS", f"///NPOS {count},0,0,0,0,0"]
    if rows:
        lines += ["///TOOL 1", "///POSTYPE BASE", "///RECTAN", "///RCONF 0,0,0,0,0,0,0,0"]
        lines += [f"C{k:05}={','.join(f'{value:.4f}' for value in row)}" for k, row in enumerate(rows)]
    if joints:
        kind = "PULSE" if pulses else "ANGLE"
        lines += ["///TOOL 1", f"///POSTYPE {kind}", f"///{kind}"]
        scaled = [[round(v * p) for v, p in zip(row, pulses, strict=True)] if pulses else row for row in joints]
        lines += [
            f"C{k:05}={','.join(f'{value:g}' if pulses is None else str(value) for value in row)}"
            for k, row in enumerate(scaled)
        ]
    return "\r\n".join([*lines, "//INST", "///DATE 2026/01/05 10:00", "NOP", "MOVJ C00000 VJ=10.00", "END", ""])


def kawasaki(rows, joints=()):
    lines = [
        ".***** saved",
        ".TRANS",
        *(f"p{k} {' '.join(f'{v:.6f}' for v in row)}" for k, row in enumerate(rows)),
        ".END",
    ]
    if joints:
        lines += [".JOINTS", *(f"#j{k} {' '.join(f'{v:.6f}' for v in row)}" for k, row in enumerate(joints)), ".END"]
    return "\n".join([*lines, ""])


def val3(rows, joints=()):
    head = '<?xml version="1.0" encoding="utf-8" ?>\n<Database xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
    head += 'xmlns="http://www.staubli.com/robotics/VAL3/Data/2">\n<Datas>\n'
    keys = ("x", "y", "z", "rx", "ry", "rz")
    cells = [" ".join(f'{key}="{value:.4f}"' for key, value in zip(keys, row, strict=True)) for row in rows]
    points = "\n".join(f'<Value key="{k}" {cell} fatherId="world[0]" />' for k, cell in enumerate(cells))
    body = f'<Data name="p" access="public" xsi:type="array" type="pointRx" size="{len(rows)}">\n{points}\n</Data>\n'
    if joints:
        cells = [" ".join(f'j{j}="{value:.4f}"' for j, value in enumerate(row, 1) if value) for row in joints]
        values = "\n".join(f'<Value key="{k}" {cell} />' for k, cell in enumerate(cells))
        body = f'<Data name="j" xsi:type="array" type="jointRx" size="{len(joints)}">\n{values}\n</Data>\n'
    return f"{head}{body}</Datas>\n</Database>\n"


def pts(rows, joints=()):
    lines = ['sVersion="2.0.0"', "nNumberOfJoints=6", f"nNumberOfPoints={len(rows)}"]
    for k, row in enumerate(rows):
        cells = [f"\tr{key}={value:.3f}" for key, value in zip("XYZUVW", row, strict=True)]
        lines += [
            f"Point{k + 1} {{",
            f"\tnNumber={k}",
            f'\tsLabel="P{k}"',
            "\tnUndefined=0",
            *cells,
            "\trR=0",
            "\tnLocal=0",
            "}",
        ]
    return "\n".join([*lines, ""])


def melfa(rows, joints=()):
    lines = ["1 Servo On", "2 Mov P1"]
    lines += [f"P{k}=({','.join(f'{v:+.4f}' for v in row)})(7,0)" for k, row in enumerate(rows, 1)]
    return "\n".join([*lines, *(f"J{k}=({','.join(f'{v:+.4f}' for v in row)})" for k, row in enumerate(joints, 1)), ""])


def denso(rows, joints=()):
    moves = [f"  MOVE L, @0 P({','.join(f'{v:.4f}' for v in row)}, 5), Speed=20" for row in rows]
    moves += [f"  MOVE P, @0 J({','.join(f'{v:.4f}' for v in row)})" for row in joints]
    return "\n".join(["Sub Main", "' P(1,2) was before", *moves, "End Sub", ""])


def nachi(rows, joints=()):
    moves = [f"MOVEX A=1,M1X,L,({','.join(f'{v:.4f}' for v in row)}),S=100.0,H=1,MS" for row in rows]
    return "\n".join(
        [*moves, *(f"MOVEX M1J,P,({','.join(f'{v:.4f}' for v in row)}),S=1.0,H=1,MS" for row in joints), "END", ""]
    )


def drl(rows, joints=()):
    moves = [f"movel(posx({', '.join(f'{v:.4f}' for v in row)}), ref=DR_BASE)" for row in rows]
    return "\n".join(
        ['set_tcp("pen")', *moves, *(f"movej(posj({', '.join(f'{v:.4f}' for v in row)}))" for row in joints), ""]
    )


def urscript(xyz_mm, rotation, joints=()):
    lines = ["def measure():", "  set_tcp(p[0, 0, 0.1, 0, 0, 0])", "  global Plane_1=p[9, 9, 9, 0, 0, 0]"]
    for k, (p, r) in enumerate(zip(xyz_mm / 1e3, rotation.as_rotvec(), strict=True), 1):
        lines += [
            f"  global Waypoint_{k}_p=p[{', '.join(f'{v:.7f}' for v in (*p, *r))}]",
            f"  movel(Waypoint_{k}_p, a=1)",
        ]
    lines += [f"  movej([{', '.join(f'{v:.7f}' for v in np.deg2rad(row))}], a=1, v=1)" for row in joints]
    return "\n".join([*lines, "end", ""])


def gcode(rows, joints=()):
    lines = ["( measure )", "G21 G90 G94 G61.1"]
    lines += [f"G53 G1 {' '.join(f'{k}{v:.5f}' for k, v in zip('XYZABC', row, strict=True))} F300" for row in rows]
    return "\n".join([*lines, "M2", ""])


EULER["gcode"] = "xyz"
OF_ROWS = {"krl": krl, "fanuc": fanuc, "jbi": jbi, "as": kawasaki, "val3": val3, "pts": pts, "melfa": melfa}
OF_ROWS |= {"denso": denso, "nachi": nachi, "drl": drl, "gcode": gcode}
OF_POSES = {"rapid": rapid, "urscript": urscript}


def written(name, xyz_mm, rotation):
    """A program of poses."""
    if name in OF_POSES:
        return OF_POSES[name](xyz_mm, rotation)
    return OF_ROWS[name](rows_of(name, xyz_mm, rotation))


def written_joints(name, q_deg):
    """A program of joint values."""
    rows = [list(row) for row in q_deg]
    if name in OF_POSES:
        return OF_POSES[name](np.empty((0, 3)), Rotation.from_quat(np.empty((0, 4))), rows)
    return OF_ROWS[name]([], rows)
