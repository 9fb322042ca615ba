"""Every public function by every kind of argument that is none: our own error, or the right answer.

The table is held against the face: a public name, or a parameter, without an entry fails.
"""

import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial, wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight
from armsight.optics import parallel_rig
from hand_cell import CAMERA, LIGHTS, drawn, some_poses
from refusals import refuses


@dataclass(frozen=True, kw_only=True)
class Arg:
    """What goes into a parameter: good; wrong, to be refused; same, to give what good gives; needed: in every call."""

    good: Any
    wrong: dict[str, Any]
    same: dict[str, Any] = field(default_factory=dict)
    needed: bool = False


NO_ARRAY: dict[str, Any] = {
    "a text": "values.csv",
    "a dict": {"x": 1.0},
    "a Rotation": Rotation.identity(),
    "a set": {1.0, 2.0},
    "ragged": [[1.0, 2.0, 3.0], [1.0]],
    "an object": object(),
}


def array(good: Any, *, nan: bool = False, one: bool = False, more: dict[str, Any] | None = None) -> Arg:
    """An array of numbers. nan: NaN in is NaN out; one: a single row is taken as well."""
    a = np.asarray(good, float)
    hole = a.copy()
    hole.flat[-1] = np.nan
    spike = a.copy()
    spike.flat[-1] = np.inf
    mask = np.zeros(a.shape, bool)
    mask.flat[0] = True
    wrong = {
        "a rank more": a[None, None],
        "a number": 1.0,
        "last axis short": a[..., :-1],
        "last axis long": np.concatenate([a, a[..., :1]], axis=-1),
        "masked": np.ma.masked_array(a, mask),
        "objects": a.astype(object),
        "texts": a.astype(str),
        "complex": a + 1j,
        "truth": a > 0,
        "infinite": spike,
        **NO_ARRAY,
        **({} if nan else {"nan": hole}),
        **({"transposed": a.T} if a.ndim == 2 and a.shape[0] != a.shape[1] else {}),
        **(more or {}),
    }
    still = a.copy()
    still.setflags(write=False)
    wide = np.repeat(a, 2, axis=0)[::2]
    same = {
        "a list": a.tolist(),
        "read-only": still,
        "strided": wide,
        "by columns": np.asfortranarray(a),
        "big-endian": a.astype(">f8"),
        "nothing masked": np.ma.masked_array(a, np.zeros(a.shape, bool)),
        **({"integer": a.astype(int)} if (a == np.round(a)).all() else {}),
        **({"uint16": a.astype(np.uint16)} if (a == np.round(a)).all() and (a >= 0).all() else {}),
    }
    return Arg(good=a, wrong=wrong, same=same)


def image(good: np.ndarray) -> Arg:
    still = good.copy()
    still.setflags(write=False)
    wrong = {
        "16 bits": good.astype(np.uint16),
        "floats": good.astype(float),
        "nan": np.full(good.shape, np.nan),
        "truth": good > 0,
        "objects": good.astype(object),
        "a line": good[0],
        "channels first": np.stack([good] * 4),
        "empty": good[:0],
        "masked": np.ma.masked_array(good, good == good.max()),
        "a number": 3,
        "a dict": {},
        "no file": "no-such-file.png",
        "ragged": [[1, 2], [1]],
    }
    return Arg(good=good, wrong=wrong, same={"read-only": still, "strided": np.repeat(good, 2, axis=1)[:, ::2]})


NO_RECORD = {"a text": "rig.yaml", "a dict": {"left": 1}, "a tuple": (9, 6, 0.025), "a kind": armsight.Rig}


def record(good: Any, **same: Any) -> Arg:
    """One of our records, or settings: a file's name, a dict or a tuple are none."""
    return Arg(good=good, wrong=NO_RECORD | {"the kind": type(good), "an array": np.eye(3)}, same=same)


def number(good: Any, **wrong: Any) -> Arg:
    none = {"a text": "1.0", "nan": np.nan, "infinite": np.inf, "a row": [1.0, 2.0], "a dict": {}, "complex": 1j}
    return Arg(good=good, wrong=none | wrong)


BITS = number(12, none_at_all=0, share=1.5)


def choice(good: str) -> Arg:
    return Arg(good=good, wrong={"another": "nonsense", "a number": 3, "a list": [good], "none": None})


def text(good: str) -> Arg:
    return Arg(good=good, wrong={"a number": 3, "a list": [good], "a dict": {}, "bytes": good.encode()})


def poses(good: RigidTransform, *, as_matrix: bool = False, **wrong: Any) -> Arg:
    a = good.as_matrix()
    hole, spike = a.copy(), a.copy()
    hole[..., 0, 3], spike[..., 0, 3] = np.nan, np.inf
    still = a.copy()
    still.setflags(write=False)
    none = {
        "3x4": a[..., :3, :],
        "a rank more": a[None, None],
        "nan": hole,
        "infinite": spike,
        "scaled": 2.0 * a,
        "mirrored": a @ np.diag([1.0, 1.0, -1.0, 1.0]),
        "transposed": np.swapaxes(a, -1, -2),
        "masked": np.ma.masked_array(a, a == 1.0),
        "objects": a.astype(object),
        "complex": a + 0j,
        **NO_ARRAY,
    }
    same = {"a matrix": a, "read-only": still, "by columns": np.asfortranarray(a), "a list": a.tolist()}
    return Arg(good=a if as_matrix else good, wrong=none | wrong, same=same)


RIG = parallel_rig(CAMERA, 0.1)
TARGET = armsight.LightTarget(LIGHTS)
ARM = armsight.presets.ur10()
Q = np.array([0.0, -1.0, 1.0, 1.0, 2.0, 0.0])
QS = np.array([Q, Q + 1.0])
DEGREES = np.array([90.0, -90.0, 90.0, 0.0, 90.0, 0.0])
POINTS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 4.0], [0.0, 1.0, 5.0], [1.0, 1.0, 6.0]])
PIXELS = np.array([[160.0, 120.0], [200.0, 100.0], [210.0, 60.0]])
BOARD = "checkerboard:9x6:0.025"


