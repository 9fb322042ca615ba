"""rig.yaml, camera.yaml, target.yaml, world.yaml: exact round trips, and errors that name the key."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight import store
from armsight.columns import POSE6
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.geometry import is_close
from armsight.optics import Camera, parallel_rig
from armsight.records import NamedCovariance, Target, TargetKind, board_target, spot_target
from armsight.records.target import GREEN
from armsight.store.yamls import parse_yaml
from refusals import refuses


def rig_content():
    rig = parallel_rig(
        Camera.pinhole(1280, 720, 1100.0, 1099.0, 640.0, 360.0, distortion=(-0.1, 0.05, 0.0, 0.0, 0.0)), 0.1
    )
    names = ("left.fx", "left.fy", "right.fx", "right.tx", "right.rx", "right.ry", "right.rz")
    known = NamedCovariance(names=names, matrix=np.diag(np.arange(7.0) + 1.0) / 7 + 0.01)
    return store.rig_mapping(replace(rig, covariance=known, rms_px=1 / 7))


SPOTS = {"A": (0.1 + 0.2, -1e-5, 1e-17), "B": (1 / 3, 2.0, 0.0), "e1": (0.0, 0.0, 1.0)}
TARGETS = {
    "spots": spot_target(SPOTS, diameter_m=0.005),
    "spots and how well they are known": spot_target(SPOTS, covariance=1e-9 * (np.eye(9) / 3 + np.ones((9, 9)) / 7)),
    "beacon by name of colour": spot_target({"beacon": (0.0, 0.0, 0.0)}, colour=GREEN),
    "checkerboard": board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025),
    "charuco": board_target(TargetKind.CHARUCO, 8, 5, 0.04, marker_m=0.03, dictionary="DICT_4X4_50"),
}


@pytest.mark.parametrize("name", TARGETS)
def test_target_comes_back_exactly(tmp_path, name):
    target, path = TARGETS[name], tmp_path / "target.yaml"
    store.write_target(path, target)
    back = store.read_target(path)
    assert np.array_equal(back.xyz_m, target.xyz_m)
    for field in ("kind", "names", "diameter_m", "columns", "rows", "pitch_m", "marker_m", "dictionary", "model_known"):
        assert getattr(back, field) == getattr(target, field), field
    assert (back.covariance is None) == (target.covariance is None)
    if target.covariance is not None:
        assert np.array_equal(back.covariance, target.covariance)
    assert (back.colour is None) == (target.colour is None)
    if target.colour is not None:
        assert back.colour.hue_deg == target.colour.hue_deg
        assert back.colour.min_value == target.colour.min_value


@pytest.mark.parametrize("parent", ["world", "base"])
def test_world_comes_back(tmp_path, parent):
    pose = RigidTransform.from_components([0.1, 1 / 3, -2.0], Rotation.from_rotvec([0.3, 0.2, 0.1]))
    covariance = NamedCovariance(names=POSE6, matrix=np.diag(np.arange(6.0) / 7))
    store.write_world(
        tmp_path / "world.yaml", store.World(parent=parent, T_parent_rig=pose, covariance=covariance, n_used=12)
    )
    back = store.read_world(tmp_path / "world.yaml")
    assert back.parent == parent
    assert is_close(back.T_parent_rig, pose, tol_m=0.0, tol_rad=1e-15)
    assert np.array_equal(back.covariance.matrix, covariance.matrix)
    assert back.n_used == 12


def changed(content, key, value):
    """Return content with one key, given as a path with dots, set to value (or dropped)."""
    at = content
    *parents, last = key.split(".")
    for part in parents:
        at = at[part]
    if value is KeyError:
        del at[last]
    else:
        at[last] = value
    return content


REFUSED_RIGS = {
    "unknown key": ("cameras.left.fz", 1.0, ("cameras.left.fz", "width, height, lens, fx")),
    "missing key": ("cameras.right.fy", KeyError, ("cameras.right.fy", "missing")),
    "nan": ("cameras.left.cx", float("nan"), ("cameras.left.cx", "nan", "finite")),
    "text for a number": ("cameras.left.fx", "wide", ("cameras.left.fx", "wide")),
    "fraction of a pixel": ("cameras.left.width", 640.5, "cameras.left.width"),
    "kind": ("kind", "trinocular", ("stereo", "mirror")),
    "version of the future": ("version", 4, ("version 4", "1 to 3", "Update")),
    "focal length": ("cameras.left.fx", -800.0, "focal lengths"),
    "no rotation": ("cameras.right.T_rig_camera.quat_xyzw", [1.0, 1.0, 0.0, 0.0], "quaternion"),
    "no baseline": ("cameras.right.T_rig_camera.xyz_m", [0.0, 0.0, 0.0], "same place"),
    "lopsided covariance": ("covariance.matrix", [[1.0, 0.0]] * 7, "7 names"),
}


@pytest.mark.parametrize("case", REFUSED_RIGS)
def test_a_wrong_rig_is_refused_with_its_key(case):
    key, value, message = REFUSED_RIGS[case]
    with refuses(BadFile, message) as caught:
        store.rig_from_mapping(changed(rig_content(), key, value), "rig.yaml")
    assert "rig.yaml" in caught.value.cause
    assert caught.value.consequence
    assert caught.value.cure


@pytest.mark.parametrize(
    "spoilt", [lambda rows: [-rows[0][0], *rows[0][1:]], lambda rows: [rows[0][0], 1.0, *rows[0][2:]]]
)
def test_a_covariance_must_be_one(spoilt):
    content = rig_content()
    rows = content["covariance"]["matrix"]
    rows[0] = spoilt(rows)
    with refuses(BadFile, "symmetric"):
        store.rig_from_mapping(content)


REFUSED_TARGETS = {
    "kind": ({"kind": "cube"}, ("cube", "spots, checkerboard")),
    "neither spots nor labels": ({"kind": "spots"}, ("exactly one", "spots_m", "labels")),
    "other labels": ({"kind": "spots", "labels": ["A", "B"]}, "three lights"),
    "name with a comma": ({"kind": "spots", "spots_m": {"A,B": [0.0, 0.0, 0.0]}}, "spots_m"),
    "colour": ({"kind": "spots", "spots_m": {"A": [0.0, 0.0, 0.0]}, "colour": "mauve"}, "colour"),
    "key of another kind": (
        {"kind": "checkerboard", "columns": 9, "rows": 6, "pitch_m": 0.02},
        ("pitch_m", "square_m"),
    ),
}


@pytest.mark.parametrize("case", REFUSED_TARGETS)
def test_a_wrong_target_is_refused_with_its_key(case):
    content, message = REFUSED_TARGETS[case]
    with refuses(BadFile, message):
        store.target_from_mapping(content, "target.yaml")


def test_a_file_of_another_format_is_told_apart(tmp_path):
    store.write_target(tmp_path / "target.yaml", TARGETS["spots"])
    with refuses(BadFile, "armsight/target", "armsight/rig"):
        store.read_rig(tmp_path / "target.yaml")
    (tmp_path / "opencv.yml").write_text("%YAML:1.0\n---\nM1: 1\n")
    with refuses(BadFile, "opencv", "convert"):
        store.read_rig(tmp_path / "opencv.yml")
    with refuses(BadFile, "No such file"):
        store.read_rig(tmp_path / "missing.yaml")
    with refuses(BadFile, "cannot be read"):
        store.read_rig(tmp_path)


YAML_VALUES = {
    "a: 1e-5": 1e-5,  # YAML 1.1 readers make a text of it
    "a: 1.0e-05": 1e-5,
    "a: 0x10": 16,
    "a: 12:30": "12:30",
    "a: 2026-11-20": "2026-11-20",
    "a: true": True,
    "a: ~": None,
    "a: *x\nb: 1": BadFile,
    "\ufeffa: 1": 1,
}


@pytest.mark.parametrize("text", YAML_VALUES)
def test_yaml_values_are_what_they_look_like(text):
    want = YAML_VALUES[text]
    if want is BadFile:
        with pytest.raises(BadFile):
            parse_yaml(text.encode(), "x.yaml")
    else:
        got = parse_yaml(text.encode(), "x.yaml")["a"]
        assert got == want
        assert type(got) is type(want)


BROKEN_YAML = {
    "empty": (b"", "empty"),
    "a list": (b"[1, 2]", "a list"),
    "binary": (bytes(range(256)), "UTF-8"),
    "unclosed": (b"a: [1, 2\nb: 3", "line 2"),
    "twice": (b"a: 1\nb: 2\na: 3\n", ("line 3", "a", "twice")),
    "list as a key": (b"? [1, 2]\n: 3", "single value"),
}


@pytest.mark.parametrize("case", BROKEN_YAML)
def test_broken_yaml_is_refused_with_its_place(case):
    data, message = BROKEN_YAML[case]
    with refuses(BadFile, message):
        parse_yaml(data, "x.yaml")


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_bytes(b"a: 1\n" * 100_001)
    with refuses(BadFile, "0.5 MB"):
        store.read_rig(path)


BOARDS = {
    "checkerboard:9x6:0.025": (TargetKind.CHECKERBOARD, 54),
    "circles:10x10:0.02": (TargetKind.CIRCLES, 100),
    "acircles:4x11:2e-2": (TargetKind.ACIRCLES, 44),
    "charuco:8x5:0.04:0.03:DICT_4X4_50": (TargetKind.CHARUCO, 28),
}


@pytest.mark.parametrize("text", BOARDS)
def test_boards_in_one_word(text):
    board = store.parse_board(text)
    assert (board.kind, len(board.names)) == BOARDS[text]
    again = store.parse_board(store.board_text(board))
    assert np.array_equal(again.xyz_m, board.xyz_m)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "checkerboard:9x6",
        "checkerboard:9x6:25mm",
        "checkerboard:9x6:-0.025",
        "checkerboard:9x6:25",
        "checkerboard:1x5:0.02",
        "checkerboard:9x6:0.025:1",
        "charuco:8x5:0.04:0.03",
    ],
)
def test_a_wrong_board_is_answered_with_the_forms(text):
    with pytest.raises(UsageError) as caught:
        store.parse_board(text)
    for form in ("checkerboard:COLUMNSxROWS:SQUARE_M", "circles:", "acircles:", "charuco:"):
        assert form in caught.value.cure


LIT = "format: armsight/target\nversion: 1\nkind: spots\nspots_m: {A: [0.0, 0.0, 0.0], B: [0.1, 0.0, 0.0]}\n"


def test_deviations_of_a_target_are_a_diagonal_and_its_covariance_counts_before_them(tmp_path):
    path = tmp_path / "target.yaml"
    path.write_text(LIT)
    assert store.read_target(path).covariance is None
    path.write_text(LIT + "std_m: {B: [4.0e-05, 5.0e-05, 6.0e-05], A: [1.0e-05, 2.0e-05, 0.0]}\n")
    expected = np.diag([1e-5, 2e-5, 0.0, 4e-5, 5e-5, 6e-5]) ** 2
    assert np.array_equal(store.read_target(path).covariance, expected)
    rows = [f"{light}.{axis}_m" for light in "BA" for axis in "xyz"]
    covariance = NamedCovariance(names=rows, matrix=np.diag([4.0, 5.0, 6.0, 1.0, 2.0, 3.0]) * 1e-10)
    matrix = covariance.matrix.tolist()
    path.write_text(LIT + f"std_m: {{A: [1, 1, 1], B: [1, 1, 1]}}\ncovariance: {{names: {rows}, matrix: {matrix}}}\n")
    assert np.array_equal(np.diag(store.read_target(path).covariance), np.array([1.0, 2, 3, 4, 5, 6]) * 1e-10)
    path.write_text(LIT + f"covariance: {{names: {rows[:3]}, matrix: {np.eye(3).tolist()}}}\n")
    with refuses(BadFile, "covariance", "B"):
        store.read_target(path)
    negative = np.eye(6)
    negative[0, 1] = negative[1, 0] = 2.0
    path.write_text(LIT + f"covariance: {{names: {rows}, matrix: {negative.tolist()}}}\n")
    with refuses(BadFile, "negative variance"):
        store.read_target(path)


def test_targets_in_millimetres_are_refused_by_their_place_and_size_too():
    for keys in ({"A": [0.0, 0.0, 40.0]}, {"A": [40.0, 0.0, 0.0], "B": [41.0, 0.0, 0.0]}):
        with pytest.raises(Inconsistent, match="millimetres"):
            Target(kind=TargetKind.SPOTS, names=tuple(keys), xyz_m=np.array(list(keys.values())))
    with refuses(Inconsistent, "diameter", "8 m"):
        Target(kind=TargetKind.SPOTS, names=("A",), xyz_m=np.zeros((1, 3)), diameter_m=8.0)
