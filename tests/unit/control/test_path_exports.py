"""Programs for controllers: numbers worked out by hand, and read back by small parsers that share no code with them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.paths import Program, krl, program_moves, python_module, rapid, urscript, with_approach
from armsight.errors import Inconsistent, UsageError
from armsight.records import TaughtPath

XYZ = [[0.4, 0.0, 0.2], [0.4, 0.1, 0.2], [0.404, 0.1, 0.2], [0.4, 0.1, -0.25]]
HALF = math.sqrt(0.5)
# identity; 90 deg about z; 30 deg about y; 90 deg about z, then 30 deg about the new y:
# (c, 0, 0, c) (cos 15, 0, sin 15, 0) = (c cos 15, -c sin 15, c sin 15, c cos 15), c = 0.70710678
QUAT_WXYZ = [
    [1, 0, 0, 0],
    [HALF, 0, 0, HALF],
    [0.965925826, 0, 0.258819045, 0],
    [0.683012702, -0.183012702, 0.183012702, 0.683012702],
]


def example(**more):
    turns = Rotation.from_quat(QUAT_WXYZ, scalar_first=True)
    path = TaughtPath.of_poses(RigidTransform.from_components(XYZ, turns), parent="base")
    return replace(
        path, speed_m_s=np.array([0.1, np.nan, 0.02, np.nan]), tags=("weld_on", "", "mark", "weld_off"), **more
    )


def program(path=None, **more):
    moves = program_moves(example() if path is None else path, speed_m_s=0.05, blend_m=0.005)
    return Program(
        **{"name": "seam", "moves": moves, "acceleration_m_s2": 0.5, "turn_rad_s": math.pi / 3, "tool": "1", **more}
    )


def test_speeds_are_those_of_the_way_there_and_blends_end_before_the_neighbours():
    moves = program_moves(replace(example(), tags=("",) * 4), speed_m_s=0.05, blend_m=0.005)
    assert [move.speed_m_s for move in moves] == [0.1, 0.1, 0.05, 0.02]
    # ways of 0.1, 0.004 and 0.45 m: 0.45 of the shorter one beside a row, 0.0018 m; none at the ends
    assert [move.blend_m for move in moves] == pytest.approx([0.0, 0.0018, 0.0018, 0.0])
    assert program_moves(example(), speed_m_s=0.05, blend_m=0.005)[2].blend_m == 0.0  # at a tag
    assert program_moves(example(), speed_m_s=0.05, blend_m=0.005, stops=(1,))[1].blend_m == 0.0


URSCRIPT = """\
def seam():
  # Poses are of the tool's tip in the base frame, m and rad.
  set_tcp(p[0.000000, 0.000000, 0.150000, 0.000000, 0.000000, 0.000000])
  movel(p[0.400000, 0.000000, 0.200000, 0.000000, 0.000000, 0.000000], a=0.5, v=0.1, r=0.000000)
  set_standard_digital_out(3, True)
  movel(p[0.400000, 0.100000, 0.200000, 0.000000, 0.000000, 1.570796], a=0.5, v=0.1, r=0.001800)
  movel(p[0.404000, 0.100000, 0.200000, 0.000000, 0.523599, 0.000000], a=0.5, v=0.05, r=0.000000)
  # mark
