"""The guided step Mirrors: alignment told live, samples taken and dropped, and the command's own result."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from armsight.app.guided.mirror_alignment import COARSE_RAD, MirrorAlignment
from armsight.app.guided.mirrors import MirrorsStep
from armsight.app.guided.step import Next
from armsight.app.guided.step_runner import History, figures_of
from armsight.app.live.measurement import LiveJob
from armsight.console import texts
from armsight.console.pages.mirrors import turn_words
from armsight.console.state import Console, steps_of
from armsight.errors import BadImage, UsageError
from armsight.ops.calibrate_mirrors import calibrate_mirrors
from armsight.optics import Camera
from armsight.records import Silent
from armsight.store import read_rig, write_camera
from armsight.store.cell_file import COMPLEX, CellFile, CellMirrors, read_cell
from refusals import refuses


@dataclass
class OnePicture:
    """Stands for a station: gives the pictures of a folder one after the other, round and round."""

    folder: Path
    names: tuple[str, ...] = (COMPLEX,)
    taken: int = 0

    @property
    def job(self) -> LiveJob:
        return LiveJob(cameras=dict.fromkeys(self.names, str(self.folder)))

    def save(self, wanted: dict[str, Path]) -> None:
        (goal,) = wanted.values()
        files = sorted(self.folder.iterdir())
        goal.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(files[self.taken % len(files)], goal)
        self.taken += 1


def step_of(mirror_boards: Any, folder: Path, **more: Any) -> MirrorsStep:
    return MirrorsStep(
        board=mirror_boards.board, built=CellMirrors(), folder=folder / "mirrors", out=folder / "rig.yaml", **more
    )


@pytest.fixture(scope="module")
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A step led to its end, and the figures as they went."""
    made, folder = request.getfixturevalue("mirror_boards"), tmp_path_factory.mktemp("step")
    stale = folder / "mirrors" / "image" / "099.png"
    stale.parent.mkdir(parents=True)
    shutil.copy(next(made.off.iterdir()), stale)
    step, station, history = step_of(made, folder), OnePicture(made.straight), History()
    hints = [step.hint()]
    for _ in range(8):
        step.accept(station)  # type: ignore[arg-type]
        hints.append(step.hint())
        history.remember(len(step.samples), figures_of(step))
    return step, hints, history, step.run(Silent()), folder


def test_it_leads_to_the_result_of_the_command(done: Any, mirror_boards: Any) -> None:
    step, hints, _, verdict, folder = done
    assert [hint.what for hint in hints[:2]] == [Next.BOARD_TWICE, Next.TO_CELL]
    assert hints[1].side == COMPLEX
    assert len(list((folder / "mirrors" / "image").iterdir())) == 8, "what an earlier calibration left is gone"
    again = calibrate_mirrors(mirror_boards.straight, mirror_boards.board)
    rows = dict(verdict.rows)
    assert rows["baseline"].startswith(f"{1e3 * again.baseline_m:.2f} ± ") and rows["images used"] == "8 of 8"
    assert {name for name, _ in (*step.spread(), *verdict.rows)} <= set(texts.ROW_NAMES)
    assert verdict.verdict.level == "care"  # few boards leave a part of both views bare
    assert verdict.verdict.to_dict() == again.verdict_.to_dict()
    assert verdict.file == folder / "rig.yaml" and verdict.report is not None
    rig, fx = read_rig(verdict.file), mirror_boards.camera[0]
    assert rig.kind == "mirror" and rig.left.intrinsics[0] == pytest.approx(fx, rel=0.01)
    assert rig.baseline_m == pytest.approx(mirror_boards.baseline_m, abs=2e-3)


def test_a_picture_without_both_views_is_not_taken(mirror_boards: Any, boards: Any, tmp_path: Path) -> None:
    step = step_of(mirror_boards, tmp_path)
    with pytest.raises(BadImage, match="once"):
        step.accept(OnePicture(boards.folder / "left"))  # type: ignore[arg-type]
    assert step.samples == () and not list(tmp_path.rglob("*.png"))
    with refuses(UsageError, "two cameras"):
        step.accept(OnePicture(mirror_boards.straight, names=("left", "right")))  # type: ignore[arg-type]


def lens(mirror_boards: Any, folder: Path) -> Path:
    write_camera(folder / "camera.yaml", Camera.pinhole(640, 480, *mirror_boards.camera))
    return folder / "camera.yaml"


def test_alignment_tells_which_mirror_to_turn_and_which_way(mirror_boards: Any, tmp_path: Path) -> None:
    alignment = MirrorAlignment(
        board=mirror_boards.board,
        built=CellMirrors(baseline_m=mirror_boards.baseline_m),
        folder=tmp_path,
        camera=lens(mirror_boards, tmp_path),
    )
    off = alignment.look(OnePicture(mirror_boards.off))  # type: ignore[arg-type]
    turn, tilt = mirror_boards.tilt
    assert alignment.to_parallel and not off.done and [one.mirror for one in off.turns] == [2]
    assert (off.turns[0].turn_rad, off.turns[0].tilt_rad) == pytest.approx((-turn, -tilt), abs=7e-4)
    words = turn_words(off.turns[0])
    assert words.startswith("Mirror 2: turn ") and "anticlockwise" in words and "back" in words
    alignment.hold_against(parallel=True)  # begins anew
    station: Any = OnePicture(mirror_boards.straight)
    straight = [alignment.look(station) for _ in range(3)][-1]
    assert straight.done and straight.turns == () and 0.0 < straight.std_rad < COARSE_RAD
    assert len(alignment.looks) == 3 and not list(tmp_path.glob("*.png"))
    told = replace(straight.check.change_std, drx_rad=2.0 * COARSE_RAD)
    vague = replace(straight, check=replace(straight.check, change_std=told))
    assert vague.unsure and not vague.done, "what is not known is not called good"


def test_the_cell_keeps_how_the_mirrors_were_built(tmp_path: Path) -> None:
    console = Console(folder=tmp_path, cell=CellFile(left="camera:0"))
    assert console.step("mirrors").name == "mirrors" and "stereo" not in steps_of(console)
    console.set_mirrors(CellMirrors(baseline_m=0.12, plate_m=0.0))
    assert read_cell(tmp_path).mirrors == CellMirrors(baseline_m=0.12, plate_m=0.0)
    assert console.mirror_alignment().built.baseline_m == 0.12
    two = Console(folder=tmp_path, cell=CellFile(left="camera:0", right="camera:1"))
    assert {"mirrors", "stereo"} <= set(steps_of(two)) <= set(texts.STEPS)
    with refuses(UsageError, "one camera", "left, right"):
        two.step("mirrors")


def test_every_hint_has_its_words() -> None:
    assert set(texts.NEXT) == {str(what) for what in Next}
