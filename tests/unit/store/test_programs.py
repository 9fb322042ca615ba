"""Robots' own programs as lists of poses and joint values: each form, what path export writes, hostile files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard import Limits
from armsight.control.guard.limits import joint_bounds
from armsight.control.paths import Program, program_moves
from armsight.control.paths import krl as to_krl
from armsight.control.paths import rapid as to_rapid
from armsight.control.paths import urscript as to_ur
from armsight.control.paths.exports import gcode
from armsight.control.paths.linuxcnc import Axes, plan_lines
from armsight.errors import Ambiguous, ArmsightError, BadFile, DataRefused, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Coupling, in_convention, preset
from armsight.ops.tables import convert_table
from armsight.records import TaughtPath
from armsight.store.interpret import TableFormat
from armsight.store.programs import PROGRAMS, kind_of
from program_writers import (
    OF_ROWS,
    PULSES,
    jbi,
    kawasaki,
    krl,
    rapid,
    rows_of,
    turned,
    written,
    written_joints,
)
from public_files import public_file

KEYS = ("x", "y", "z", "rx", "ry", "rz")
ASKED = {"pts": "zyx", "denso": "xyz-fixed"}


def world(seed=3, n=12):
    rng = np.random.default_rng(seed)
    xyz_mm = np.round(rng.uniform((300, -500, 50), (900, 500, 900), (n, 3)), 3)
    q_deg = np.round(rng.uniform(-1, 1, (n, 6)) * (150, 60, 60, 170, 100, 170), 3)
    return xyz_mm, Rotation.random(n, rng=rng), q_deg


def read(folder, text, kind, **said):
    path = folder / "program.txt"
    path.write_bytes(text.encode())
    done = convert_table(path, kind=kind, format_=TableFormat(**said))
    rows = [line.split(",") for line in done.content.splitlines()]
    return done, {name: np.array([float(row[k]) for row in rows[1:]]) for k, name in enumerate(rows[0])}


def poses_of(columns):
    xyz_mm = np.stack([columns[f"{axis}_m"] for axis in "xyz"], axis=1) * 1e3
    return xyz_mm, Rotation.from_quat(np.stack([columns[f"q{axis}"] for axis in "xyzw"], axis=1))


@pytest.mark.parametrize("name", PROGRAMS)
def test_poses_come_back_as_the_controller_has_them(name, tmp_path):
    xyz_mm, rotation, _ = world()
    text = written(name, xyz_mm, rotation)
    assert kind_of(text) == name
    done, columns = read(tmp_path, text, "poses", euler=ASKED.get(name, ""))
    assert done.n == len(xyz_mm)
    assert PROGRAMS[name].title in done.how
    found_mm, found = poses_of(columns)
    assert np.abs(found_mm - xyz_mm).max() < 1e-3  # the digits that each writes
    assert np.rad2deg((found.inv() * rotation).magnitude()).max() < 2e-3


@pytest.mark.parametrize("name", [name for name in PROGRAMS if name not in ("pts", "gcode")])
def test_joint_values_come_back(name, tmp_path):
    q_deg = world()[2]
    done, columns = read(tmp_path, written_joints(name, q_deg), "joints")
    found = np.rad2deg(np.stack([columns[f"q{k}"] for k in range(1, 7)], axis=1))
    assert np.abs(found - q_deg).max() < 6e-4  # FANUC shows three decimals
    assert ("J3 + J2" in " ".join(done.notes)) == (name == "fanuc")


def test_a_pendant_s_joint_3_is_the_one_of_a_published_case(tmp_path):
    """fanuc_experimental #17: pendant J3 -33.342 deg, joint_states joint_2 0.5467115640640259, joint_3 -0.0352149."""
    j2 = np.rad2deg(0.5467115640640259)
    values = f"J1= 0.0 deg, J2= {j2:.9f} deg, J3= -33.342 deg,\n J4= 1.0 deg, J5= 2.0 deg, J6= 3.0 deg"
    text = f"/PROG  A\n/POS\nP[1]{{\n   GP1:\n UF : 0, UT : 1,\n {values}\n}};\n/END\n"
    _, columns = read(tmp_path, text, "joints")
    assert columns["q3"][0] == pytest.approx(-0.035214900970458984, abs=1e-5)