LEFT, RIGHT = drawn()
FLANGE = some_poses(12, 1)
SEEN = (FLANGE * some_poses(1, 4)[0]).inv() * some_poses(1, 3)[0]
TIP = np.array([0.0, 0.0, 0.2])
TURNED = RigidTransform.from_components(FLANGE.rotation.apply(-TIP), FLANGE.rotation)
SETTINGS = record(armsight.SpotSettings())
SIDE = choice("left")
CAMERA_VIEWS = Arg(good=None, wrong={"a number": 3, "a list": ["left"], "none": {}, "another": {"top": None}})
JOINT_VALUES = array(QS, more={"degrees": DEGREES, "empty": []})
AT_HOME = Arg(good=Q, wrong={**array(Q).wrong, "degrees": DEGREES, "many": QS}, same=array(Q).same)
COV = np.array([[1.0, 0.0], [0.0, 1.0]])
FOUND = armsight.Spots.of_centres(PIXELS, COV)
INTRINSICS = np.array([250.0, 250.0, 160.0, 120.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
LENS = {"width": 320, "height": 240, "fx": 250.0, "fy": 250.0, "cx": 160.0, "cy": 120.0}
POINT_NAMES = Arg(good=(), wrong={"a text": "AAAAAAAAA", "too few": ("A",), "numbers": (1,) * 9})
SPREAD = np.random.default_rng(5).uniform(-1.5, 1.5, (9, 6))
NAMES = Arg(good=None, wrong={"one text": "ABCDEFGHIJKL", "numbers": [1, 2], "too few": ["A"]})

TABLES = Arg(good=None, wrong={"a text": "mm", "a dict": {"units": "mm"}})
OUT = Arg(good=None, wrong={"a number": 3, "a list": ["a"], "nowhere": "/dev/null/file.yaml"})
LINKS_TABLE_AND_OUT = {
    **dict.fromkeys(("tip", "base"), Arg(good=None, wrong={"a number": 3, "a list": ["tool0"]})),
    "table": TABLES,
    "out": OUT,
}

WRONG: dict[str, dict[str, Any]] = {
    "float": {"a text": "1.0", "nan": np.nan, "a row": [1.0, 2.0], "a dict": {}, "complex": 1j},
    "int": {"a text": "1", "share": 1.5, "a row": [1], "nan": np.nan, "a dict": {}},
    "bool": {"a text": "yes", "a number": 3},
    "Literal": {"another": "nonsense", "a list": ["a"], "a number": 3},
    "str": {"a number": 3, "a list": ["a"]},
    "RigLike": {"a number": 3, "an array": np.eye(3), "nowhere": "no-such-file.yaml", "the kind": armsight.Rig},
    "TargetLike": {"a number": 3, "an array": np.eye(3), "nowhere": "no-such-file.yaml"},
    "ArmLike": {"a number": 3, "an array": np.eye(3), "nowhere": "no-such-arm"},
    "Source": {"a number": 3, "a dict": {}, "nowhere": "no-such-folder", "floats": [np.ones((4, 4))]},
    "TableLike": {"ragged": {"a": [1.0], "b": [1.0, 2.0]}, "a set": {1.0}, "nowhere": "no-such-file.csv", "none": {}},
    **{name: {"ragged": {"a": [1.0], "b": [1.0, 2.0]}, "a set": {1.0}} for name in ("TableFile", "PairsFile")},
    **{key: {"a text": "1", "share": 1.5, "a row": [1]} for key in ("Workers", "Bits", "Limit")},
    "PoseLike": {"a number": 3, "scaled": 2.0 * np.eye(4), "nowhere": "no-such-file.yaml"},
    "Poses": {"a number": 3, "scaled": 2.0 * np.eye(4)},
    "PathText": {"a number": 3, "a list": [1]},
    "CameraSettings": {"a dict": {"gain": 1.0}, "a text": "auto"},
    "PairSettings": {"a dict": {"gain": 1.0}, "a text": "auto"},
    "TableFormat": {"a dict": {"units": "mm"}, "a text": "mm"},
    "Progress": {"a text": "bar"},
    "Confirm": {"a text": "yes", "a number": 3},
    "ArrayLike": {"a text": "values", "nan": [np.nan], "a dict": {"x": 1.0}},
    "Camera": {"a number": 3, "nowhere": "no-such-file.yaml"},
    "Target": {"a number": 3, "nonsense": "chess"},
    "TaughtPath": {"a number": 3, "an array": np.eye(4)},
    "Sequence": {"a number": 3, "texts": ["a"]},
    "RobotLike": {"a number": 3, "nonsense": "robot", "nobody": "nobody:1"},
    "FrameNames": {"a dict": {}, "a text": "tool0"},
    "Cameras": CAMERA_VIEWS.wrong,
    "Table": TABLES.wrong,
    "Limits": {"a number": 3, "a dict": {}},
}
WRONG |= dict.fromkeys(("Fps", "Threshold", "MaxSkew"), WRONG["float"])
WRONG |= dict.fromkeys(("Convention", "LensKind", "Method", "Detector", "AtSetup"), WRONG["Literal"])
WRONG |= dict.fromkeys(("RigidTransform", "SpotSettings", "Colour", "Rig", "Spots"), NO_RECORD)
"""What is refused by the kind that a parameter's annotation names first."""

UNCHECKED = {("convert", "source"), ("compare", "a"), ("compare", "b"), ("write_table", "columns")}


def of(call: Callable[..., Any], **given: Any) -> tuple[Callable[..., Any], dict[str, Arg]]:
    """What a function takes: an Arg as given, all else by its annotation; other values given are what it must have."""
    out = {}
    for name, one in inspect.signature(call).parameters.items():
        kinds = re.findall(r"[A-Za-z]+", str(one.annotation))
        kind = next((kind for kind in kinds if kind in WRONG), None)
        needed, wrong = name in given, WRONG[kind] if kind else {"a number": 3}
        value = given.get(name)
        out[name] = value if isinstance(value, Arg) else Arg(good=value, wrong=wrong, needed=needed)
    return call, out


ROBOT = {"robot": "sim:webcam-cell"}
SEEN_BY = {"rig": RIG, "target": TARGET}
LIVE = {**ROBOT, **SEEN_BY, "left": "camera:sim:webcam-cell:left", "right": "camera:sim:webcam-cell:right"}
PAIR = {**SEEN_BY, "left": [LEFT], "right": [RIGHT]}
PATH = armsight.TaughtPath.of_poses(some_poses(3, 1))
AWAY = "/dev/null/out"
MCAP = str(Path(__file__).parents[2] / "golden" / "no-such.mcap")


@wraps(armsight.twin)
def _begun(*args: Any, **given: Any) -> str:
    with armsight.twin(*args, **given) as address:
        return address


READERS = (
    *("arm", "camera", "hand_eye", "joints", "limits", "path", "poses"),
    *("rig", "table", "target", "tool_tip", "world"),
)
TABLE: dict[str, tuple[Callable[..., Any], dict[str, Arg]]] = {
    "Arm.values": of(ARM.values, readings=JOINT_VALUES),
    "Arm.readings": of(ARM.readings, q=JOINT_VALUES),
    "Arm.sagged": of(ARM.sagged, q=JOINT_VALUES),
    "Arm.gravity_torque": of(ARM.gravity_torque, q=JOINT_VALUES),
    "Arm.checked": of(ARM.checked, q=JOINT_VALUES),
    "Arm.fk": of(ARM.fk, q=JOINT_VALUES),
    "Arm.jacobian": of(ARM.jacobian, q=JOINT_VALUES),
    "Arm.moved": of(
        ARM.moved,
        changes=Arg(
            good={}, wrong={"a text": "j3", "no name": {"j9.a_m": 1.0}, "texts": {"j3.a_m": "1"}, "a list": [1]}
        ),
    ),
    "Arm.within_limits": of(ARM.within_limits, q=JOINT_VALUES),
    "Arm.ik": of(
        ARM.ik,
        T_world_tool=poses(RigidTransform.from_matrix(ARM.fk(Q)), millimetres=np.diag([1e3, 1e3, 1e3, 1.0])),
        near=AT_HOME,
    ),
    "Arm.ik_many": of(
        ARM.ik_many,
        T_world_tool=poses(RigidTransform.from_matrix(ARM.fk(QS))),
        near=Arg(good=Q, wrong={**array(Q).wrong, "degrees": DEGREES, "other rows": np.tile(Q, (5, 1))}),
    ),
    "Arm.track": of(
        ARM.track,
        T_world_tool=poses(RigidTransform.from_matrix(ARM.fk(np.array([Q, Q + 1e-3])))),
        t_s=array(np.arange(2.0), more={"backwards": [1.0, 0.0]}),
        near=AT_HOME,
    ),
    "Camera": of(
        armsight.Camera,
        width=320,
        height=240,
        intrinsics=array(INTRINSICS),
        plate=Arg(good=None, wrong={"a number": 0.003, "a dict": {}}),
    ),
    "Camera.pinhole": of(armsight.Camera.pinhole, **LENS),
    "Camera.fisheye": of(armsight.Camera.fisheye, **LENS),
    "Camera.rational": of(armsight.Camera.rational, **LENS),
    "Camera.project": of(CAMERA.project, points_m=array(POINTS, nan=True, more={"empty": []})),
    "Camera.rays": of(CAMERA.rays, uv_px=array(PIXELS, nan=True, more={"empty": []})),
    "Camera.is_close": of(CAMERA.is_close, other=record(CAMERA), tol=1e-9),
    "Colour": of(
        armsight.Colour,
        hue_deg=array((340.0, 20.0), more={"too much": (0.0, 400.0)}),
        min_saturation=number(0.3, percent=30.0),
        min_value=number(0.3, percent=30.0),
    ),
    "Joint": of(armsight.Joint, name="j1"),
    "Arm": of(
        armsight.Arm,
        name="arm",
        joints=Arg(good=ARM.joints, wrong={"none": (), "numbers": (1, 2), "one": ARM.joints[0], "a text": "ur10"}),
        covariance=Arg(good=None, wrong={"an array": np.eye(3)}),
        couplings=Arg(good=(), wrong={"texts": ("j1", "j2"), "a number": 3}),
        tool_points=Arg(good=(), wrong={"texts": ("A",), "a number": 3}),
        down_in_base=array((0.0, 0.0, -1.0), more={"not of unit length": (0.0, 0.0, -9.8)}),
    ),
    "LightTarget": of(
        armsight.LightTarget,
        lights_m=Arg(
            good=LIGHTS,
            wrong={
                "none": {},
                "a list": list(LIGHTS.values()),
                "a text": "target.yaml",
                "flat": {"A": (0.0, 1.0)},
                "nan": {"A": (0.0, 0.0, np.nan)},
                "texts": {"A": ("0", "0", "0")},
                "millimetres": {name: [1e3 * x for x in at] for name, at in LIGHTS.items()},
                "numbers as names": {1: (0.0, 0.0, 0.0)},
            },
        ),
        diameter_m=number(0.01, none_at_all=0.0),
        covariance=array(np.eye(9)),
    ),
    "PoseTracker": of(armsight.PoseTracker, rig=RIG, target=record(TARGET), bits=BITS),
    "PoseTracker.update": of(
        lambda left=LEFT, right=RIGHT, t_s=0.0, cameras=None: armsight.PoseTracker(RIG, TARGET).update(
            left, right, t_s, cameras=cameras
        ),
        left=image(LEFT),
        right=image(RIGHT),
        t_s=number(0.0),
        cameras=CAMERA_VIEWS,
    ),
    "Rig": of(
        partial(armsight.Rig, left=CAMERA, right=CAMERA, T_rig_left=RIG.T_rig_left, T_rig_right=RIG.T_rig_right),
        kind=Arg(good="stereo", wrong={"another": "nonsense", "a number": 3, "a list": ["stereo"]}),
        cameras=Arg(good=RIG.cameras, wrong={"a number": 3, "a text": "ab", "none": (), "plain": (CAMERA,)}),
        left=record(CAMERA),
        right=record(CAMERA),
        covariance=Arg(good=None, wrong={"an array": np.eye(3)}),
        noise=Arg(good=(None, None), wrong={"a number": 3, "one": (None,), "texts": ("a", "b")}),
        timing=Arg(good=(None, None), wrong={"a number": 3, "one": (None,), "texts": ("a", "b")}),
        zoom=Arg(good=(None, None), wrong={"a number": 3, "one": (None,), "texts": ("a", "b")}),
    ),
    "Rig.camera": of(RIG.camera, side=SIDE),
    "Rig.T_rig_camera": of(RIG.T_rig_camera, side=SIDE),
    "Rig.require_pair": of(RIG.require_pair, what="rig.yaml"),
    "Rig.project": of(RIG.project, points_m=array(POINTS, nan=True, more={"empty": []})),
    "SpotSettings": of(
        armsight.SpotSettings,
        threshold=number(40.0, too_high=300.0),
        inverted=Arg(good=False, wrong={"a text": "no", "a row": [True]}),
        mask=Arg(
            good=LEFT > 20,
            wrong={"a line": np.ones(3, bool), "a text": "mask.png", "floats": 0.5 * LEFT, "nan": LEFT * np.nan},
            same={"bytes": (LEFT > 20).astype(np.uint8), "strided": np.repeat(LEFT > 20, 2, axis=1)[:, ::2]},
        ),
        min_pixels=number(3, none_at_all=0, share=0.5),
        max_radius_px=number(32.0, none_at_all=0.0),
        max_spots=number(64, none_at_all=0, share=0.5),
        saturation=number(255, too_high=4095),
        gain=number(0.1, negative=-1.0),
        method=choice("likelihood"),
    ),
    "Spots": of(
        armsight.Spots,
        uv_px=array(PIXELS),
        covariance_px2=array(np.stack([COV] * 3)),
        peak=array(np.ones(3)),
        size_px=array(np.ones(3)),
        model=Arg(good=("gaussian",) * 3, wrong={"a text": "abc", "too few": ("gaussian",), "numbers": (1, 2, 3)}),
        rejected=Arg(good=(), wrong={"a number": 3}),
        point=Arg(good=None, wrong={"too few": np.array([1]), "a text": "abc"}),
    ),
    "Spots.none": of(armsight.Spots.none, rejected=Arg(good=(), wrong={"a number": 3})),
    "Spots.of_centres": of(armsight.Spots.of_centres, uv_px=array(PIXELS), covariance_px2=array(np.stack([COV] * 3))),
    "Spots.take": of(
        FOUND.take,
        index=Arg(good=[0, 1], wrong={"beyond": [9], "text": "A", "floats": [0.5], "rank": [[0]], "truth": [True]}),
    ),
    "Target": of(armsight.Target, kind="spots", names=tuple("ABC"), xyz_m=list(LIGHTS.values())),
    "TaughtPath": of(
        armsight.TaughtPath,
        T_world_tip=poses(some_poses(3, 1), as_matrix=True),
        t_s=array(np.arange(3.0), nan=True, more={"backwards": [2.0, 1.0, 0.0]}),
        speed_m_s=array(np.ones(3), nan=True, more={"negative": -np.ones(3)}),
        tags=Arg(good=("",) * 3, wrong={"a text": "abc", "numbers": (1, 2, 3), "too few": ("",)}),
    ),
    "TaughtPath.of_poses": of(
        armsight.TaughtPath.of_poses,
        poses=poses(some_poses(3, 1)),
        t_s=array(np.arange(3.0), nan=True),
        speed_m_s=array(np.ones(3), nan=True, more={"a number": -1.0}),
    ),
    "calibrate_arm": of(
        armsight.calibrate_arm,
        nominal=record(ARM),
        q=array(np.zeros((9, 6)), more={"fewer rows": np.zeros((4, 6)), "degrees": np.full((9, 6), 90.0)}),
        xyz_m=array(np.ones((9, 3)), more={"fewer rows": np.ones((4, 3))}),
        rotation=array(np.tile(np.eye(3), (9, 1, 1)), more={"scaled": np.tile(2.0 * np.eye(3), (9, 1, 1))}),
        point=POINT_NAMES,
        touch=Arg(
            good=(SPREAD, ["spike"] * len(SPREAD)),
            wrong={
                "a number": 3,
                "nowhere": "no-such-file.csv",
                "a list": [1, 2],
                "5 joints": (SPREAD[:, :5], ["a"] * len(SPREAD)),
                "names": (SPREAD, ["a"]),
                "kinds": (SPREAD, ["a"] * len(SPREAD), ["point"]),
                "tips": (SPREAD, ["a"] * len(SPREAD), ["point"] * len(SPREAD), ["long"]),
                "five entries": (SPREAD, ["a"] * len(SPREAD), ["point"] * len(SPREAD), [], []),
            },
        ),
        length=Arg(
            good=(("a", "b", 0.27),),
            wrong={"a text": "a,b,0.27", "two": (("a", "b"),), "nan": (("a", "b", np.nan),)},
        ),
        holdout=Arg(good=None, wrong={"a list": [1, 2], "one": (np.zeros((9, 6)),), "5 joints": (np.zeros((9, 5)), 1)}),
        propose=number(1, negative=-1, share=1.5),
        rig=record(RIG),
        world=Arg(good=np.eye(4), wrong=WRONG["PoseLike"]),
        **LINKS_TABLE_AND_OUT,
    ),
    "calibrate_robot_world": of(
        armsight.calibrate_robot_world,
        arm=record(ARM),
        q=array(SPREAD, more={"fewer rows": np.zeros((4, 6)), "degrees": np.full((9, 6), 90.0)}),
        xyz_m=array(ARM.fk(SPREAD)[:, :3, 3], more={"fewer rows": np.ones((4, 3))}),
        point=POINT_NAMES,
        **LINKS_TABLE_AND_OUT,
    ),
    "ArmResult.change": of(lambda name: _arm_result().change(name), name=choice(f"{ARM.joints[0].name}.a_m")),
    "ArmResult.propose": of(
        lambda n=1, rig=None, T_base_rig=None: _arm_result().propose(n, rig=rig, T_base_rig=T_base_rig),
        n=number(1, none_at_all=0),
        rig=record(RIG),
        T_base_rig=poses(some_poses(1, 4)[0]),
    ),
    "HandEyeResult.propose": of(
        lambda n=1, reachable=None: armsight.calibrate_hand_eye(FLANGE, SEEN).propose(n, reachable),
        n=number(1, none_at_all=0),
        reachable=Arg(good=None, wrong={"nowhere": lambda T: False}),
    ),
    "estimate_pose_from_spots": of(
        partial(armsight.estimate_pose_from_spots, left=FOUND, right=FOUND, rig=RIG, target=TARGET),
        target=record(TARGET),
    ),
    "calibrate_tool_tip": of(
        armsight.calibrate_tool_tip,
        T_world_target=poses(TURNED),
        covariances=array(np.tile(1e-8 * np.eye(6), (12, 1, 1)), more={"one": np.eye(6)}),
        point_m=array(np.zeros(3)),
        point_std_m=number(0.001, negative=-1.0),
        t_s=array(np.arange(12.0)),
        out=OUT,
    ),
    "estimate_pose": of(
        partial(armsight.estimate_pose, left=LEFT, right=RIGHT, rig=RIG, target=TARGET),
        left=image(LEFT),
        right=image(RIGHT),
        target=record(TARGET),
        bits=BITS,
    ),
    "find_spots": of(armsight.find_spots, image=image(LEFT), bits=BITS),
    "presets.preset": of(armsight.presets.preset, name=choice("ur10")),
    "read_scenario": of(armsight.read_scenario, scenario=choice("webcam-cell")),
    "simulate": of(
        armsight.simulate,
        scenario=choice("webcam-cell"),
        frames=number(2, none_at_all=0, share=1.5),
        seed=number(1, negative=-1, share=1.5),
        room=Arg(good=None, wrong={"a number": 3, "nowhere": "no-such-room", "a list": ["office"]}),
    ),
    "triangulate": of(
        armsight.triangulate,
        rig=RIG,
        uv_left_px=array(PIXELS, nan=True, more={"fewer rows": PIXELS[:2]}),
        uv_right_px=array(PIXELS - (20.0, 0.0), nan=True, more={"fewer rows": PIXELS[:2]}),
        covariance_left_px2=array(np.stack([COV] * 3), nan=True, more={"fewer rows": np.stack([COV] * 2)}),
        covariance_right_px2=array(np.stack([COV] * 3), nan=True, more={"fewer rows": np.stack([COV] * 2)}),
    ),
    **{
        f"{kind}.save": of(thing.save, path=AWAY)
        for kind, thing in {
            "Arm": ARM,
            "Camera": CAMERA,
            "Rig": RIG,
            "Target": TARGET,
            "TaughtPath": armsight.TaughtPath.of_poses(some_poses(3, 1)),
            "PoseTrack": armsight.PoseTrack(),
            "Limits": armsight.Limits(),
            "World": armsight.World(parent="base", T_parent_rig=RigidTransform.identity()),
        }.items()
    },
    # what fills a job: each with what must be given, so that it refuses at once whatever else is wrong
    **{f"read_{kind}": of(getattr(armsight, f"read_{kind}"), path="no-such-file.yaml") for kind in READERS},
    "open_recording": of(armsight.open_recording, path=MCAP),
    "connect": of(armsight.connect, url="ws://127.0.0.1:9"),
    "batch": of(armsight.batch, function=armsight.measure, jobs={"a": {}}, out=AWAY),
    "design": of(armsight.design, target=TARGET, volume=[(-0.1, 0.1), (-0.1, 0.1), (0.6, 0.8)], rig=RIG, board=BOARD),
    "measure": of(armsight.measure, **PAIR),
    "record": of(armsight.record, out=AWAY, cell="hand-cell"),
    "repair_recording": of(armsight.repair_recording, path=MCAP),
    "verify": of(armsight.verify, measured=ARM.fk(SPREAD)),
    "plan_verification": of(armsight.plan_verification, arm=ARM, out=AWAY),
    "compare": of(armsight.compare, a=RIG, b=ARM),
    "join": of(armsight.join, measured=ARM.fk(SPREAD)),
    "doctor": of(armsight.doctor, depths_m=[1.0]),
    "reproduce": of(armsight.reproduce, paper="korayem2018", out=AWAY),
    "calibrate_hand_eye": of(
        armsight.calibrate_hand_eye,
        T_base_flange=poses(FLANGE),
        T_camera_target=poses(SEEN),
        setup=choice("eye-in-hand"),
        names=NAMES,
        camera_covariance=array(np.tile(1e-8 * np.eye(6), (len(SEEN), 1, 1)), more={"one": np.eye(6)}),
    ),
    "calibrate_pivot": of(armsight.calibrate_pivot, **PAIR),
    "calibrate_camera": of(armsight.calibrate_camera, images=[LEFT], board=BOARD),
    "calibrate_cameras": of(
        armsight.calibrate_cameras,
        cameras=Arg(
            good={"a": [LEFT], "b": [RIGHT]},
            wrong={
                "a number": 3,
                "a text": "a",
                "without names": ["images/left", "images/right"],
                "images alone": [LEFT, RIGHT],
                "one": {"a": [LEFT]},
                "none": {},
                "numbers": {"a": 1, "b": 2},
                "numbers as names": {1: [LEFT], 2: [RIGHT]},
                "floats": {"a": [LEFT * 1.0], "b": [RIGHT]},
            },
        ),
        board=Arg(
            good=BOARD, wrong={"another": "chess", "a number": 3, "a list": [BOARD], "lights": TARGET, "none": None}
        ),
        lenses=Arg(
            good=None,
            wrong={
                "a number": 3,
                "another kind": "oval",
                "numbers": {"a": 3},
                "nowhere": {"a": "no-such-file.yaml"},
                "a rig": {"a": RIG},
                "another camera's": {"c": CAMERA},
            },
        ),
        rig=Arg(good=None, wrong=WRONG["RigLike"]),
        add=Arg(good=None, wrong={"a number": 3, "without a rig": {"c": [LEFT]}, "numbers": {"c": 3}}),
        again=Arg(good=None, wrong={**WRONG["str"], "without a rig": "a"}),
        options=Arg(good=None, wrong={"a number": 3, "a dict": {}, "a text": "fisheye"}),
        every=Arg(good=1, wrong={**WRONG["int"], "none": 0}),
        frames=Arg(good=None, wrong={**WRONG["Limit"], "none": 0}),
        detector=choice("auto"),
        strict=Arg(good=False, wrong=WRONG["bool"]),
        out=OUT,
    ),
    "calibrate_mirrors": of(armsight.calibrate_mirrors, images=[LEFT], board=BOARD),
    "calibrate_stereo": of(armsight.calibrate_stereo, left_images=[LEFT], right_images=[RIGHT], board=BOARD),
    "calibrate_target": of(armsight.calibrate_target, rig=RIG, left=[LEFT], right=[RIGHT]),
    "calibrate_timing": of(armsight.calibrate_timing, **PAIR),
    "calibrate_cell": of(armsight.calibrate_cell, robot_log=(np.arange(12.0), QS), target=TARGET, model=ARM),
    "calibrate_noise": of(armsight.calibrate_noise, frames=[LEFT]),
    "calibrate_zoom_rig": of(armsight.calibrate_zoom_rig, rig=RIG),
    "check_mirrors": of(armsight.check_mirrors, image=[LEFT], board=BOARD),
    "identify_arm": of(
        armsight.identify_arm,
        joint=Arg(
            good=[1] * 9, wrong={"halves": [1.5] * 9, "zero": [0] * 9, "beyond": [7] * 9, "texts": ["j1"] * 9, "one": 1}
        ),
        q=array(np.ones((9, 1)), more={"fewer rows": np.zeros((4, 1))}),
        xyz_m=array(np.ones((9, 3)), more={"fewer rows": np.ones((4, 3))}),
        rig=record(RIG),
        uv_px=array(np.ones((9, 2, 2))),
        T_base_rig=poses(some_poses(1, 4)[0]),
        method=choice("ml"),
        increments=choice("known"),
        sigma=number(1e-4),
        name=text("arm"),
    ),
    "identify_arm_live": of(armsight.identify_arm_live, **LIVE, limits=np.array([[-1.0, 1.0]] * 6)),
    "supervise": of(armsight.supervise, **LIVE, arm=ARM, world=np.eye(4)),
    "propose_mastering_poses": of(
        armsight.propose_mastering_poses, arm=ARM, around=Q, rig=RIG, target=TARGET, world=np.eye(4)
    ),
    "check_mastering": of(armsight.check_mastering, measured=ARM.fk(SPREAD), joints=SPREAD, arm=ARM),
    "servo": of(armsight.servo, **ROBOT, **SEEN_BY, handeye="no-such-file.yaml"),
    "teach": of(armsight.teach),
    "play": of(armsight.play, **ROBOT, path=PATH),
    "jog": of(armsight.jog, **ROBOT, joint=1, by=0.01),
    "check_robot": of(armsight.check_robot, **ROBOT),
    "twin": of(_begun, name="alter"),
    "convert": of(armsight.convert, source=CAMERA, out=AWAY),
    "cut_recording": of(armsight.cut_recording, path=MCAP, out=AWAY, start_s=0.0, end_s=1.0),
    "export_recording": of(armsight.export_recording, path=MCAP, out=AWAY),
    "show_arm": of(armsight.show_arm, arm=ARM, out=AWAY),
    "write_formulas": of(armsight.write_formulas, arm=ARM, out=AWAY),
    "write_joints": of(armsight.write_joints, path=AWAY, t_s=[0.0], q=np.zeros((1, 6))),
    "write_table": of(armsight.write_table, path=AWAY, columns={"x_m": [0.0]}),
    "print_board": of(armsight.print_board, board=BOARD, out=AWAY),
    "write_simulation": of(armsight.write_simulation, scenario="hand-cell", out=AWAY),
    **{
        f"paths.{name}": of(getattr(armsight.paths, name), path=PATH, **more)
        for name, more in {
            "smooth": {},
            "resample": {"step_m": 0.01},
            "fillet": {"radius_m": 0.01},
            "offset": {"by_m": 0.01},
            "angle": {},
            "reverse": {},
            "check": {"arm": ARM},
            "export": {"out": AWAY},
        }.items()
    },
    **{
        f"history.{name}": of(getattr(armsight.history, name), history="no-such-history.sqlite", **more)
        for name, more in {
            "add": {"result": "no-such-file.json", "cell": "a"},
            "runs": {},
            "show": {"run": 1},
            "compare": {"a": 1, "b": 2},
            "trend": {"cell": "a"},
            "export": {"out": AWAY},
        }.items()
    },
    "paths.join": of(armsight.paths.join, first=PATH, second=PATH),
    "paths.from_picks": of(
        armsight.paths.from_picks, left=[LEFT], right=[RIGHT], rig=RIG, picks={"u_px": [1.0], "v_px": [1.0]}
    ),
}
"""By public name: what is called, and each of its parameters."""


MADE_BY_US = (
    *("Identification", "ArmResult", "CameraResult", "HandEyeResult", "PoseEstimate", "PoseTrack", "RigResult"),
    *("RobotWorldResult", "ToolTipResult", "MeasureResult", "VerifyResult", "JoinResult", "TargetResult"),
    *("TimingResult", "CamerasTiming", "CellResult", "NoiseResult", "ZoomRigResult", "TeachResult"),
    "SimulatedFrame",
    *("RobotConnection", "RobotDriver", "RemoteState", "Simulation", "PoseStatus", "Inverse", "JointPath", "World"),
    *("RobotState", "BatchResult"),
)
"""Results, errors and names that people read but do not make: their constructors check nothing."""

CHECKED_WHERE_USED = (
    *("BoardOptions", "CameraSettings", "FrameNames", "TableFormat", "NoiseModel", "TargetPose", "Frame", "Limits"),
    *("JointReading", "Sent"),
    *("Recording", "RobotDriver", "Progress", "Robot"),
)
"""Settings and records that others check when they get them, protocols, and what asks a file or a server."""

SAVED_ALIKE = tuple(
    f"{name}.{how}"
    for name in MADE_BY_US
    if name.endswith(("Result", "Identification", "Estimate", "Timing"))
    for how in ("save", "write")
)
"""Results that take long to make; their `save` is one line, to the same writers."""

NEEDED_TOGETHER = {
    "rig": ("uv_px", "T_base_rig", "world"),
    "world": ("rig",),
    "uv_px": ("rig",),
    "T_base_rig": ("rig", "uv_px"),
    "point_std_m": ("point_m",),
    "point_m": ("point_std_m",),
    "length": ("touch",),
}
"""Parameters that mean something only with another."""
WITH_ALL = ("q", "xyz_m", "joint", "T_base_flange", "T_camera_target", "board")


@cache
def _arm_result() -> armsight.ArmResult:
    return armsight.calibrate_arm(ARM, np.tile(SPREAD, (4, 1)), np.tile(ARM.fk(SPREAD)[:, :3, 3], (4, 1)))


def _parameters(call: Callable[..., Any]) -> list[str]:
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    held = inspect.signature(call).parameters.items()
    return [name for name, one in held if name not in ("self", "cls") and one.kind not in several]


def _face() -> Iterator[tuple[str, list[str]]]:
    """Every public callable with arguments: functions, constructors, methods, and what is in public modules."""
    for name in dir(armsight):
        thing = getattr(armsight, name)
        if isinstance(thing, ModuleType):
            for inner, function in inspect.getmembers(thing, inspect.isfunction):
                if not inner.startswith("_") and function.__module__ == thing.__name__:
                    yield f"{name}.{inner}", _parameters(function)
        elif inspect.isclass(thing):
            yield from _of_class(name, thing)
        elif callable(thing):
            yield name, _parameters(thing)


def _of_class(name: str, kind: type) -> Iterator[tuple[str, list[str]]]:
    if issubclass(kind, Exception):
        return
    if name not in (*MADE_BY_US, *CHECKED_WHERE_USED):
        yield name, _parameters(kind)
    for inner, method in inspect.getmembers(kind, callable):
        ours = getattr(method, "__module__", None) or ""
        held = inner == "save" or name not in CHECKED_WHERE_USED
        if held and not inner.startswith("_") and ours.startswith("armsight"):
            yield f"{name}.{inner}", _parameters(method)


def test_the_table_has_every_public_function_and_parameter() -> None:
    face = {name: parameters for name, parameters in _face() if parameters and name not in SAVED_ALIKE}
    assert {name: sorted(arguments) for name, (_, arguments) in TABLE.items()} == {
        name: sorted(parameters) for name, parameters in face.items()
    }


def _called(name: str, parameter: str, value: Any) -> Any:
    call, arguments = TABLE[name]
    given = {}
    for key, argument in arguments.items():
        plain = inspect.signature(call).parameters[key].default
        if key == parameter:
            given[key] = value
        elif (
            plain is inspect.Parameter.empty
            or argument.needed
            or key in (() if parameter in ("touch", "length") else WITH_ALL)
            or key in NEEDED_TOGETHER.get(parameter, ())
        ):
            given[key] = argument.good
    return call(**given)


def _taken(name: str, parameter: str, value: Any) -> str:
    """Return what became of a wrong value where no error of ours refused it with cause and consequence or cure."""
    try:
        _called(name, parameter, value)
    except armsight.ArmsightError as error:
        return "" if error.cause and (error.consequence or error.cure) else f"refused without a reason: {error!r}"
    except Exception as error:
        return repr(error)
    return "taken"


@pytest.mark.parametrize("name", TABLE)
def test_what_is_no_argument_is_refused_with_an_error_of_ours(name: str) -> None:
    found = {
        (parameter, label): _taken(name, parameter, value)
        for parameter, argument in TABLE[name][1].items()
        if (name, parameter) not in UNCHECKED
        for label, value in argument.wrong.items()
    }
    assert not {which: said for which, said in found.items() if said}


def _numbers(result: Any) -> list[np.ndarray]:
    """All arrays of an answer, wherever they are in it."""
    if isinstance(result, np.ndarray | float):
        return [np.asarray(result)]
    if isinstance(result, RigidTransform):
        return [result.as_matrix()]
    if isinstance(result, tuple | list):
        return [found for part in result for found in _numbers(part)]
    names = getattr(result, "__dataclass_fields__", ())
    return [found for name in names if name != "found" for found in _numbers(getattr(result, name))]


# calibrate_arm, identify_arm: their few rows are enough for a refusal only
@pytest.mark.parametrize(
    ("name", "parameter"),
    [
        (name, parameter)
        for name, (_, arguments) in TABLE.items()
        for parameter, argument in arguments.items()
        if argument.same and name not in ("calibrate_arm", "identify_arm")
    ],
)
def test_the_same_numbers_in_another_form_give_the_same_answer(name: str, parameter: str) -> None:
    argument = TABLE[name][1][parameter]
    right = _numbers(_called(name, parameter, argument.good))
    for label, value in argument.same.items():
        found = _numbers(_called(name, parameter, value))
        assert len(found) == len(right) > 0, label
        for a, b in zip(found, right, strict=True):
            np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), 1e-12, 1e-12, err_msg=label)


