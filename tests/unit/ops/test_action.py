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

from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.cli.actions import add_action
from armsight.cli.command import Group
from armsight.columns import POSE7
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.calibrate_robot import calibrate_tool_tip
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
