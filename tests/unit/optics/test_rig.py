"""A rig of any number of cameras: its parameters, which camera its covariance holds, and what is refused."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.optics import (
    INTRINSICS,
    RIG_PARAMETERS,
    SIDES,
    Camera,
    MountedCamera,
    PackedRig,
    Rig,
    RigKind,
    ZoomLens,
    ZoomSetting,
    at_zoom,
    moved_rig,
    with_zoom,
)
from armsight.records import CameraTiming, NamedCovariance
from armsight.records.by_value import same_value
from refusals import refuses

NAMES = ("left", "right", "top", "a-1", "b_2", "Far", "hand", "c")


def make_rig(names, seed=1, share=1.0):
    """Cameras on a circle that look at one place; a covariance of `share` of the parameters."""
    rng = np.random.default_rng(seed)
    cameras = []
    for k, name in enumerate(names):
        lens = Camera.pinhole(640 + k, 480, 800.0 + k, 801.0, 320.0, 240.0, distortion=0.01 * rng.standard_normal(5))
        turn = Rotation.from_rotvec([0.0, 0.3 * k, 0.0]) * Rotation.from_rotvec(0.05 * rng.standard_normal(3))
        T = RigidTransform.from_components(turn.apply([0.0, 0.0, -1.0]) + 0.01 * rng.standard_normal(3), turn)
        cameras.append(MountedCamera(name=name, camera=lens, T_rig_camera=T))
    rig = Rig(cameras=tuple(cameras))
    free = [name for name in rig.parameters if rng.random() < share]
    A = rng.standard_normal((len(free), len(free)))
    scale = [1e-2 if name.split(".")[1] in INTRINSICS[:5] else 1e-4 for name in free]
    return replace(rig, covariance=NamedCovariance(names=tuple(free), matrix=A @ A.T * np.outer(scale, scale)))


@pytest.mark.parametrize("V", [1, 2, 3, 8])
def test_of_every_camera_parameters_arrays_and_pixels(V):
    rig = make_rig(NAMES[:V])
    packed = PackedRig.of(rig)
    assert len(rig.parameters) == 16 * V - 6
    assert packed.covariance.shape == (16 * V - 6,) * 2
    assert rig.kind is (RigKind.STEREO if V == 2 else RigKind.CAMERAS)
    assert V != 2 or rig.parameters == RIG_PARAMETERS
    X = np.random.default_rng(2).uniform(-0.2, 0.2, (5, 3))
    for k, (one, uv) in enumerate(zip(rig.cameras, rig.project(X), strict=True)):
        T, K = one.T_rig_camera.inv(), one.camera.matrix
        seen = cv2.projectPoints(X, T.rotation.as_rotvec(), T.translation, K, one.camera.distortion)[0]
        assert np.abs(uv - seen[:, 0]).max() < 1e-9
        assert np.array_equal(packed.k[k], one.camera.packed)
        assert np.array_equal(packed.t[k], T.translation)
    back = pickle.loads(pickle.dumps(rig))  # as it goes to another process
    assert back.names == rig.names
    assert same_value(back.covariance, rig.covariance)


@pytest.mark.parametrize("V", [1, 2, 3, 8])
def test_a_step_moves_each_parameter_alone(V):
    rig = make_rig(NAMES[:V])
    for i, name in enumerate(rig.parameters):
        step = np.zeros(len(rig.parameters))
        step[i] = 1e-3
        moved = moved_rig(rig, step)
        camera, parameter = name.split(".")
        for before, after in zip(rig.cameras, moved.cameras, strict=True):
            lens = after.camera.intrinsics - before.camera.intrinsics
            dt = after.T_rig_camera.translation - before.T_rig_camera.translation
            dw = (after.T_rig_camera.rotation * before.T_rig_camera.rotation.inv()).as_rotvec()
            shift = dict(zip((*INTRINSICS, "tx", "ty", "tz", "rx", "ry", "rz"), [*lens, *dt, *dw], strict=True))
            assert {k for k, v in shift.items() if abs(v) > 1e-9} == ({parameter} if after.name == camera else set())


def measurable(rig, names):
    """Return what no choice of a held camera changes: these cameras' lenses, and the pose of each in each other."""
    poses = [rig.T_rig_camera(name) for name in names]
    apart = [(a.inv() * b).as_matrix()[:3].ravel() for a in poses for b in poses if a is not b]
    return np.concatenate([*(rig.camera(name).intrinsics for name in names), *apart])