def _frames(t_s: list[Any], picture: Any = LEFT) -> list[armsight.Frame]:
    return [armsight.Frame(image=picture, t_s=t, sequence=i, source="mine") for i, t in enumerate(t_s)]


def _path() -> armsight.TaughtPath:
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 0, 3] = np.linspace(0.0, 0.2, 5)
    return armsight.TaughtPath.of_poses(T)


CANNOT_BE: dict[str, Callable[[Path], Any]] = {
    "fps 0": lambda _: armsight.measure(RIG, TARGET, [LEFT], [RIGHT], fps=0.0),
    "skew below 0": lambda _: armsight.measure(RIG, TARGET, [LEFT], [RIGHT], max_skew_s=-1.0),
    "frames 0": lambda folder: armsight.record(folder / "a.mcap", [LEFT], [RIGHT], frames=0),
    "seconds 0": lambda folder: armsight.record(folder / "a.mcap", [LEFT], [RIGHT], seconds_s=0.0),
    "no ending": lambda folder: armsight.record(folder / "a", [LEFT], [RIGHT]),
    "every 0": lambda _: armsight.calibrate_noise([LEFT] * 5, every=0),
    "tolerance 0": lambda _: armsight.calibrate_arm(armsight.presets.ur10(), SPREAD, np.ones((9, 3)), tolerance_m=0.0),
    "distance below 0": lambda _: armsight.compare(RIG, RIG, distance_m=-1.0),
    "unit 0": lambda folder: armsight.convert(RIG, folder / "a.yaml", to="opencv", unit_m=0.0),
    "size 0": lambda folder: armsight.read_camera(folder / "a.yaml", size=(0, 0)),
    "cycle 0": lambda _: armsight.twin("alter", cycle_s=0.0).__enter__(),
    "a simulation without end": lambda _: armsight.simulate("hand-cell", frames=10**9, room="dark"),
    "no frames": lambda folder: armsight.write_simulation("hand-cell", folder / "cell", frames=0),
    "a step in mm": lambda _: armsight.paths.resample(_path(), 10.0),
    "three in a table": lambda _: armsight.join((np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)), [1.0])),
    "frames at one time": lambda _: armsight.measure(RIG, TARGET, _frames([0.0, 0.0]), _frames([0.0, 0.0], RIGHT)),
    "frames without time": lambda _: _frames([np.nan]),
    "frames at a text": lambda _: _frames(["0"]),
    "frames without array": lambda _: _frames([0.0], [[0, 1], [1, 0]]),
    "frames on two clocks": lambda _: armsight.measure(RIG, TARGET, _frames([0.0]), _frames([9.0], RIGHT)),
    "pictures of two sizes": lambda _: armsight.estimate_pose(LEFT[:100], RIGHT, RIG, TARGET),
    "a picture without its partner": lambda _: armsight.calibrate_stereo([LEFT], [], board=BOARD),
    "poses without their partners": lambda _: armsight.calibrate_hand_eye(FLANGE, SEEN[:8]),
    "a covariance below 0": lambda _: armsight.Spots.of_centres(PIXELS, -COV),
}
"""What was taken, or raised another error than ours, until a person tried it."""


