"""Whatever stands in a file, a reader gives an object or refuses the data; nothing else ever comes out."""

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armsight import store
from armsight.errors import BadFile, DataRefused
from armsight.store.covariances import POSE_COLUMNS
from armsight.store.foreign.kalibr import kalibr_rig
from armsight.store.foreign.opencv import opencv_camera, opencv_rig
from armsight.store.foreign.ros import ros_camera, ros_rig
from armsight.store.foreign.storage import kind_of_mapping
from armsight.store.rigs import WORLD_YAML
from armsight.store.spots_csv import parse_spot_track
from armsight.store.tracks import parse_joints, parse_poses, parse_times
from armsight.store.yamls import dump_yaml, parse_yaml
from refusals import refuses

fuzz = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def read(reader, *args):
    try:
        return reader(*args)
    except DataRefused as error:
        assert error.cause
        str(error)
    return None


TABLES = (parse_poses, parse_joints, parse_times, parse_spot_track)
MAPPINGS = {
    "rig": store.rig_from_mapping,
    "target": store.target_from_mapping,
    "world": WORLD_YAML.parse,
    "ros": lambda content: ros_camera(content, "x"),
    "ros pair": lambda content: ros_rig(content, content, "x", "y"),
    "opencv": lambda content: opencv_camera(content, "x"),
    "opencv pair": lambda content: opencv_rig(content, "x", size=(640, 480)),
    "kalibr": lambda content: kalibr_rig(content, "x"),
}

SYNTAX = "{}[]:,-?&*!|>'\"%@`# \n\t~.0123456789eaNIfru\\x\r\0\ufeffé💡"


@fuzz
@given(st.binary(max_size=300) | st.text(SYNTAX, max_size=120).map(str.encode) | st.text(max_size=80).map(str.encode))
def test_any_bytes_as_yaml(data):
    content = read(parse_yaml, data, "x.yaml")
    if content is not None:
        kind_of_mapping(content)
        for reader in MAPPINGS.values():
            read(reader, content)


numbers = st.floats() | st.integers() | st.floats(-2.0, 2.0) | st.sampled_from([10**400, -0.0, 640, 1e308, -1e200])
scalars = st.none() | st.booleans() | numbers | st.text(max_size=5)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)

POSE = {"xyz_m": [0.1, 0.0, 0.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
CAMERA = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0, "distortion": [0.0] * 5}
MATRIX = {"rows": 3, "cols": 3, "data": [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]}
KALIBR = {
    "camera_model": "pinhole",
    "intrinsics": [500.0, 500.0, 320.0, 240.0],
    "distortion_model": "radtan",
    "distortion_coeffs": [0.0] * 4,
    "resolution": [640, 480],
}
GOOD = {
    "rig": {
        "kind": "stereo",
        "cameras": {
            "left": {**CAMERA, "T_rig_camera": {**POSE, "xyz_m": [0.0, 0.0, 0.0]}},
            "right": {**CAMERA, "T_rig_camera": POSE},
        },
        "covariance": {"names": ["left.fx"], "matrix": [[1.0]]},
    },
    "target": {"kind": "spots", "spots_m": {"A": [0.0, 0.0, 0.0]}, "colour": {"hue_deg": [0.0, 10.0]}},
    "world": {"T_base_rig": POSE},
    "ros": {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": MATRIX,
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
        "projection_matrix": {"rows": 3, "cols": 4, "data": [500.0, 0, 320, -50, 0, 500, 240, 0, 0, 0, 1, 0]},
    },
    "opencv": {"camera_matrix": MATRIX, "distortion_coefficients": [0.0] * 5, "size": [640, 480]},
    "opencv pair": {
        **dict.fromkeys(("M1", "M2"), MATRIX),
        **dict.fromkeys(("D1", "D2"), [0.0] * 5),
        "R": np.eye(3).tolist(),
        "T": [-0.1, 0.0, 0.0],
    },
    "kalibr": {
        "cam0": KALIBR,
        "cam1": {**KALIBR, "T_cn_cnm1": [[1.0, 0, 0, -0.1], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1]]},
    },
}


