"""rig.yaml of a pair stays as it always was, byte for byte; any other cameras come back from theirs, and Kalibr's."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight import store
from armsight.errors import BadFile, UsageError
from armsight.geometry import is_close
from armsight.optics import Camera, MountedCamera, PackedRig, Plate, Rig
from armsight.records import CameraTiming, NamedCovariance, NoiseModel
from armsight.records.by_value import same_value
from armsight.records.camera import NeighbourCorrelation
from armsight.store.foreign import rig_from_kalibr, rig_to_kalibr
from armsight.store.yamls import read_yaml
from refusals import refuses

PAIR = """\
format: armsight/rig
version: 1
kind: KIND
cameras:
  left:
    width: 640
    height: 480
    fx: 800.0
    fy: 801.0
    cx: 320.5
    cy: 240.25
    skew: 0.0
    distortion: [0.1, -0.02, 0.001, 0.0, 0.3333333333333333]
    plate: {thickness_m: 0.001, index: 1.5}
    T_rig_camera:
      xyz_m: [0.0, 0.0, 0.1]
      quat_xyzw: [0.0, 0.0, 0.0, 1.0]
  right:
    width: 640
    height: 480
    lens: fisheye
    fx: 400.0
    fy: 401.0
    cx: 320.5
    cy: 240.25
    skew: 0.0
    distortion: [0.1, -0.02, 0.0, 0.0]
    T_rig_camera:
      xyz_m: [0.25, 0.0, 0.0]
      quat_xyzw: [0.5, 0.5, 0.5, 0.5]
    timing: {readout_s: 0.015, exposure_s: 0.0, delay_s: 0.01, drift_ppm: 0.0, jitter_s: 0.0}
rms_px: 0.125
covariance:
  names: [left.fx, right.k4, right.tx]
  matrix:
  - [0.25, 0.0, 0.0]
  - [0.0, 1.0e-06, 0.0]
  - [0.0, 0.0, 1.0e-08]
