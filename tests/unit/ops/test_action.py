"""An action's signature is what the command line asks for and Python checks; files and objects come to the same."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import typer
import yaml
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

import armsight as face
from armsight.calibrate.handeye import PosePairs
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.cli.actions import add_action
from armsight.cli.command import Group
from armsight.columns import POSE7
from armsight.errors import ArmsightError, Inconsistent, UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.calibrate_cell import calibrate_cell
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.calibrate_robot import calibrate_tool_tip
from armsight.store.handeye_file import write_pairs
from refusals import refuses

TIP = np.array([0.0, 0.0, 0.2])


@pytest.fixture
def poses() -> RigidTransform:
    turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    noise = np.random.default_rng(2).normal(0.0, 1e-4, (20, 3))
    return RigidTransform.from_components(noise - turn.apply(TIP), turn)


@pytest.fixture
def table(poses: RigidTransform, tmp_path: Path) -> Path:
    rows = np.hstack([poses.translation, poses.rotation.as_quat(canonical=True)])
    lines = [",".join(POSE7), *(",".join(map(repr, map(float, row))) for row in rows)]
    path = tmp_path / "poses.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_arrays_a_file_and_the_command_line_come_to_the_same(
    poses: RigidTransform, table: Path, tmp_path: Path, armsight: Any
) -> None:
    of_arrays = calibrate_tool_tip(poses)
    of_file = calibrate_tool_tip(table, out=tmp_path / "python.yaml")
    done = armsight("calibrate", "tooltip", "--poses", table, "-o", tmp_path / "command.yaml")
    assert done.code == 0
    assert of_file.tip_m == pytest.approx(of_arrays.tip_m, abs=1e-12)
    assert done.json == json.loads(of_file.to_json())
    python, command = (yaml.safe_load((tmp_path / f"{name}.yaml").read_text()) for name in ("python", "command"))
    assert python["inputs"] == command["inputs"] and python["tip_m"] == command["tip_m"]
    assert yaml.safe_load(of_arrays.save(tmp_path / "saved.yaml").read_text())["tip_m"] == of_arrays.tip_m.tolist()


def test_bounds_and_kinds_are_pythons_too(poses: RigidTransform, tmp_path: Path) -> None:
    with refuses(UsageError, "point_std_m"):
        calibrate_tool_tip(poses, point_std_m=0.0)
    with refuses(UsageError, "point_std_m"):
        calibrate_tool_tip(poses, point_std_m="far")  # type: ignore[arg-type]
    with refuses(Inconsistent, "T_world_target"):
        calibrate_tool_tip(np.ones((3, 4, 4)))
    with pytest.raises(TypeError):
        calibrate_tool_tip()  # type: ignore[call-arg]
    assert not list(tmp_path.iterdir())


def test_a_result_of_before_is_still_reached_through_detail(poses: RigidTransform) -> None:
    done = calibrate_tool_tip(poses)
    with pytest.warns(DeprecationWarning):
        assert done.detail is done
    assert "residual" in repr(done) and len(done.plot().data[0].y) == 20


def length(name: str, value: Any, given: Any, undo: Any) -> int:
    return len(Path(value).read_text()) if isinstance(value, Path) else len(value)


@action("probe measure")
def measure(
    text: Annotated[Any, Doc("What is measured."), Input(f"{__name__}:length")],
    *,
    reach_m: Annotated[float, Doc("How far."), Bounds(least=0.1, most=2.0), Flag("--reach", quantity="m")] = 0.5,
    hidden: int = 3,
    out: Annotated[Path | None, Doc("Where to."), Flag("-o --out", needed=True)] = None,
) -> ToolTipResult:
    """Measure a text.

    Parameters
    ----------
    text
        Any.
    """
    raise Inconsistent(f"{text} of {reach_m} and {hidden}")


def probe(monkeypatch: pytest.MonkeyPatch, *words: str) -> Any:
    import sys

    monkeypatch.setitem(sys.modules, measure.__module__, inspect.getmodule(measure))
    app = typer.Typer(cls=Group)
    add_action(app, measure)
    add_action(app, calibrate_tool_tip)
    return CliRunner().invoke(app, words)


def test_flags_are_what_has_a_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    text = probe(monkeypatch, "measure", "--help").output
    assert "--reach" in text and "--text" in text and "--out" in text
    assert "hidden" not in text and "Parameters" not in text
    assert probe(monkeypatch, "measure", "--text", "a").exit_code == 2, "the command line needs -o"
    assert probe(monkeypatch, "measure", "--text", "a", "--reach", "3m", "-o", "b").exit_code == 2


def test_a_flag_reaches_its_parameter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "four").write_text("four")
    out = str(tmp_path / "out.yaml")
    done = probe(monkeypatch, "measure", "--text", str(tmp_path / "four"), "--reach", "1500mm", "-o", out)
    assert done.exit_code == 3 and "4 of 1.5 and 3" in done.output
    with pytest.raises(Inconsistent, match=r"5 of 0.5 and 4"):
        measure("three", hidden=4)


@pytest.fixture
def pairs(tmp_path: Path) -> tuple[RigidTransform, RigidTransform, Path]:
    """Poses of flange and target in camera axes, and a pairs.csv of them."""
    rng = np.random.default_rng(3)
    flange, noise = (
        RigidTransform.from_components(
            rng.normal(0.0, size, (12, 3)), Rotation.from_rotvec(rng.normal(0.0, turn, (12, 3)))
        )
        for size, turn in ((0.2, 0.5), (2e-4, 2e-4))
    )
    X = RigidTransform.from_translation([0.0, 0.05, 0.1])
    seen = noise * (flange * X).inv() * RigidTransform.from_translation([0.5, 0.0, 0.0])
    write_pairs(tmp_path / "pairs.csv", PosePairs.of(list(flange), list(seen), [str(i) for i in range(12)]))
    return flange, seen, tmp_path / "pairs.csv"


def test_a_hand_eye_calibration_is_the_same_from_poses_a_table_and_the_command_line(
    pairs: tuple[RigidTransform, RigidTransform, Path], tmp_path: Path, armsight: Any
) -> None:
    flange, seen, table = pairs
    out = tmp_path / "python.yaml"
    of_poses, of_table = calibrate_hand_eye(flange, seen), calibrate_hand_eye(pairs=table, out=out, propose=1)
    done = armsight("calibrate", "handeye", "--pairs", table, "-o", tmp_path / "command.yaml", "--propose", "1")
    assert of_poses.T_flange_camera == pytest.approx(of_table.T_flange_camera, abs=1e-9)
    assert done.json == json.loads(of_table.to_json())
    assert yaml.safe_load(out.read_text())["inputs"][0]["path"] == table.as_posix()
    assert out.with_suffix(".report.html").is_file() and len(of_table.plot().data[0].y) == 12
    with refuses(Inconsistent, "T_base_camera", "eye-in-hand"):
        _ = of_table.T_base_camera
    for wrong in ({}, {"pairs": table, "robot_stream": table}, {"images": "photos"}, {"robot_stream": table}):
        with pytest.raises(UsageError):
            calibrate_hand_eye(**wrong)


def test_names_of_earlier_versions_warn_and_do_the_same(pairs: tuple[RigidTransform, RigidTransform, Path]) -> None:
    flange, seen, _ = pairs
    t_s = np.arange(12.0)
    with pytest.warns(DeprecationWarning), pytest.raises(ArmsightError):  # too short for streams
        face.calibrate_hand_eye_from_streams((t_s, flange), (t_s, seen))
    with pytest.warns(DeprecationWarning), pytest.raises(ArmsightError):
        face.calibrate_hand_eye_from_images("no-such-folder", flange, "camera.yaml", "checkerboard:9x6:0.02")
    with pytest.warns(DeprecationWarning):
        assert calibrate_hand_eye(flange, seen).detail.n_used == 12


def test_results_are_not_written_over_what_they_are_made_of(tmp_path: Path) -> None:
    (tmp_path / "target.yaml").write_text("")
    with refuses(UsageError, "target.yaml"):
        calibrate_cell(tmp_path / "log.csv", tmp_path / "target.yaml", "ur10", out=tmp_path)
