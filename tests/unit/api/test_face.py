"""The public names: all there, loaded when used, and deaf to no wrong argument."""

import ast
import pkgutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

import armsight
from hand_cell import CAMERA, LIGHTS, drawn
from refusals import refuses


def rig() -> armsight.Rig:
    from armsight.optics import parallel_rig

    return parallel_rig(CAMERA, 0.1)


def test_importing_armsight_loads_nothing_heavy() -> None:
    heavy = ("numba", "numpy", "cv2", "scipy", "pydantic")
    code = f"import sys, armsight; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_resolves_and_type_checkers_see_the_same() -> None:
    for name in dir(armsight):
        assert getattr(armsight, name) is not None
    tree = ast.parse(Path(armsight.__file__).read_text(encoding="utf-8"))
    typed = {
        name: str(node.module)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.col_offset
        for alias in node.names
        for name in (import_module(str(node.module)).__all__ if alias.name == "*" else [alias.asname])
        if name
    }
    assert typed == armsight._places()
    packages = {module.name for module in pkgutil.iter_modules(armsight.__path__)}
    assert packages & set(typed) == set(armsight._PACKAGES)
    with refuses(AttributeError, "nonsense", "attribute"):
        _ = armsight.nonsense


def test_a_pose_from_arrays_is_the_true_one_and_shows_itself() -> None:
    left, right = drawn()
    result = armsight.estimate_pose(left, right, rig(), armsight.LightTarget(LIGHTS))
    assert result.ok and result.lights == ("A", "B", "C")
    error = result.xyz_m - (0.05, 0.0, 0.5)
    assert (np.abs(error) < 5.0 * np.array([result.std[k] for k in ("x_m", "y_m", "z_m")])).all()
    assert "+-" in repr(result) and "<table>" in result._repr_html_()
    shown_mm = [float(text.split()[0]) for _, text in result.rows()[:3]]
    np.testing.assert_allclose(shown_mm, 1e3 * result.xyz_m, atol=0.1)
    assert result.to_dict()["T_rig_target"][0][3] == result.T_rig_target[0, 3]
    left[:] = 0  # the caller's arrays stay his own: nothing froze them


def test_a_tracker_keeps_its_poses_and_refuses_time_that_stands(tmp_path: Path) -> None:
    tracker = armsight.PoseTracker(rig(), armsight.LightTarget(LIGHTS))
    for i in range(4):
        assert tracker.update(*drawn((0.05 + 0.001 * i, 0.0, 0.5)), 0.02 * i).ok
    assert tracker.consistency.verdict == "ok"
    with refuses(armsight.Inconsistent, "0.06 s"):
        tracker.update(*drawn(), 0.06)
    track = armsight.read_poses(tracker.track.save(tmp_path / "poses.csv"))
    np.testing.assert_allclose(track.T_parent_target, tracker.track.T_parent_target, atol=1e-12)
    assert len(track.table()["x_m"]) == 4 and isinstance(track.plot(), go.Figure)
    tracker.reset()
    assert tracker.update(*drawn(), 0.0).ok and len(tracker.track) == 1


def test_an_arm_is_taken_as_a_record_by_its_name_and_as_a_file(tmp_path: Path) -> None:
    arm = armsight.presets.ur10()
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (20, 6))
    seen = arm.fk(q)[:, :3, 3] - [0.0, 0.0, 1.0]
    for one in (arm, "ur10", arm.save(tmp_path / "arm.yaml")):
        assert armsight.calibrate_robot_world(one, q, seen).T_base_rig[2, 3] == pytest.approx(1.0)
    with refuses(armsight.UsageError, "ur99", "by name"):
        armsight.calibrate_arm("ur99", q, seen)
    with refuses(armsight.UsageError, "ndarray"):
        armsight.calibrate_robot_world(q, q, seen)  # type: ignore[arg-type]