def test_joint_3_stays_for_an_arm_whose_file_couples_it(tmp_path):
    arm = preset("irb120")
    coupled = replace(arm, couplings=(Coupling(joint=arm.joints[2].name, by=arm.joints[1].name, share=1.0),))
    path = tmp_path / "a.ls"
    q_deg = world()[2]
    path.write_text(written_joints("fanuc", q_deg))
    done = convert_table(path, kind="joints", arm=coupled)
    third = [float(line.split(",")[3]) for line in done.content.splitlines()[1:]]
    assert np.rad2deg(third) == pytest.approx(q_deg[:, 2] - q_deg[:, 1], abs=6e-4)


def test_comments_may_be_in_a_controller_s_code_page(tmp_path):
    xyz_mm, rotation, _ = world()
    text = written("krl", xyz_mm, rotation).replace("DEFDAT", "; Meßpunkte für Zelle 3\r\nDEFDAT", 1)
    path = tmp_path / "points.dat"
    path.write_bytes(text.encode("latin-1"))
    assert convert_table(path, kind="poses").n == len(xyz_mm)


def test_pulses_are_degrees_by_the_numbers_given(tmp_path):
    q_deg = world()[2]
    text = jbi([], [list(row) for row in q_deg], PULSES)
    _, columns = read(tmp_path, text, "joints", pulses=PULSES)
    found = np.rad2deg(np.stack([columns[f"q{k}"] for k in range(1, 7)], axis=1))
    assert (np.abs(found - q_deg) <= 0.51 / np.abs(PULSES)).all()
    with pytest.raises(UsageError, match="pulses"):
        read(tmp_path, text, "joints")
    with pytest.raises(UsageError, match="gives 2"):
        read(tmp_path, text, "joints", pulses=PULSES[:2])
    pulses = "S,L,U,R,B,T\n" + "\n".join(",".join(map(str, np.round(row * PULSES).astype(int))) for row in q_deg)
    _, table = read(tmp_path, pulses, "joints", pulses=PULSES)
    assert table["q6"] == pytest.approx(columns["q6"])
    with pytest.raises(UsageError, match="pulses"):
        read(tmp_path, pulses, "joints")


def test_rsi_is_read_with_its_times(tmp_path):
    xyz_mm, rotation, q_deg = world()
    abc = rotation.as_euler("ZYX", degrees=True)
    packets = "\n".join(
        '<Rob Type="KUKA"><RIst X="{:.4f}" Y="{:.4f}" Z="{:.4f}" A="{:.4f}" B="{:.4f}" C="{:.4f}"/>'.format(*p, *a)
        + '<RSol X="0" Y="0" Z="0" A="0" B="0" C="0"/>'
        + "<AIPos {}/><IPOC>{}</IPOC></Rob>".format(" ".join(f'A{j}="{v}"' for j, v in enumerate(q, 1)), 4000 + 4 * k)
        for k, (p, a, q) in enumerate(zip(xyz_mm, abc, q_deg, strict=True))
    )
    names = [f"RIst.{k}" for k in "XYZABC"] + [f"AIPos.A{k}" for k in range(1, 7)] + ["IPOC"]
    rows = [",".join(f"{v:.4f}" for v in (*p, *a, *q)) for p, a, q in zip(xyz_mm, abc, q_deg, strict=True)]
    table = ",".join(names) + "\n" + "\n".join(f"{row},{4000 + 4 * k}" for k, row in enumerate(rows))
    for text in (packets, table):
        _, columns = read(tmp_path, text, "poses")
        found_mm, found = poses_of(columns)
        assert np.abs(found_mm - xyz_mm).max() < 1e-3
        assert (found.inv() * rotation).magnitude().max() < 1e-5
        assert np.diff(columns["t_s"]) == pytest.approx(0.004)
        assert np.rad2deg(read(tmp_path, text, "joints")[1]["q2"]) == pytest.approx(q_deg[:, 1], abs=1e-3)
    with pytest.raises(BadFile, match="not complete"):
        read(tmp_path, packets[:-20], "poses")


def refused(folder, text, error, match, kind="poses", **said):
    with pytest.raises(error, match=match) as found:
        read(folder, text, kind, **said)
    assert found.value.cure