@pytest.mark.parametrize("what", CANNOT_BE)
def test_what_cannot_be_is_refused(what: str, tmp_path: Path) -> None:
    with pytest.raises(armsight.ArmsightError) as caught:
        CANNOT_BE[what](tmp_path)
    assert caught.value.cause and caught.value.cure


def test_a_cut_keeps_its_source_and_tells_that_nothing_was_recorded_then(tmp_path: Path) -> None:
    run = tmp_path / "run.mcap"
    armsight.record(run, [LEFT] * 3, [RIGHT] * 3, rig=RIG, target=TARGET, fps=10.0)
    before = run.read_bytes()
    with refuses(armsight.UsageError, "source", "result"):
        armsight.cut_recording(run, run, 0.0, 0.1, overwrite=True)
    with refuses(armsight.UsageError, "start_s", "before"):
        armsight.cut_recording(run, tmp_path / "part.mcap", 0.2, 0.1)
    with refuses(armsight.NotEnoughData, "between", "times"):
        armsight.cut_recording(run, tmp_path / "part.mcap", 5.0, 6.0)
    assert run.read_bytes() == before and list(tmp_path.iterdir()) == [run]
    assert armsight.cut_recording(run, tmp_path / "part.mcap", 0.05, 0.25).duration_s == pytest.approx(0.1)
