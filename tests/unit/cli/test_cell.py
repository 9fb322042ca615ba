"""armsight calibrate cell: from one recording to a cell's files, a report and the history; and what it refuses."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armsight.errors import Inconsistent
from armsight.ops.calibration.cell import by_camera, read_priors
from armsight.store import read_rig, read_target, read_world
from armsight.store.arm_file import read_arm
from armsight_lab.history.figures import parameters_of
from refusals import refuses
from simulated import simulated

Run = Callable[..., Any]
WRITTEN = {"rig.yaml", "world.yaml", "target.yaml", "arm.yaml", "cell.json", "report.html"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = shutil.copytree(simulated("cell", frames=600), tmp_path_factory.mktemp("cell") / "set")
    return folder


def words(folder: Path, out: Path, *more: object, **other: object) -> list[object]:
    """The command's words; other: flags with other values, None leaves one out; more: further words."""
    flags: dict[str, object] = {
        "robot-log": folder / "joints.csv",
        "left-spots": folder / "left.csv",
        "right-spots": folder / "right.csv",
        "size": "1280x720",
        "target": folder / "target.yaml",
        "model": folder / "arm.yaml",
        "tip": "0,0,80mm",
        "tolerance-mm": "0.5",
    }
    flags |= {name.replace("_", "-"): value for name, value in other.items()}
    given = [part for name, value in flags.items() if value is not None for part in (f"--{name}", value)]
    return ["calibrate", "cell", *given, *more, "-o", out]