"""


def test_urscript():
    tool = RigidTransform.from_translation([0.0, 0.0, 0.15])
    assert urscript(program(weld_output="3", T_flange_tool=tool)).startswith(URSCRIPT)


KRL = """\
&ACCESS RVP
DEF seam()
; Poses are of the tool's tip in the robot's base ($ROBROOT), mm and degrees.
; TOOL_DATA[1] must be the tool the path was taught with.
BAS(#INITMOV,0)
BAS(#VEL_PTP,10)
BAS(#ACC_PTP,10)
$BASE=$ROBROOT
$TOOL=TOOL_DATA[1]
$ACC.CP=0.5
$VEL.ORI1=60
$VEL.ORI2=60
PTP {A1 0.0000,A2 -90.0000,A3 90.0000,A4 0.0000,A5 45.0000,A6 0.0000}
; weld_on
$VEL.CP=0.1
$APO.CDIS=1.8000
LIN {X 400.0000,Y 100.0000,Z 200.0000,A 90.0000,B 0.0000,C 0.0000} C_DIS
$VEL.CP=0.05
LIN {X 404.0000,Y 100.0000,Z 200.0000,A 0.0000,B 30.0000,C 0.0000}
; mark
$VEL.CP=0.02
LIN {X 400.0000,Y 100.0000,Z -250.0000,A 90.0000,B 30.0000,C 0.0000}
; weld_off
END
"""


def test_krl():
    start = np.array([0.0, -0.5, 0.5, 0.0, 0.25, 0.0]) * math.pi
    assert krl(program(start=start)).replace("\r\n", "\n") == KRL


RAPID = """\
MODULE seam_module
  ! Poses are of the tool's tip in wobj0, mm; quaternions have w first.
  ! wobj0 must be the robot's base: no base frame moved in the controller.
  ! torch must be [TRUE,[[0.0000,0.0000,150.0000],[1.000000000,0.000000000,0.000000000,0.000000000]], ...]
  PROC seam()
    ConfJ\\Off;
    ConfL\\Off;
    MoveAbsJ [[0.0000,-90.0000,90.0000,0.0000,45.0000,0.0000],AXES],[50.000,11.459,5000,1000],fine,torch;
    SetDO arc,1;
    MoveL [[400.0000,100.0000,200.0000],[0.707106781,0.000000000,0.000000000,0.707106781],[0,0,0,0],AXES],\
[100.000,60.000,5000,1000],[FALSE,1.8000,2.7000,2.7000,0.2700,2.7000,0.2700],torch\\WObj:=wobj0;
    MoveL [[404.0000,100.0000,200.0000],[0.965925826,0.000000000,0.258819045,0.000000000],[0,0,0,0],AXES],\
[50.000,60.000,5000,1000],fine,torch\\WObj:=wobj0;
    ! mark
    MoveL [[400.0000,100.0000,-250.0000],[0.683012702,-0.183012702,0.183012702,0.683012702],[0,0,0,0],AXES],\
[20.000,60.000,5000,1000],fine,torch\\WObj:=wobj0;
    SetDO arc,0;
  ENDPROC
ENDMODULE
"""


def test_rapid():
    start = np.array([0.0, -0.5, 0.5, 0.0, 0.25, 0.0]) * math.pi
    tool = RigidTransform.from_translation([0.0, 0.0, 0.15])
    text = rapid(program(tool="torch", weld_output="arc", start=start, T_flange_tool=tool))
    assert text.replace("\r\n", "\n").replace("[9E9,9E9,9E9,9E9,9E9,9E9]", "AXES") == RAPID


def test_a_python_module_makes_the_same_path():
    made = {}
    exec(python_module(example(t_s=np.array([0.0, 0.1, np.nan, 0.3]))), made)
    path = made["PATH"]
    assert np.array_equal(path.T_world_tip, example().T_world_tip) and path.tags == example().tags
    assert np.array_equal(path.speed_m_s, example().speed_m_s, equal_nan=True) and path.parent == "base"
    assert np.array_equal(path.t_s, [0.0, 0.1, np.nan, 0.3], equal_nan=True)


def test_an_approach_comes_slowly_along_the_tool():
    path = with_approach(example(), 0.05)
    assert len(path) == 6 and path.tags[1] == "weld_on"
    assert np.allclose(path.xyz_m[0], [0.4, 0.0, 0.15])  # the first tool points along +z
    # the last tool's z is 30 deg about y, then 90 deg about z: (sin 30, 0, cos 30) -> (0, sin 30, cos 30)
    assert np.allclose(path.xyz_m[-1], [0.4, 0.1 - 0.025, -0.25 - 0.05 * math.cos(math.pi / 6)])
    assert path.speed_m_s.tolist()[0] == 0.05 and path.speed_m_s[1] == 0.1 and path.speed_m_s[-2] == 0.02
    assert with_approach(path, 0.0) is path


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: program_moves(replace(example(), parent="world"), speed_m_s=0.1),
        lambda: program_moves(example(), speed_m_s=-1.0),
        lambda: program(name="1st"),
        lambda: program(acceleration_m_s2=0.0),
        lambda: krl(program(tool=None)),
        lambda: krl(program(weld_output="arc")),
        lambda: rapid(program(tool="1")),
        lambda: urscript(program(weld_output="8")),
    ],
)
def test_wrong_calls_are_refused(wrong):
    with pytest.raises(UsageError):
        wrong()


def test_a_weld_that_is_never_switched_off_is_refused():
    assert program_moves(replace(example(), tags=("weld_on", "weld_off", "", "")), speed_m_s=0.1)
    with pytest.raises(Inconsistent):
        program_moves(replace(example(), tags=("weld_on", "weld_off", "weld_on", "")), speed_m_s=0.1)
