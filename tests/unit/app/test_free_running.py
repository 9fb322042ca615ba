"""`measure` with cameras that run free: tables of spots and images of pinholes that are made here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.cli.actions import action_of
from armsight.errors import Inconsistent, NotEnoughData
from armsight.measure.results import MeasureResult
from armsight.ops import measure as ops
from armsight.optics import Camera, parallel_rig
from armsight.records import CameraTiming, NamedCovariance, PoseStatus, spot_target
from armsight.store import Table, read_poses, read_table, write_rig, write_target
from armsight.store.covariances import (
    COVARIANCE,
    LIGHTS_STD,
    POSE_COLUMNS,
    SYSTEMATIC,
    SYSTEMATIC_COVARIANCE,
    VELOCITY,
    VELOCITY_STD,
)
from armsight.store.covariances import LIGHTS as MEAN
from refusals import refuses

Array = NDArray[np.float64]
WIDTH, HEIGHT, F, BASE = 640, 480, 700.0, 0.1
READOUT, DELAY, RATE, NOISE = 0.02, 0.011, 30.0, 0.05
LIGHTS = {"A": (-0.05, 0.0, 0.0), "B": (0.03, 0.04, 0.0), "C": (0.02, -0.03, 0.0)}
X = np.array(list(LIGHTS.values()))


def measure(**given: Any) -> MeasureResult:
    """Measure as the command line does, and refuse in its words."""
    done: MeasureResult = action_of(ops.measure).run(given)  # type: ignore[assignment]  # what it returns
    return done


def pose(t: float) -> tuple[Array, Rotation]:
    way = np.array([0.06 * np.sin(3.1 * t), 0.05 * np.sin(2.3 * t + 0.4), 0.05 * np.sin(2.7 * t + 1.0)])
    return np.array([0.05, 0.0, 0.7]) + way, Rotation.from_rotvec([0.3 * np.sin(1.9 * t), 0.2, 0.3 * np.sin(1.3 * t)])


def pixels(t: float, side: int) -> Array:
    """Pixels (3, 2) of the lights, each at its line's time."""
    out = []
    for light in X:
        late = 0.0
        for _ in range(5):
            p, R = pose(t + late)
            P = p + R.apply(light) - [BASE * side, 0.0, 0.0]
            uv = np.array([F * P[0] / P[2] + 319.5, F * P[1] / P[2] + 239.5])
            late = READOUT * (uv[1] / (HEIGHT - 1) - 0.5)
        out.append(uv)
    return np.array(out)


def timed_rig(folder: Path, *, timed: bool = True) -> None:
    rig = parallel_rig(Camera.pinhole(WIDTH, HEIGHT, F, F, 319.5, 239.5), BASE)
    if timed:
        doubt = NamedCovariance(names=("delay_s", "readout_s"), matrix=np.diag([4e-5, 1e-4]) ** 2)
        left = CameraTiming(readout_s=READOUT)
        rig = replace(rig, timing=(left, replace(left, delay_s=DELAY, covariance=doubt)))
    write_rig(folder / "rig.yaml", rig)
    write_target(folder / "target.yaml", spot_target(LIGHTS))


def spots(folder: Path, *, seconds: float = 4.0, keep: Callable[[float, int], bool] = lambda t, side: True) -> None:
    """left.csv and right.csv, stamps with a jitter of 1 ms; keep tells which frames there are."""
    rng = np.random.default_rng(3)
    for side, name in enumerate(("left", "right")):
        rows = ["t_s,u_px,v_px,su_px,sv_px"]
        for n in range(int(seconds * RATE)):
            t, stamp = n / RATE + DELAY * side, n / RATE + rng.normal(0.0, 0.001)
            if keep(t, side):
                seen = pixels(t, side) + rng.normal(0.0, NOISE, (3, 2))
                rows += [f"{stamp:.6f},{u:.4f},{v:.4f},{NOISE},{NOISE}" for u, v in seen]
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")


def job(folder: Path, **more: object) -> dict[str, Any]:
    tables = {"left_spots": folder / "left.csv", "right_spots": folder / "right.csv"}
    return {"rig": folder / "rig.yaml", "target": folder / "target.yaml", "out": folder / "out", **tables, **more}


def errors(folder: Path) -> tuple[Array, Array]:
    """Errors (n, 6) of the whole poses and how many of their deviations the positions are off (n, 3)."""
    d, claims = [], []
    for one in read_poses(folder / "out" / "poses.csv"):
        if one.status is not PoseStatus.OK:
            continue
        assert one.T_parent_target is not None and one.covariance is not None
        p, R = pose(one.t_s)
        turned = (Rotation.from_matrix(one.T_parent_target[:3, :3]) * R.inv()).as_rotvec()
        d.append(np.concatenate([one.T_parent_target[:3, 3] - p, turned]))
        claims.append(np.sqrt(np.diag(one.covariance)))
    return np.array(d), np.array(d) / np.array(claims)