def test_what_a_program_leaves_open_is_refused(tmp_path):
    xyz_mm, rotation, q_deg = world()
    text = written("krl", xyz_mm, rotation)
    refused(tmp_path, text.replace("TOOL_NO 1", "TOOL_NO 2", 1), Inconsistent, "2 tools")
    refused(tmp_path, text.replace("BASE_NO 0", "BASE_NO 3", 1), Inconsistent, "2 frames")
    refused(tmp_path, text.replace("#BASE", "#TCP", 1), Inconsistent, "outside the arm")
    refused(tmp_path, re.sub(r"Y -?[\d.]+,", "", text, count=1), Inconsistent, "has no Y")
    refused(tmp_path, text.replace("E1 0.0", "E1 500.0", 1), Inconsistent, "outer axis 1")
    assert read(tmp_path, text.replace("E1 0.0", "E1 500.0", 1), "poses", as_stated=True)[0].n == len(xyz_mm)
    refused(tmp_path, text.replace("ENDDAT", ""), BadFile, "without ENDDAT")
    refused(tmp_path, re.sub(r"X (-?\d+)\.", r"X \1,", text, count=1), BadFile, "decimal commas")
    refused(tmp_path, text, NotEnoughData, "are poses", kind="joints")
    refused(tmp_path, text, UsageError, "--columns", columns="x,y,z")
    refused(tmp_path, written("pts", xyz_mm, rotation), Ambiguous, "--euler|order")
    refused(tmp_path, written("denso", xyz_mm, rotation), Ambiguous, "order")
    both = krl(rows_of("krl", xyz_mm, rotation), [list(row) for row in q_deg])
    refused(tmp_path, both, Ambiguous, "12 points are joint values", kind=None)
    assert read(tmp_path, both, "joints")[0].n == read(tmp_path, both, "poses")[0].n == len(q_deg)
    used = rapid(xyz_mm, rotation)
    refused(tmp_path, used.replace("tPen", "tGun", 1), Inconsistent, "2 tools")
    refused(tmp_path, used.replace("\\WObj:=wobj0", "\\WObj:=wTable", 1), Inconsistent, "2 frames")
    refused(tmp_path, used.replace("ENDMODULE", ""), BadFile, "ENDMODULE")
    job = written("jbi", xyz_mm, rotation)
    refused(tmp_path, job.replace("///NPOS 12", "///NPOS 13"), BadFile, "NPOS")
    refused(tmp_path, job.replace("POSTYPE BASE", "POSTYPE PULSE"), Inconsistent, "RECTAN under")
    refused(tmp_path, written("fanuc", xyz_mm, rotation).replace("/END", ""), BadFile, "/END")
    refused(tmp_path, kawasaki(rows_of("as", xyz_mm, rotation)).replace(".END", ""), BadFile, "[.]END")
    refused(tmp_path, written("gcode", xyz_mm, rotation).replace("G21", "G20"), Inconsistent, "mm")


def test_positions_never_taught_are_named_and_left_out(tmp_path):
    xyz_mm, rotation, _ = world()
    text = written("fanuc", xyz_mm, rotation)
    stars = re.sub(r"(P\[3\]\{.*?X =) +[-\d.]+", r"\1 ********", text, count=1, flags=re.DOTALL)
    done, columns = read(tmp_path, stars, "poses")
    assert done.n == len(xyz_mm) - 1
    assert any("P[3]" in note for note in done.notes)
    assert poses_of(columns)[0] == pytest.approx(np.delete(xyz_mm, 2, axis=0), abs=1e-3)


def seam(n=9):
    """A path of n poses, its tool turning, as a program of straight motions."""
    s = np.linspace(0.0, 1.0, n)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 3] = np.stack([0.45 + 0.1 * s, -0.2 + 0.3 * s, 0.35 + 0.05 * s], axis=1)
    T[:, :3, :3] = Rotation.from_euler("xyz", np.stack([170 + 10 * s, 5 * s, 20 * s], axis=1), degrees=True).as_matrix()
    return T


@pytest.mark.parametrize(
    ("write", "position", "angle"), [(to_krl, 5e-8, 2e-6), (to_rapid, 5e-8, 3e-9), (to_ur, 6e-7, 2e-6)]
)
def test_what_path_export_writes_is_read_back(write, position, angle, tmp_path):
    """Poses equal to the digits written: 1e-4 mm and 1e-4 deg, nine digits of a quaternion, 1e-6 m and rad."""
    T = seam()
    path = TaughtPath.of_poses(RigidTransform.from_matrix(T), parent="base")
    start = np.deg2rad([0, -90, 90, 0, 45, 0.0])
    program = Program(
        name="seam",
        moves=program_moves(path, speed_m_s=0.05, blend_m=0.005),
        acceleration_m_s2=0.5,
        turn_rad_s=1.0,
        tool="tPen" if write is to_rapid else "3",
        start=start,
    )
    text = write(program)
    done, columns = read(tmp_path, text, None)
    xyz_mm, found = poses_of(columns)
    assert done.kind == "poses"
    assert len(xyz_mm) == len(T) - 1  # the first one is gone to by its joints
    assert np.abs(xyz_mm - 1e3 * T[1:, :3, 3]).max() <= 1e3 * position
    assert (found.inv() * Rotation.from_matrix(T[1:, :3, :3])).magnitude().max() < angle
    _, joints = read(tmp_path, text, "joints")
    assert [joints[f"q{k}"][0] for k in range(1, 7)] == pytest.approx(start, abs=2e-6)


