"""armsight calibrate mirrors and complex images measured, on images painted ray by ray."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import erf
from typer.testing import CliRunner

from armsight.calibrate.mirrors.result import reasons
from armsight.cli.actions import action_of
from armsight.cli.commands import app
from armsight.drivers import MomentSource
from armsight.errors import Inconsistent, NotEnoughData, Unseen
from armsight.measure.results import MeasureResult
from armsight.ops import measure as ops
from armsight.ops.calibration import mirrors, mirrors_lit_target
from armsight.ops.simulation.run import simulate
from armsight.ops.sources.frames import complex_pairs, open_source
from armsight.optics import Camera, parallel_rig
from armsight.records import NotSeen, PoseStatus
from armsight.store import read_poses, read_rig, write_rig
from armsight_sim.lens import Lens
from armsight_sim.rigs import MirrorLens, Mirrors, mirror_views
from refusals import refuses

Array = NDArray[np.float64]
Tilts = tuple[tuple[float, float], ...]

WIDTH, HEIGHT = 720, 540
COLUMNS, ROWS, SQUARE_M = 7, 5, 0.02
BOARD = f"checkerboard:{COLUMNS}x{ROWS}:{SQUARE_M}"
BLACK, WHITE, ROOM = 12.0, 95.0, 35.0
BLUR_PX = 0.7


def measure(**given: Any) -> MeasureResult:
    """Measure as the command line does, and refuse in its words."""
    done: MeasureResult = action_of(ops.measure).run(given)  # type: ignore[assignment]  # what it returns
    return done


def step(x: Array, at: Array | float, width: Array) -> Array:
    return np.asarray(0.5 + 0.5 * erf((x - at) / (np.sqrt(2.0) * width)))


def paint(view: MirrorLens, R: Array, t: Array) -> Array:
    """The board's light (h, w): every pixel's ray traced through the mirrors to the board's plane, edges blurred."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    place, ray = view.mirrors.trace(view.side, view.rays(np.stack([u.ravel(), v.ravel()], axis=1)))
    along = ((t - place) @ R[:, 2]) / (ray @ R[:, 2])
    X = (place + along[:, None] * ray - t) @ R / SQUARE_M
    width = BLUR_PX * along / (view.focal_px[0] * SQUARE_M)
    value = np.ones(len(X))
    inside, paper = np.ones(len(X)), np.ones(len(X))
    for x, n in ((X[:, 0], COLUMNS), (X[:, 1], ROWS)):
        k: Array = np.clip(np.rint(x), 0, n - 1)
        value *= np.where(k % 2 == 0, 1.0, -1.0) * (2.0 * step(x, k, width) - 1.0)
        inside *= step(x, -1.0, width) - step(x, float(n), width)
        paper *= step(x, -2.0, width) - step(x, n + 1.0, width)
    squares = 0.5 * (BLACK + WHITE) + 0.5 * (WHITE - BLACK) * value
    level = ROOM * (1.0 - paper) + paper * (WHITE * (1.0 - inside) + inside * squares)
    return np.asarray(level.reshape(HEIGHT, WIDTH))