inputs: []
"""
"""As the version before any number of cameras wrote it."""

NAMES = ("top", "right", "left", "a-1", "b_2", "Far", "hand", "c")


def written(path, rig):
    store.write_rig(path, rig)
    return re.sub(r"(?m)^(created|software): .*\n", "", path.read_text())


@pytest.mark.parametrize("kind", ["stereo", "mirror"])
def test_a_pair_is_written_as_it_always_was(tmp_path, kind):
    lens = (640, 480, 800.0, 801.0, 320.5, 240.25)
    left = Camera.pinhole(*lens, distortion=(0.1, -0.02, 0.001, 0.0, 1 / 3))
    rig = Rig(
        kind=kind,
        left=replace(left, plate=Plate(thickness_m=0.001) if kind == "mirror" else None),
        right=Camera.fisheye(640, 480, 400.0, 401.0, 320.5, 240.25, distortion=(0.1, -0.02, 0.0, 0.0)),
        T_rig_left=RigidTransform.from_translation([0.0, 0.0, 0.1]),
        T_rig_right=RigidTransform.from_components([0.25, 0.0, 0.0], Rotation.from_quat([0.5] * 4)),
        covariance=NamedCovariance(names=("left.fx", "right.k4", "right.tx"), matrix=np.diag([0.25, 1e-6, 1e-8])),
        rms_px=0.125,
        timing=(None, CameraTiming(delay_s=0.01, readout_s=0.015)),
    )
    wanted = PAIR.replace("KIND", kind)
    wanted = wanted if kind == "mirror" else re.sub(r"(?m)^ *plate.*\n", "", wanted)
    assert written(tmp_path / "rig.yaml", rig) == wanted
    assert written(tmp_path / "again.yaml", store.read_rig(tmp_path / "rig.yaml")) == wanted


def make_rig(V, seed=1, plain=False):
    """V cameras in an order of their own, every number with all its bits."""
    rng = np.random.default_rng([V, seed])

    def camera():
        k = np.array([800.0, 801.0, 320.0, 240.0]) + rng.standard_normal(4)
        if rng.random() < 0.3:
            return Camera.fisheye(640, 480, *k, distortion=0.01 * rng.standard_normal(4))
        few = np.r_[1.0, 1.0, 1.0, 1.0, 0.0 if plain else 1.0]
        skew = 0.0 if plain else float(rng.random())
        return Camera.pinhole(640, 480, *k, skew=skew, distortion=0.1 * rng.standard_normal(5) * few)

    names = NAMES[:V] if V != 2 else ("left", "right")
    rig = Rig(
        cameras=tuple(
            MountedCamera(
                name=name,
                camera=camera(),
                T_rig_camera=RigidTransform.from_components(rng.random(3) / 3, Rotation.random(rng=rng)),
                timing=CameraTiming(delay_s=float(rng.random())) if rng.random() < 0.5 else None,
                noise=NoiseModel(
                    levels=[1.0, 200.0],
                    variance_levels2=rng.random(2),
                    std_levels2=rng.random(2) / 7,
                    correlation=NeighbourCorrelation(x=rng.random(2) / 3, y=rng.random(2) / 3),
                    n_frames=20,
                )
                if rng.random() < 0.5
                else None,
            )
            for name in names
        ),
        rms_px=float(rng.random()),
    )
    names = rig.parameters[:: 1 if V < 3 else V]
    A = rng.standard_normal((len(names),) * 2)
    return rig if plain else replace(rig, covariance=NamedCovariance(names=names, matrix=A @ A.T))


@pytest.mark.parametrize("V", [1, 2, 3, 8])
def test_any_number_of_cameras_comes_back(tmp_path, V):
    rig = make_rig(V)
    text = written(tmp_path / "rig.yaml", rig)
    assert text.splitlines()[:3] == (
        ["format: armsight/rig", "version: 1", "kind: stereo"]
        if V == 2
        else ["format: armsight/rig", "version: 2", "kind: cameras"]
    )
    back = store.read_rig(tmp_path / "rig.yaml", any_cameras=True)
    assert (back.names, back.kind, back.rms_px) == (rig.names, rig.kind, rig.rms_px)
    assert same_value((back.noise, back.timing, back.covariance), (rig.noise, rig.timing, rig.covariance))
    assert np.array_equal(PackedRig.of(back).k, PackedRig.of(rig).k)
    assert np.allclose(PackedRig.of(back).R, PackedRig.of(rig).R, atol=1e-15)


def test_the_order_of_a_pair_is_kept(tmp_path):
    rig = make_rig(2)
    turned = rig.only("right", "left")
    assert "version: 2" in written(tmp_path / "turned.yaml", turned)
    back = store.read_rig(tmp_path / "turned.yaml", any_cameras=True)
    assert back.names == ("right", "left")
    assert np.allclose(PackedRig.of(back.pair()).covariance, PackedRig.of(rig).covariance, rtol=1e-9)
    content = store.rig_mapping(rig)
    content["cameras"] = dict(reversed(content["cameras"].items()))
    assert store.rig_from_mapping(content).names == ("left", "right"), "a file of a pair may name them in any order"


def changed(content, change):
    change(content)
    return content


def renamed(content, name):
    content["cameras"] = {name if old == "right" else old: one for old, one in content["cameras"].items()}


REFUSED = {
    "newer": (lambda c: c.update(version=4), ("version 4", "version 1 to 3", "Update armsight")),
    "no version": (lambda c: c.pop("version"), "top"),
    "another kind": (lambda c: c.update(kind="stereo"), "cameras"),
    "no cameras": (lambda c: c.update(cameras={}), ("0 cameras", "one to 8")),
    "a name": (lambda c: renamed(c, "image"), ("'image'", "no name", "letter")),
    "a camera that the covariance knows": (lambda c: renamed(c, "other"), ("right.cx", "better known")),
    "a key": (lambda c: c["cameras"]["top"].pop("fx"), "cameras.top.fx"),
    "nine": (
        lambda c: c["cameras"].update({f"n{k}": c["cameras"]["top"] for k in range(6)}),
        ("9 cameras", "one to 8"),
    ),
    "one place": (
        lambda c: c["cameras"]["left"].update(T_rig_camera=c["cameras"]["top"]["T_rig_camera"]),
        ("top and left", "same place"),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_file_of_cameras_is_refused(case):
    change, told = REFUSED[case]
    with refuses(BadFile, told) as caught:
        store.rig_from_mapping(changed(store.rig_mapping(make_rig(3)), change), "rig.yaml")
    assert "rig.yaml" in caught.value.cause
    assert caught.value.consequence
    assert caught.value.cure


def test_a_camera_is_a_rig_of_one(tmp_path):
    one = make_rig(1).cameras[0]
    known = NamedCovariance(names=one.camera.names, matrix=np.diag(np.arange(1.0, 11.0)))
    store.write_camera(
        tmp_path / "c.yaml", one.camera, covariance=known, rms_px=0.1, noise=one.noise, timing=one.timing
    )
    rig = store.read_rig(tmp_path / "c.yaml", any_cameras=True)
    assert (rig.names, rig.rms_px) == (("camera",), 0.1)
    assert same_value((rig.noise, rig.timing), ((one.noise,), (one.timing,)))
    assert rig.covariance.std()["camera.fy"] == np.sqrt(2.0)
    assert is_close(rig.T_rig_camera("camera"), RigidTransform.identity(), tol_m=0.0, tol_rad=0.0)
    with refuses(UsageError, "left and right", "camera", "stereo"):
        store.read_rig(tmp_path / "c.yaml")


@pytest.mark.parametrize("V", [1, 2, 4])
def test_kalibrs_chain_of_any_length_comes_back(tmp_path, V):
    rig = make_rig(V, plain=True)
    rig_to_kalibr(tmp_path / "chain.yaml", rig)
    content = read_yaml(tmp_path / "chain.yaml")
    assert list(content) == [f"cam{k}" for k in range(V)]
    X = np.array([0.1, 0.2, 3.0])
    for k in range(1, V):  # what the format says of itself: points of the camera before go into this one
        before, here = (rig.cameras[j].T_rig_camera.inv().apply(X) for j in (k - 1, k))
        assert np.allclose(np.array(content[f"cam{k}"]["T_cn_cnm1"]) @ [*before, 1.0], [*here, 1.0], atol=1e-12)
    back = rig_from_kalibr(tmp_path / "chain.yaml")
    assert back.names == (("left", "right") if V == 2 else tuple(content))
    for got, one in zip(back.cameras, rig.cameras, strict=True):
        first = rig.cameras[0].T_rig_camera
        assert np.array_equal(got.camera.packed, one.camera.packed)
        assert is_close(got.T_rig_camera, first.inv() * one.T_rig_camera, tol_m=1e-12, tol_rad=1e-7)