def test_g_code_for_linuxcnc_is_read_back(tmp_path):
    arm, q = preset("irb120"), np.array([0.1, 0.2, -0.1, 0.3, 0.8, 0.2])
    T = np.tile(arm.fk(q), (5, 1, 1))
    T[:, 0, 3] += np.linspace(0.0, 0.04, 5)
    moves = program_moves(
        TaughtPath.of_poses(RigidTransform.from_matrix(T), parent="base"), speed_m_s=0.05, blend_m=0.0
    )
    axes = Axes(acceleration_m_s2=0.5, acceleration_rad_s2=np.pi)
    plan = plan_lines(moves, arm, arm, axes, q, 1.0)
    text = gcode("seam", plan, in_convention(arm, "craig"), axes, joint_bounds(arm, Limits()), None)
    _, columns = read(tmp_path, text, "poses")
    xyz_mm, found = poses_of(columns)
    assert xyz_mm == pytest.approx(np.array([line.xyz_m for line in plan.lines]) * 1e3, abs=6e-6)
    asked = Rotation.from_euler("xyz", [line.abc_rad for line in plan.lines])
    assert (found.inv() * asked).magnitude().max() < 3e-7


HAND_EYE = ("GilbertPan97/HandEyeSync", "70bc59e4e59322effd72456b15f341371c4b03b6")
KUKA = ("ajithmuthuswamy/KUKA_KR4R600_Plotter", "9469ae02")
ABB = ("dkaynarc/tmc", "aa948a31")
CHESS = ("ThenesVara/Checkers_Staubli", "8cf35682")
MODULES, APPLICATIONS = "src/cluster/Tmc/Robotics/mod", "SRS environnement/Controller1/usr/usrapp"
PUBLIC = (
    (*HAND_EYE, "data/LeiChi-04.25/camera1/calib_c1.ls", "poses", 28, "frame UF 0"),
    (*HAND_EYE, "data/LeiChi-12.22/sphere/cam0/calib_0.ls", "poses", 18, "tool UT 0"),
    (
        "JuniorNatalin/VASC",
        "02f99794238f333324a4c319c7bfa7bde4e3fd9b",
        "BVTU/Backups/07.10.24/KJBVTU211160R01/ENGLISH/UP001.LS",
        "poses",
        86,
        "other machines, not used: 2, 3, 4",
    ),
    (
        "dm-bogachev/SW002-LoadWizardPro_v2",
        "c6953743f6c9d17263ad845a993516ff6d8e5c88",
        "Робот/LoadWizard_example.as",
        "joints",
        84,
        "columns not used",
    ),
    ("nguyen1024/rs005la", "9cb5744c", "rs005la.as", "poses", 1132, "may hold tools"),
    (*KUKA, "results/elephant.dat", "poses", 58, "zyx-rotating"),
    (*KUKA, "results/batman.dat", "poses", 90, "zyx-rotating"),
    (*ABB, f"{MODULES}/LoaderGrabTray1.mod", "joints", 10, "6 joints in degrees"),
    (*ABB, f"{MODULES}/BaseRobotHomePosition.mod", "joints", 1, "6 joints in degrees"),
    (
        *("evamatvi/Staubli-TX60-Assembly-with-VAL3", "6d6163ec"),
        "src/Controller-TX60/usr/usrapp/NovaAplicacio/NovaAplicacio.dtx",
        "poses",
        5,
        "frame world",
    ),
    (*CHESS, f"{APPLICATIONS}/_Chessie/_Chessie.dtx", "poses", 4, "taken as mm"),
    (*CHESS, f"{APPLICATIONS}/ROBERT_TP6/ROBERT_TP6.dtx", "joints", 2, "taken as mm"),
    ("dmassic/20211029---GIT-Folder", "1717b413", "A-4-08279-80-0-L.JBI", "poses", 53, "frame USER 14"),
    ("danvoell/pickandplace", "4ed0c477", "robot1.pts", "poses", 2, "frame Local 0"),
    ("timo-wisematic/Epson-VisionTest-AutoFollow", "3f74afee", "robot1.pts", "poses", 5, "frame Local 0"),
    ("AgniechaP/EPSON_writing_text", "20e828fb", "robot1.pts", "poses", 1, "frame Local 0"),  # 309 are not taught
    ("paulbarron85/Doosan-MachineMotion_Comms", "4e4903ef", "main.drl", "joints", 2, "in degrees"),
    ("paulbarron85/Doosan-MachineMotion_Comms", "4e4903ef", "main.drl", "poses", 2, "zyz-rotating"),
)
"""Files of laboratories: repository, commit, path, kind, points, and what is said of it."""