def pictures(folder: Path, seed: int, count: int, tilts: Tilts = ((0.0, 0.0),) * 4, *, complex_only: bool) -> None:
    """Write `count` complex images, or as many of the left and of the right view alone."""
    rng = np.random.default_rng(seed)
    lens = Lens(width=WIDTH, height=HEIGHT, focal_px=(600.0, 601.0), centre_px=(361.0, 266.0))
    views = mirror_views(lens, Mirrors(baseline_m=0.1, tilts_rad=tilts))
    size = SQUARE_M * np.array([COLUMNS - 1, ROWS - 1, 0.0])
    rim = SQUARE_M * np.array([[x, y, 0.0] for x in (-2.0, COLUMNS + 1.0) for y in (-2.0, ROWS + 1.0)])
    done = 0
    while done < count:
        R = Rotation.from_euler("xyz", rng.uniform(-0.45, 0.45, 3)).as_matrix()
        z = rng.uniform(0.3, 0.5)
        t = z * np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.25, 0.25), 1.0]) - R @ (size / 2)
        if any(
            ((uv < 4) | (uv > [WIDTH - 5, HEIGHT - 5])).any()
            for uv in (v.project(rim @ R.T + t) for v in views.values())
        ):
            continue
        light = {side: paint(view, R, t) for side, view in views.items()}
        out = {"image": light["left"] + light["right"]} if complex_only else {k: 20.0 + v for k, v in light.items()}
        for name, image in out.items():
            (folder / name).mkdir(parents=True, exist_ok=True)
            noisy = np.clip(np.rint(image + rng.normal(0.0, 1.0, image.shape)), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / name / f"{done:03d}.png"), noisy)
        done += 1


def run(*arguments: str) -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(app, ["calibrate", "mirrors", *arguments, "--json"])
    return result.exit_code, json.loads(result.stdout)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig calibrated from covered views and complex images together."""
    folder = tmp_path_factory.mktemp("mirrors")
    pictures(folder, 1, 9, complex_only=False)
    pictures(folder, 2, 2, complex_only=True)
    out = folder / "rig.yaml"
    code, content = run(
        "--left-only", str(folder / "left"), "--right-only", str(folder / "right"), "--image", str(folder / "image"),
        "--board", BOARD, "-o", str(out), "--plate-mm", "1",
    )  # fmt: skip
    assert code == 0, content
    assert content["n_pairs"] == 11 and content["n_used"] >= 10
    assert content["baseline_m"] == pytest.approx(0.10033, abs=1e-4)  # the plate's shift included
    assert content["alignment"]["plate"]["m_m"] == pytest.approx(0.32914e-3, abs=1e-8)
    assert abs(content["alignment"]["convergence_rad"]) < 3e-4 and abs(content["alignment"]["vertical_px"]) < 0.1
    assert content["rms_px"] < 0.05 and content["holdout_rms_px"] < 0.06
    assert content["metric"]["mean_m"] == pytest.approx(SQUARE_M, rel=2e-3)
    assert (folder / "rig.report.html").stat().st_size > 10_000
    return out


def measured_complex(folder: Path, method: str) -> tuple[MeasureResult, Any]:
    """The summary of twelve complex frames, and the root mean square errors of their positions."""
    job = {
        "rig": folder / "rig.yaml",
        "target": folder / "target.yaml",
        "out": folder / method,
        "image": str(folder / "image"),
        "method": method,
    }
    summary = measure(**job)
    assert summary.n_ok == 12 if method == "likelihood" else summary.n_ok >= 10  # coarse spots may leave a tilt open
    rows = zip(*(read_poses(file) for file in (folder / "truth.csv", folder / method / "poses.csv")), strict=True)
    whole = [(truth.pose, found.pose) for truth, found in rows if found.status is PoseStatus.OK]
    off = np.array([found.translation - truth.translation for truth, found in whole])
    return summary, np.sqrt(np.mean(off**2, axis=0))


def test_complex_frames_of_a_room_are_measured(tmp_path: Path) -> None:
    """The same before a workshop: as well as is claimed, and the paper's threshold gives nothing instead of a place."""
    simulate("pachidis2005-static", tmp_path, seed=3, frames=12)
    summary, errors = measured_complex(tmp_path, "likelihood")
    assert summary.std is not None
    claimed = np.array(summary.std.total.translation_m)
    assert (errors < 2.5 * claimed).all()  # the room behind the target, and what it does, is the same in all frames
    assert claimed[2] < 3e-4
    with refuses(NotEnoughData, "arrangement"):
        measured_complex(tmp_path, "seed")