@pytest.fixture(scope="module")
def done(made: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    from typer.testing import CliRunner

    from armsight.cli.commands import app

    out = tmp_path_factory.mktemp("out") / "cell"
    ran = CliRunner().invoke(app, [*map(str, words(made, out)), "--json"])
    assert ran.exit_code == 0, ran.stderr
    return out, json.loads(ran.stdout)


def test_the_cells_files_are_written_and_say_the_same(done: tuple[Path, Any]) -> None:
    out, got = done
    assert {file.name for file in out.iterdir()} == WRITTEN
    assert json.loads((out / "cell.json").read_text()) == got
    rig, world = read_rig(out / "rig.yaml"), read_world(out / "world.yaml")
    assert rig.baseline_m == pytest.approx(got["baseline_m"])
    assert all(timing is not None for timing in rig.timing)
    assert world.parent == "base"
    assert world.T_parent_rig.translation.tolist() == pytest.approx(got["T_base_rig"]["xyz_m"])
    assert world.covariance is not None
    assert world.covariance.std()["x_m"] == pytest.approx(got["std"]["x_m"])
    arm, target = read_arm(out / "arm.yaml"), read_target(out / "target.yaml")
    assert arm.covariance is not None
    assert target.covariance is not None
    assert arm.T_flange_tool.translation.tolist() == pytest.approx(got["T_flange_target"]["xyz_m"])
    assert [point.name for point in arm.tool_points] == list(target.names)


def test_the_history_sees_zeros_baseline_and_place(done: tuple[Path, Any]) -> None:
    out, got = done
    found = parameters_of(got, read_arm(out / "arm.yaml"))
    by_name = {one.name: one for one in found.quantities}
    assert by_name["baseline_m"].std == pytest.approx(got["baseline_std_m"])
    assert by_name["joint3.theta_rad"].std is not None
    assert [pose.name for pose in found.poses] == ["world"]


NO_SPOTS = {"left_spots": None, "right_spots": None}
WRONG: dict[str, tuple[dict[str, object], tuple[str, ...], int]] = {
    "no frames": (NO_SPOTS, ("which frames", "--left-spots"), 2),
    "small size": ({"size": "640x480"}, ("left.csv", "640x480", "--size"), 3),
    "no size at all": ({"size": "wide"}, ("wide",), 2),
    "no tip": ({"tip": "here"}, ("here", "X,Y,Z"), 2),
    "no such compliance": ({"compliance": "some"}, ("some", "auto"), 2),
    "another arm": ({"model": "kapucu2005"}, ("kapucu2005",), 2),
    "an arm of 7 joints": ({"model": "iiwa14"}, ("6 joints", "has 7"), 3),
}


def test_cameras_by_the_names_of_a_pair_are_the_pair_in_its_order() -> None:
    pair, named = (by_camera("a", "b", None), by_camera(None, None, {"right": "b", "left": "a"}))
    assert list(pair.items()) == list(named.items()) == [("left", "a"), ("right", "b")]


WRONG_NAMES: dict[str, tuple[tuple[str, ...], tuple[str, ...], int]] = {
    "twice": (
        ("--spots", "left={}/left.csv", "--left-spots", "{}/left.csv"),
        ("table of left is given twice", "one of the two"),
        2,
    ),
    "one source twice": (("--camera", "east=a.mp4", "--camera", "west=a.mp4"), ("east and west are both a.mp4",), 2),
    "no name": (("--camera", "rig=a.mp4"), ("'rig' is no name of a camera",), 3),
    "frames and tables": (("--camera", "east=a.mp4", "--spots", "west={}/left.csv"), ("which frames", "--spots"), 2),
    "one table of two": (("--spots", "a={}/left.csv", "--spots", "b={}/left.csv"), ("a and b hold the same spots",), 3),
    "live": (("--camera", "east=camera:0", "--camera", "west=camera:1"), ("live", "armsight record"), 2),
    "another rig": (
        ("--spots", "east={}/left.csv", "--spots", "west={}/right.csv", "--prior", "{}/other/rig.yaml"),
        ("of the cameras left, right", "recording of east, west", "leave it out"),
        3,
    ),
}


@pytest.mark.parametrize("name", WRONG_NAMES)
def test_wrong_names_of_cameras_are_refused(
    armsight: Run, made: Path, done: tuple[Path, Any], tmp_path: Path, name: str
) -> None:
    more, says, code = WRONG_NAMES[name]
    if not (made / "other").exists():
        shutil.copytree(done[0], made / "other")
    ran = armsight(*words(made, tmp_path / "cell", *(text.format(made) for text in more), **NO_SPOTS))
    assert ran.code == code, ran.text
    assert all(part in ran.text for part in says), ran.text
    assert not list(tmp_path.rglob("*.yaml"))


def test_a_place_of_another_camera_than_the_first_is_no_prior(done: tuple[Path, Any]) -> None:
    files = [done[0] / "rig.yaml", done[0] / "world.yaml"]
    assert read_priors(files, [(1280, 720)] * 2).base_pose is not None
    with refuses(Inconsistent, ("world.yaml", "camera right is not the one", "in the order of rig.yaml")):
        read_priors(files, [(1280, 720)] * 2, ("right", "left"))
    assert read_priors(files[:1], [(1280, 720)] * 2, ("right", "top")).rig.names == ("right",)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_call_is_refused(armsight: Run, made: Path, tmp_path: Path, name: str) -> None:
    other, says, code = WRONG[name]
    ran = armsight(*words(made, tmp_path / "cell", **other))
    assert ran.code == code, ran.text
    assert all(part in ran.text for part in says), ran.text
    assert not list(tmp_path.rglob("*.yaml"))


def test_a_size_that_is_not_the_images_is_refused(
    armsight: Run, made: Path, done: tuple[Path, Any], tmp_path: Path
) -> None:
    assert done[1]["verdict"].startswith("good")  # of the same tables with the images' own size
    ran = armsight(*words(made, tmp_path / "cell", size="1920x1080"))
    assert ran.code == 3, ran.text
    for part in ("left", "1920x1080", "hardly", "--size"):
        assert part in ran.text, ran.text
    assert not list(tmp_path.rglob("*.yaml"))


def test_plan_is_another_spelling_of_cell_plan_wherever_it_stands(armsight: Run, tmp_path: Path) -> None:
    words = ["--model", "ur5e", "--start", "0,-1,1,0,1,0", "--duration", "20", "-o", tmp_path / "motion.csv"]
    given = [armsight("calibrate", *spelt) for spelt in (["cell-plan", *words], ["cell", *words, "--plan"])]
    assert [done.code for done in given] == [0, 0]
    assert given[0].json == given[1].json and given[0].json["kind"] == "cautious"
    assert armsight("calibrate", "cell", "--plan", "--robot-log", "joints.csv").code == 2
