"""Conversions between the file kinds, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armsight.errors import UsageError
from armsight.ops.conversion import convert_poses, convert_rig
from armsight.optics import Camera
from armsight.optics.mirrors import Mirrors
from armsight.store import read_poses, read_rig, write_rig
from refusals import refuses

CAMERA = Camera.pinhole(640, 480, 612.5, 611.0, 318.2, 241.7, distortion=(-0.21, 0.07, 1e-4, -2e-4, 0.0))


def test_a_mirror_rig_goes_out_as_two_pinholes(tmp_path: Path) -> None:
    own, foreign, back = tmp_path / "own.yaml", tmp_path / "out.yaml", tmp_path / "back.yaml"
    mirrors = Mirrors(baseline_m=0.1).rig(Camera.pinhole(768, 576, 1000.0, 1000.0, 383.5, 287.5))
    write_rig(own, mirrors)
    assert read_rig(own).left.plate == mirrors.left.plate
    done = convert_rig([own], [foreign], to="kalibr")
    assert "pinholes" in done.note
    convert_rig([foreign], [back])
    X = np.array([[0.02, 0.01, 0.5], [-0.05, 0.03, 0.7]])
    T = read_rig(back).T_rig_left * mirrors.T_rig_left.inv()  # Kalibr's axes are those of its first camera
    for got, seen in zip(read_rig(back).project(T.apply(X)), mirrors.project(X), strict=True):
        assert np.abs(got - seen).max() < 1.0  # the pinhole's centre lies a little off the glass's


def test_poses_go_to_tum_and_back(tmp_path: Path) -> None:
    source, tum, back = tmp_path / "poses.csv", tmp_path / "poses.tum", tmp_path / "back.csv"
    source.write_text("t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0.5,1,2,3,0,0,0,1\n0.75,1,2,3.5,0,0,0.6,0.8\n")
    assert convert_poses(source, tum).n == 2
    assert convert_poses(tum, back).n == 2
    for one, two in zip(read_poses(source), read_poses(back), strict=True):
        assert one.t_s == two.t_s
        np.testing.assert_array_equal(one.pose.as_matrix(), two.pose.as_matrix())
    with refuses(UsageError, "conversion", "poses"):
        convert_poses(source, tmp_path / "poses.json")