def test_a_board_is_measured_in_a_complex_image(rig: Path, tmp_path: Path) -> None:
    job = {"rig": rig, "target": Path(BOARD), "out": tmp_path / "m", "image": str(rig.parent / "image")}
    assert measure(**job).n_ok == 2
    dark = {"rig": rig, "target": Path(BOARD), "out": tmp_path / "d", "image": str(rig.parent / "left"), "frames": 1}
    with refuses(NotEnoughData, "1 pairs"):
        measure(**dark)


def test_covered_views_exchanged_or_joined_are_told(rig: Path, tmp_path: Path) -> None:
    left, right = (sorted((rig.parent / side).iterdir()) for side in ("left", "right"))
    code, content = run(
        "--left-only", str(rig.parent / "right"), "--right-only", str(rig.parent / "left"), "--board", BOARD,
        "-o", str(tmp_path / "x.yaml"),
    )  # fmt: skip
    assert code == 3 and "swapped" in content["error"]["cause"]
    assert "--left-only and --right-only" in content["error"]["cure"]
    for a, b in zip(left[:5], right[:5], strict=True):
        joined = np.hstack([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (a, b)])
        cv2.imwrite(str(tmp_path / a.name), joined)
    code, content = run("--image", str(tmp_path), "--board", BOARD, "-o", str(tmp_path / "x.yaml"))
    assert code == 3 and "side by side" in content["error"]["cause"]
    assert "calibrate stereo" in content["error"]["cure"] and not (tmp_path / "x.yaml").exists()


def test_every_cause_has_its_cure_and_the_commonest_reason_is_one_whatever_its_numbers() -> None:
    cures = mirrors.CURES.keys() | mirrors_lit_target.CURES.keys()
    others = {  # of these the rig's and the target's files are to be looked at, as OTHER_CURE says
        *(
            Unseen.OTHER,
            Unseen.UNREADABLE,
            Unseen.NO_BOARD,
            Unseen.CROWD,
            Unseen.DEADLINE,
            Unseen.UNPAIRED,
            Unseen.SWAPPED,
        ),
        *(Unseen.WRONG_TARGET, Unseen.MISFIT, Unseen.ONE_OFF, Unseen.ROTATION_OPEN, Unseen.SMALL_TARGET),
        *(Unseen.NO_POINT, Unseen.MOTION, Unseen.GAP, Unseen.BEYOND_CLAIMS, Unseen.INCONSISTENT, Unseen.DEADLINE),
    }
    assert cures == set(Unseen) - others and not mirrors.CURES.keys() & mirrors_lit_target.CURES.keys()
    seen = [NotSeen("dark"), NotSeen("2 of 3 spots seen", Unseen.LIGHTS_MISSING), NotSeen("1 of 3 spots seen")]
    assert reasons(seen) == [(seen[1], 2), (seen[0], 1)]


def test_the_size_tells_how_an_image_holds_two_views(tmp_path: Path) -> None:
    """A pair of cameras: images of one's size are overlaid, those of twice the width side by side, others refused."""
    camera = Camera.pinhole(WIDTH, HEIGHT, 600.0, 601.0, 361.0, 266.0)
    write_rig(tmp_path / "rig.yaml", parallel_rig(camera, 0.1))
    one = np.random.default_rng(6).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    widths = {"overlaid": one, "joined": np.hstack([one, one]), "odd": one[:, :-40]}
    for name, image in widths.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)

    def source(name: str) -> tuple[MomentSource, bool]:
        return complex_pairs(partial(open_source, str(tmp_path / f"{name}.png")), read_rig(tmp_path / "rig.yaml"))

    pairs, overlaid = source("overlaid")
    with pairs:
        ((left, right),) = pairs
    assert overlaid and left is right
    pairs, overlaid = source("joined")
    with pairs:
        ((left, right),) = pairs
    assert not overlaid and left.width == right.width == WIDTH
    with refuses(Inconsistent, f"{WIDTH - 40}x{HEIGHT}", f"{WIDTH}x{HEIGHT}", f"{2 * WIDTH}x{HEIGHT}"):
        source("odd")
