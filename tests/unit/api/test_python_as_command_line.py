"""The Python face does what the command line does: every flag has a name, types are told, units and words agree."""

from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

import armsight
from hand_cell import hand_cell, pictures
from loading import module_of
from refusals import refuses

ROOT = Path(__file__).resolve().parents[3]


def test_every_flag_of_the_parser_has_a_python_name_or_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    python_flags = module_of(ROOT / "tools" / "python_flags.py")
    assert "| measure | `--rig` | `measure(rig)` |" in python_flags.table()
    monkeypatch.setattr(python_flags, "flags", lambda: iter([("measure", "--planted")]))
    with refuses(SystemExit, "measure", "--planted"):
        python_flags.table()


def test_importing_all_and_dir_agree_and_packages_hide_no_function() -> None:
    names: dict[str, object] = {}
    exec("from armsight import *", names)
    assert set(names) - {"__builtins__"} == set(dir(armsight)) == set(armsight.__all__)
    for package in ("measure.settings", "verify.pairing"):
        import_module(f"armsight.{package}")
    assert callable(armsight.measure) and callable(armsight.verify)


def test_measure_is_the_same_from_arrays_files_and_a_recording(tmp_path: Path) -> None:
    for side, images in (("left", pictures("left")), ("right", pictures("right"))):
        (tmp_path / side).mkdir()
        for i, image in enumerate(images):
            cv2.imwrite(str(tmp_path / side / f"{i}.png"), image)
    rig, target = hand_cell().rig.save(tmp_path / "rig.yaml"), hand_cell().target.save(tmp_path / "target.yaml")
    one = armsight.measure(hand_cell().rig, hand_cell().target, pictures("left"), pictures("right"))
    two = armsight.measure(str(rig), target, tmp_path / "left", tmp_path / "right", out=tmp_path / "run")
    armsight.record(tmp_path / "run.mcap", pictures("left"), pictures("right"), rig=hand_cell().rig, target=target)
    three = armsight.measure(hand_cell().rig, hand_cell().target, tmp_path / "run.mcap")
    assert one.poses == two.poses
    told, read = two.poses.table(), armsight.read_poses(tmp_path / "run" / "poses.csv").table()
    assert told.pop("status") == read.pop("status") and told.keys() == read.keys()
    for name, column in told.items():
        np.testing.assert_allclose(column, read[name], atol=1e-12)
    assert one.n_ok == two.n_ok == three.n_ok == 3
    assert one.plot() is not None and one != three
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["left", "right", "rig.yaml", "run", "run.mcap", "target.yaml"]
    )


def test_twelve_bits_are_the_same_in_arrays_and_files_and_never_cut(tmp_path: Path) -> None:
    deep = pictures("left")[0].astype(np.uint16) * 16 + 7
    assert deep.max() < 4096
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    np.testing.assert_array_equal(
        armsight.find_spots(deep, bits=12).uv_px, armsight.find_spots(tmp_path / "deep.png", bits=12).uv_px
    )
    for image in (deep, tmp_path / "deep.png"):
        with pytest.raises(armsight.BadImage, match="bits"):
            armsight.find_spots(image)
        with pytest.raises(armsight.BadImage):
            armsight.find_spots(image, bits=9)


def test_a_lost_pose_raises_the_reason_and_still_shows_itself() -> None:
    lost = armsight.estimate_pose(
        np.zeros_like(pictures("left")[0]), np.zeros_like(pictures("right")[0]), hand_cell().rig, hand_cell().target
    )
    assert not lost.ok and lost.why and "lost" in repr(lost) and lost.to_dict()["T_rig_target"] is None
    for name in ("T_rig_target", "xyz_m", "covariance", "std"):
        with refuses(armsight.NotEnoughData, "lost"):
            getattr(lost, name)


def test_endings_decide_and_no_folder_is_made(tmp_path: Path) -> None:
    arm = armsight.presets.ur10()
    assert "<robot" in arm.save(tmp_path / "a.urdf").read_text()
    assert armsight.read_arm(tmp_path / "a.urdf").n == 6
    with refuses(armsight.UsageError, ".yaml", ".yml", ".urdf"):
        arm.save(tmp_path / "a.txt")
    with refuses(armsight.UsageError, "no folder"):
        arm.save(tmp_path / "nowhere" / "a.yaml")
    assert not (tmp_path / "nowhere").exists()


def test_errors_name_parameters_and_functions_not_flags() -> None:
    for call in (
        lambda: armsight.measure(hand_cell().rig, hand_cell().target),
        lambda: armsight.measure(
            hand_cell().rig, hand_cell().target, pictures("left"), pictures("right"), rate_hz=10.0
        ),
        lambda: armsight.verify(hand_cell().T_rig_target, arm="ur10"),
        lambda: armsight.jog("sim:webcam-cell", 1, 0.01),
        lambda: armsight.join((hand_cell().t_s, hand_cell().T_rig_target)),
    ):
        with pytest.raises(armsight.ArmsightError) as caught:
            call()
        assert "--" not in str(caught.value) and "armsight-" not in str(caught.value)
