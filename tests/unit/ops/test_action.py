"""An action's signature is what the command line asks for and Python checks; files and objects come to the same."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass
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
from armsight.fields import Bounds, Doc, Flag, marks
from armsight.kinematics import fk, moved, preset
from armsight.ops.action import Input, action
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.calibrate_robot import calibrate_arm, calibrate_robot_world, calibrate_tool_tip
from armsight.store.handeye_file import write_pairs
from refusals import refuses

TIP = np.array([0.0, 0.0, 0.2])
RIG = RigidTransform.from_components([0.9, -0.2, 0.5], Rotation.from_rotvec([0.2, 1.4, -0.3]))
"""Where the rig stands, T_base_rig."""
ARM = preset("irb120")
READINGS = ",".join([*(f"q{i}" for i in range(1, 7)), *POSE7[:3]])


def table(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text("\n".join([header, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
    return path


@dataclass(frozen=True)
class Case:
    """An action, what it is given as files, and what Python takes in their place."""

    call: Callable[..., Any]
    given: dict[str, Path | str]
    arrays: dict[str, Any]


def tips(folder: Path) -> Case:
    turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    noise = np.random.default_rng(2).normal(0.0, 1e-4, (20, 3))
    poses = RigidTransform.from_components(noise - turn.apply(TIP), turn)
    rows = np.hstack([poses.translation, poses.rotation.as_quat(canonical=True)])
    return Case(
        call=calibrate_tool_tip,
        given={"T_world_target": table(folder / "poses.csv", ",".join(POSE7), rows)},
        arrays={"T_world_target": poses},
    )


def arms(folder: Path) -> Case:
    true = moved(ARM, {f"{ARM.joints[1].name}.theta_rad": np.deg2rad(1.0)})
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.9, 0.9, (40, 6))
    xyz_m = fk(true, q)[:, :3, 3] + rng.normal(0.0, 1e-4, (40, 3))
    return Case(
        call=calibrate_arm,
        given={"nominal": "irb120", "q": table(folder / "points.csv", READINGS, np.hstack([q, xyz_m]))},
        arrays={"nominal": ARM, "q": q, "xyz_m": xyz_m},
    )


def placed(folder: Path) -> Case:
    q = np.random.default_rng(0).uniform(-0.9, 0.9, (60, 6))
    places = fk(ARM, q)[:, :3, 3] + np.random.default_rng(1).normal(0.0, 1e-4, (60, 3))
    xyz_m = RIG.inv().apply(places)
    return Case(
        call=calibrate_robot_world,
        given={"arm": "irb120", "q": table(folder / "observed.csv", READINGS, np.hstack([q, xyz_m]))},
        arrays={"arm": ARM, "q": q, "xyz_m": xyz_m},
    )


@pytest.fixture(params=[tips, arms, placed], ids=lambda make: make.__name__)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> Case:
    (tmp_path / "in").mkdir()
    made: Case = request.param(tmp_path / "in")
    return made


def test_arrays_and_files_come_to_the_same(case: Case, tmp_path: Path) -> None:
    of_files = case.call(**case.given, out=tmp_path / "out.yaml")
    out = yaml.safe_load((tmp_path / "out.yaml").read_text())
    assert len(out["inputs"]) == sum(isinstance(one, Path) for one in case.given.values())
    of_arrays = case.call(**case.arrays).to_dict()
    assert of_arrays["verdict_"]["level"] == of_files.to_dict()["verdict_"]["level"] == "good"
    assert of_arrays.keys() == of_files.to_dict().keys() and of_files.title in repr(of_files)


def test_what_goes_beside_a_result_is_no_input_either(tmp_path: Path) -> None:
    case = arms(tmp_path)
    points = case.given["q"].rename(tmp_path / "arm.corrections.csv")  # type: ignore[union-attr]  # a path
    with refuses(UsageError, "arm.corrections.csv", "out"):
        calibrate_arm("irb120", points, out=tmp_path / "arm.yaml")
    assert not (tmp_path / "arm.yaml").exists()


def test_bounds_and_kinds_are_pythons_too(case: Case, tmp_path: Path) -> None:
    out, hints = tmp_path / "out.yaml", vars(case.call)["action"].hints
    bounded = {name: hint for name, hint in hints.items() if marks(hint, Bounds)}
    for name, wrong in [(name, -1.0) for name in bounded] + [(name, "far") for name in bounded] + [("out", 3)]:
        with refuses(UsageError, name):
            case.call(**{**case.arrays, "out": out, name: wrong})
    for name in case.arrays:
        with pytest.raises((UsageError, Inconsistent), match=name):
            case.call(**{**case.arrays, "out": out, name: object()})
    with pytest.raises(TypeError):
        case.call()
    assert not out.exists()


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
    for name in ("ArmIdentification", "LiveIdentification"):
        with pytest.warns(DeprecationWarning, match="Identification"):
            assert getattr(face, name) is face.Identification
    with pytest.warns(DeprecationWarning):
        assert calibrate_hand_eye(flange, seen).detail.n_used == 12