def moving_table(folder: Path) -> Table:
    """poses.csv with its columns of velocity, rows without a pose left out."""
    path = folder / "out" / "poses.csv"
    rows = [row for row in path.read_text().splitlines() if ",lost," not in row]
    path.write_text("\n".join(rows) + "\n")
    empty = (*SYSTEMATIC, *MEAN, *LIGHTS_STD, *COVARIANCE, *SYSTEMATIC_COVARIANCE)
    names = (*empty, *VELOCITY, *VELOCITY_STD)
    return read_table(path, POSE_COLUMNS, optional=names, text=("status", "spots"), blank=empty)


def test_tables_of_spots_of_free_running_cameras_give_poses_and_velocity_at_the_left_frames(tmp_path: Path) -> None:
    timed_rig(tmp_path)
    spots(tmp_path)
    summary = measure(**job(tmp_path))
    assert summary.timing is not None and summary.timing.n_starts == 1 and summary.timing.note is None
    assert summary.n_frames == 120 and summary.n_ok > 105  # it is not found at once in motion
    assert summary.consistency is not None and summary.consistency.verdict == "ok" and summary.n_doubtful == 0
    d, sigmas = errors(tmp_path)
    assert np.sqrt(np.mean(np.sum(d[:, :3] ** 2, axis=1))) < 4e-4
    assert np.mean(np.abs(sigmas) < 1.96) > 0.85
    table = moving_table(tmp_path)
    step = 1e-4
    true = np.array([(pose(t + step)[0] - pose(t - step)[0]) / (2.0 * step) for t in table.numbers["t_s"]])
    found = table.stacked(VELOCITY[:3])
    assert np.abs(found - true)[10:-10].max() < 0.03
    assert summary.timing.nearest_pairs_m == pytest.approx(DELAY * summary.timing.speed_m_s, rel=0.1)
    report = (tmp_path / "out" / "report.html").read_text()
    assert "own time" in report and "frames nearest" in report


def test_poses_come_at_a_rate_or_at_given_times_and_not_where_nothing_was_seen(tmp_path: Path) -> None:
    timed_rig(tmp_path)
    spots(tmp_path)
    assert measure(**job(tmp_path, rate_hz=100.0)).n_ok > 350
    d, _ = errors(tmp_path)
    assert np.linalg.norm(d[:, :3], axis=1).max() < 2e-3
    (tmp_path / "joints.csv").write_text("t_s,q1\n1.0,0.1\n2.5,0.2\n9.0,0.3\n")
    summary = measure(**job(tmp_path, at=tmp_path / "joints.csv"))
    assert (summary.n_ok, summary.n_lost) == (2, 1)
    assert summary.reasons == {"gap": 1}
    (tmp_path / "joints.csv").write_text("t_s,q1\n101.0,0.1\n102.5,0.2\n")
    with refuses(NotEnoughData, "none", "times"):
        measure(**job(tmp_path, at=tmp_path / "joints.csv"))


def test_images_of_free_running_cameras_are_measured_where_the_rig_tells_their_timing(tmp_path: Path) -> None:
    timed_rig(tmp_path)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for side, name in enumerate(("left", "right")):
        (tmp_path / name).mkdir()
        for n in range(24):
            image = np.random.default_rng([side, n]).normal(12.0, 2.0, (HEIGHT, WIDTH))
            for u, v in pixels(n / RATE + DELAY * side, side):
                box = np.s_[int(v) - 9 : int(v) + 10, int(u) - 9 : int(u) + 10]
                image[box] += 150.0 * np.exp(-((x[box] - u) ** 2 + (y[box] - v) ** 2) / (2.0 * 1.6**2))
            cv2.imwrite(str(tmp_path / name / f"{n:03d}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))
    frames = {"left": str(tmp_path / "left"), "right": str(tmp_path / "right"), "left_spots": None, "right_spots": None}
    summary = measure(**job(tmp_path, fps=RATE, **frames))
    assert summary.timing is not None and summary.n_ok > 15
    d, _ = errors(tmp_path)
    assert np.linalg.norm(d[:, :3], axis=1).max() < 1e-3
    again = measure(**job(tmp_path, fps=RATE, timing="pairs", **frames))
    assert again.timing is None


@pytest.mark.parametrize("off_s", [-0.005, 0.02])
def test_cameras_out_of_step_are_refused(tmp_path: Path, off_s: float) -> None:
    """The right camera's delay off by 5 to 20 ms: 1 to 5 mm between the views."""
    with_delay(tmp_path, DELAY + off_s)
    with refuses(Inconsistent, "timing", "anew"):
        measure(**job(tmp_path))


def with_delay(folder: Path, delay_s: float) -> None:
    timed_rig(folder)
    spots(folder)
    rig = (folder / "rig.yaml").read_text()
    assert f"delay_s: {DELAY}" in rig
    (folder / "rig.yaml").write_text(rig.replace(f"delay_s: {DELAY}", f"delay_s: {delay_s}"))