def test_relative_movements_of_a_doosan_are_no_positions(tmp_path):
    text = "p1 = posx(400, 100, 300, 10, 179, 20)\nstep = posx(0, -100, 0, 0, 0, 0)\nmovel(p1)\n"
    text += "movel(step, v=50, mod=DR_MV_MOD_REL)\nmovel(posx(0, 0, 50, 0, 0, 0), mod = 1)\n"
    text += "movel(posx(400, 200, 300, 10, 179, 20), mod=DR_MV_MOD_ABS)\n"
    done, columns = read(tmp_path, text, "poses")
    assert columns["y_m"].tolist() == [0.1, 0.2]
    assert any("2 relative movements" in note for note in done.notes)


def test_angles_of_a_scara_have_any_order(tmp_path):
    xyz_mm, _, _ = world()
    yaw = Rotation.from_euler("z", np.linspace(-170.0, 170.0, len(xyz_mm))[:, None], degrees=True)
    for name in ("pts", "denso"):
        _, columns = read(tmp_path, written(name, xyz_mm, yaw), "poses")
        assert np.rad2deg((poses_of(columns)[1].inv() * yaw).magnitude()).max() < 2e-3
    down = Rotation.from_euler("x", 180.0, degrees=True) * yaw
    refused(tmp_path, written("denso", xyz_mm, down), Ambiguous, "--euler")


@pytest.mark.parametrize(("repo", "commit", "path", "kind", "n", "note"), PUBLIC)
def test_public_programs(repo, commit, path, kind, n, note, tmp_path):
    file = tmp_path / Path(path).name
    file.write_bytes(public_file(repo, commit, path))
    done = convert_table(file, kind=kind)
    assert done.n == n
    assert any(note in one for one in done.notes)


@pytest.mark.parametrize(
    ("repo", "commit", "path", "says"),
    [
        ("DanielPaans/SMR1", "790397cc", "abb_robot_code/Module1.mod", "tools in one program"),
        ("wsierrad/Lab5_Robotica", "b737ac69", "Module1_2_Tarea1.mod", "tools in one program"),
        ("wsierrad/Lab5_Robotica", "b737ac69", "Module1_Tarea2.mod", "frames in one program"),
        (*CHESS, f"{APPLICATIONS}/AA_Chessie/AA_Chessie.dtx", "frames in one program"),
        ("lukelalondePZ/Fiberdome-GP88-Spindle-Cell", "0cdfdce5", "TRIAL.JBI", "12 points are joint values"),
        ("icegabri/doosan_polimi", "d91e1a0e", "controller.drl", "sets 3 of its tools"),
        ("dongfan/Doosan_DRL", "ddcf5fb6", "Test_Force/main.drl", "without a pose"),  # relative movements alone
        ("Rodchi/_Mitsubishi_Melfa_RV_2AJ", "51d9de85", "RECWMC.POS", "five axes"),
        ("Yassate/KRL_Parser", "c509a3e8", "codeRepo/testFiles/oldFiles/exampleKukaPath.dat", "another order"),
    ],
)
def test_public_programs_that_leave_open_what_they_mean_are_refused(repo, commit, path, says, tmp_path):
    refused(tmp_path, public_file(repo, commit, path).decode("utf-8-sig", errors="replace"), ArmsightError, says)