def spread(rig, names):
    """Return the covariance of what is measurable, by central differences."""
    columns = []
    for i in range(len(rig.parameters)):
        step = np.zeros(len(rig.parameters))
        step[i] = 1e-5
        plus, minus = (measurable(moved_rig(rig, sign * step), names) for sign in (1.0, -1.0))
        columns.append((plus - minus) / 2e-5)
    J = np.column_stack(columns)
    return J @ PackedRig.of(rig).covariance @ J.T


@pytest.mark.parametrize("share", [1.0, 0.6])
@pytest.mark.parametrize(
    "names", [("right", "left"), ("top", "left", "right"), ("a-1", "right"), ("right", "a-1", "top", "left")]
)
def test_which_camera_is_held_changes_nothing_that_can_be_measured(names, share):
    rig = make_rig(("left", "right", "top", "a-1"), share=share)
    found = rig.only(*names)
    assert found.names == names
    assert all(found.T_rig_camera(name) is rig.T_rig_camera(name) for name in names), "the axes stay"
    before, after = (spread(one, sorted(names)) for one in (rig, found))
    assert np.abs(after - before).max() < 1e-7 * np.abs(before).max()
    back = found.only(*(name for name in rig.names if name in names))
    if set(names) == set(rig.names):
        assert np.allclose(PackedRig.of(back).covariance, PackedRig.of(rig).covariance, rtol=1e-9, atol=1e-15)


def test_a_pair_is_made_by_its_own_words_and_changed_by_them():
    made = make_rig(SIDES)
    words = {"left": made.left, "right": made.right, "T_rig_left": made.T_rig_left, "T_rig_right": made.T_rig_right}
    timing = (None, CameraTiming(delay_s=0.01))
    rig = Rig(kind="mirror", **words, covariance=made.covariance, timing=timing)
    assert (rig.kind, rig.timing, rig.noise) == (RigKind.MIRROR, timing, (None, None))
    assert rig.baseline_m == float(np.linalg.norm(made.T_rig_right.translation - made.T_rig_left.translation))
    other = replace(rig, left=made.right, T_rig_right=made.T_rig_left, timing=(None, None), covariance=None)
    assert (other.left, other.right) == (made.right, made.right)
    assert other.T_rig_right is made.T_rig_left
    with refuses(UsageError, "noise has 1 entries", "left, right", "Give 2"):
        replace(rig, noise=(None,))
    with refuses(UsageError, "right", "NoneType"):
        Rig(kind="stereo", left=made.left, T_rig_left=made.T_rig_left)


def test_the_zoom_of_the_held_camera_moves_all_others_alike():
    rig = make_rig(("a", "b", "c"))
    a = rig.camera("a")

    def setting(zoom, share):
        k = a.intrinsics * np.r_[share, share, np.ones(8)]
        known = NamedCovariance(names=INTRINSICS, matrix=1e-4 * np.eye(10))
        return ZoomSetting(zoom=zoom, camera=replace(a, intrinsics=k), covariance=known, pupil_m=zoom, pupil_std_m=0.1)

    lens = ZoomLens(settings=(setting(1.0, 1.0), setting(2.0, 1.5), setting(3.0, 2.0)))
    zooming = with_zoom(rig, (lens, None, None), (1.0, None, None))
    with refuses(UsageError, "zoom lens", "--zoom-a"):
        at_zoom(zooming)
    with refuses(UsageError, "2 zooms", "a, b, c"):
        at_zoom(zooming, (2.0, None))
    found = at_zoom(zooming, (2.0, None, None)).rig
    assert found.camera("a").intrinsics[0] == pytest.approx(1.5 * a.intrinsics[0])
    axis = rig.T_rig_camera("a").rotation.as_matrix()[:, 2]
    moved = found.T_rig_camera("a").translation - rig.T_rig_camera("a").translation
    assert np.allclose(moved, axis)  # 1 m further, in its own direction
    places = tuple(f"{name}.t{axis}" for name in "bc" for axis in "xyz")
    more = found.covariance.block(places) - rig.covariance.block(places)
    assert np.allclose(more, np.tile(0.02 * np.outer(axis, axis), (2, 2)), atol=1e-12)
    fixed = zooming.with_each(zoom=(None,) * 3)
    assert at_zoom(fixed, (None, None)).rig == fixed, "none has a zoom, and none is given"