def paths_of(content, prefix=()):
    yield prefix
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield from paths_of(value, (*prefix, key))


def replaced(content, path, value):
    if not path:
        return value
    copy = dict(content) if isinstance(content, dict) else list(content)
    copy[path[0]] = replaced(content[path[0]], path[1:], value)
    return copy


@pytest.mark.parametrize("name", GOOD)
def test_the_seeds_are_good(name):
    assert MAPPINGS[name](GOOD[name]) is not None


@fuzz
@given(st.data())
def test_one_value_of_a_good_file_replaced_by_anything(data):
    name = data.draw(st.sampled_from(sorted(GOOD)))
    path = data.draw(st.sampled_from([path for path in paths_of(GOOD[name]) if path]))
    content = replaced(GOOD[name], path, data.draw(values))
    read(MAPPINGS[name], content)
    try:
        text = dump_yaml(content)
    except (yaml.YAMLError, UnicodeError):
        return
    again = read(parse_yaml, text.encode("utf-8", "replace"), "x.yaml")
    if again is not None:
        read(MAPPINGS[name], again)


@pytest.mark.parametrize("name", GOOD)
def test_huge_numbers_anywhere_are_read_or_refused(name):
    for path in paths_of(GOOD[name]):
        for value in (1e308, -1e200, [1e308] * 3, [[1e200] * 3] * 3):
            read(MAPPINGS[name], replaced(GOOD[name], path, value) if path else {})


@fuzz
@given(st.dictionaries(st.text(max_size=8), values, max_size=5))
def test_what_is_written_comes_back(content):
    try:
        data = dump_yaml(content).encode()
    except UnicodeError:
        return
    back = read(parse_yaml, data, "x.yaml")
    if back is not None:
        assert repr(back) == repr(content)  # repr: nan equals itself, 1 is not 1.0, -0.0 is not 0.0


@fuzz
@given(st.binary(max_size=200) | st.text('t_sq1,"\n\r0.;eE-+_na#\0\ufeff', max_size=80).map(str.encode))
def test_any_bytes_as_table(data):
    for reader in TABLES:
        read(reader, data, "x.csv")
        read(reader, b"t_s,q1\n" + data, "x.csv")
        read(reader, b"t_s,u_px,v_px\n" + data, "x.csv")


cells = st.sampled_from(["0", "1", "", "-1", "1e308", "0.5", " ", "nan", "ok", "lost", "position_only", '"', "x"])


@fuzz
@given(st.lists(st.lists(cells, min_size=14, max_size=17), min_size=1, max_size=4))
def test_any_cells_as_poses(rows):
    text = "\n".join([",".join(POSE_COLUMNS), *(",".join(row) for row in rows)])
    for pose in read(parse_poses, text.encode(), "poses.csv") or ():
        assert pose.covariance is None or np.isfinite(pose.covariance).all()


@fuzz
@given(st.lists(st.lists(cells, min_size=6, max_size=6), min_size=1, max_size=5))
def test_any_cells_as_spots_of_a_camera(rows):
    text = "\n".join(["t_s,u_px,v_px,su_px,sv_px,spot", *(",".join(row) for row in rows)])
    track = read(parse_spot_track, text.encode(), "left.csv")
    if track is not None:
        assert len(track.names) == len(rows)
        assert (np.diff(track.t_s) > 0.0).all()
        assert (np.linalg.det(track.covariance_px2) > 0.0).all()


def test_rows_between_two_quotes_astray_are_not_lost():
    text = 't_s,u_px,v_px,su_px,sv_px,spot\n0,0,0,1,1,"\n0,0,0,1,1,"\n'
    with refuses(BadFile, ("left.csv", "line")):
        parse_spot_track(text.encode(), "left.csv")


@fuzz
@given(st.text(max_size=60) | st.text("checkerboardiu:x0123456789.eE-+_DICT", max_size=40))
def test_any_word_as_board(text):
    from armsight.errors import UsageError

    try:
        store.parse_board(text)
    except UsageError as error:
        assert "COLUMNSxROWS" in error.cure