def test_the_older_data_of_staublis_is_read_as_the_newer(tmp_path):
    xyz_mm, rotation, q_deg = world()
    points = "".join(
        f'<point name="p{k}" public="false"><pFather alias="" name="world" fatherIndex="0" /><valuePoint index="0">'
        + "<tpValue {} />".format(" ".join(f'{key}="{cell:.6f}"' for key, cell in zip(KEYS, row, strict=True)))
        + '<cpValue shoulder="ssame" /></valuePoint></point>\n'
        for k, row in enumerate(rows_of("val3", xyz_mm, rotation))
    )
    joints = "".join(
        f'<joint name="t{k}"><valueJoint index="0">'
        + "<jointValue {} />".format(" ".join(f'j{j}="{cell:.6f}"' for j, cell in enumerate(row, 1)))
        + "</valueJoint></joint>\n"
        for k, row in enumerate(q_deg)
    )
    tool = '<toolSection><tool name="flange"><valueTool index="0"><ttValue x="1" y="2" z="3" /></valueTool></tool>'
    text = (
        f'<?xml version="1.0"?>\n<dataList xmlns="DataNameSpace">\n<jointSection>{joints}</jointSection>'
        f"<pointSection>\n{points}</pointSection>{tool}</toolSection></dataList>"
    )
    done, columns = read(tmp_path, text, "poses")
    found_mm, found = poses_of(columns)
    assert done.n == len(xyz_mm)
    assert np.abs(found_mm - xyz_mm).max() < 1e-3
    assert (found.inv() * rotation).magnitude().max() < 1e-6
    assert np.rad2deg(read(tmp_path, text, "joints")[1]["q2"]) == pytest.approx(q_deg[:, 1], abs=1e-5)
    refused(tmp_path, re.sub(r' ry="[-\d.]+"', "", text, count=1), BadFile, "is no number")
    refused(tmp_path, text.replace('name="world"', 'name="table"', 1), Inconsistent, "2 frames")
    refused(tmp_path, text[:-60], BadFile, "no complete XML")


def cut(text, rng):
    return text[: int(rng.integers(len(text) // 3, len(text) - 3))]


def commas(text, rng):
    return re.sub(r"(\d)\.(\d)", r"\1,\2", text)


def one_comma(text, rng):
    places = [m.start() for m in re.finditer(r"(?<=\d)\.(?=\d)", text)]
    at = places[int(rng.integers(len(places) // 3, len(places)))]
    return f"{text[:at]},{text[at + 1 :]}"


def word(text, rng):
    """A number that is none."""
    places = list(re.finditer(r"(?<![\d.])-?\d{1,3}\.\d{3,}", text))
    at = places[int(rng.integers(len(places)))]
    return text[: at.start()] + "nan12" + text[at.end() :]


def dropped(text, rng):
    """A number less."""
    places = list(re.finditer(r"[, ]-?\d{2,3}\.\d{3,}(?=[,\]) ])", text))
    if not places:
        return cut(text, rng)
    at = places[int(rng.integers(len(places)))]
    return text[: at.start()] + text[at.end() :]


def radians(rng, name, xyz_mm):
    """Angles in radians, where degrees are meant."""
    small = Rotation.from_euler("xyz", rng.uniform(-0.9, 0.9, (len(xyz_mm), 3)))
    rows = [(*p, *np.deg2rad(a)) for p, a in zip(xyz_mm, turned(name, small), strict=True)]
    return OF_ROWS[name](rows)


SPOILED = {"cut": cut, "commas": commas, "one comma": one_comma, "word": word, "dropped": dropped}


@pytest.mark.parametrize("seed", range(65))
def test_no_spoiled_program_is_read_wrong(seed, tmp_path):
    """Either refused with a cure, or each pose as it was."""
    rng = np.random.default_rng(seed)
    name = list(PROGRAMS)[seed % len(PROGRAMS)]
    how = list(SPOILED)[seed // len(PROGRAMS) % len(SPOILED)]
    xyz_mm, rotation, _ = world(seed)
    text = SPOILED[how](written(name, xyz_mm, rotation), rng)
    try:
        done, columns = read(tmp_path, text, "poses", euler=ASKED.get(name, ""))
    except ArmsightError as error:
        assert isinstance(error, DataRefused | UsageError)
        assert error.cure, error
        return
    found_mm, found = poses_of(columns)
    cut_off = how == "cut" and any("was cut, so count" in note for note in done.notes)
    assert done.n == len(xyz_mm) or cut_off, f"{name} {how}: points are missing without a word"
    assert np.abs(found_mm - xyz_mm[: done.n]).max() < 1e-3, f"{name} {how}"
    assert (found.inv() * rotation[: done.n]).magnitude().max() < 1e-4, f"{name} {how}"


@pytest.mark.parametrize("name", [name for name in PROGRAMS if name not in ("rapid", "urscript")])
def test_radians_for_degrees_are_refused(name, tmp_path):
    rng = np.random.default_rng(5)
    text = radians(rng, name, world()[0])
    refused(tmp_path, text, Inconsistent, "look like radians", euler=ASKED.get(name, ""))
