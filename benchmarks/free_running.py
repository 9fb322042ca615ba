"""How often free-running cameras' 95 % intervals hold, of a target in a hand that follows no model of armsight's.

Run with --runs 3 for a quarter of the recordings. tests/truth/hand_held.py makes the motion (reaches, rests, reversals,
tremor), the cameras and their clocks with numpy alone: 30 frames a second, stamps that jitter by 2 ms, read-outs of 18
ms, a delay and a drift, 2 % of the frames lost, spots of 0.05 px. The timing is calibrated from a recording of its own;
both go through the commands' functions from tables of spots. Inside: of the whole poses with the status ok, the
6-vector within the 95 % ellipsoid, and each of the six axes within its interval. --waves: a hand that moves by sums of
slow waves, before cameras whose read-outs are 18 and 21 ms and whose stamps are late by 1 ms on average.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.errors import DataRefused
from armsight.ops.calibrate_rig import calibrate_timing
from armsight.ops.measure import measure
from armsight.optics import Camera, Rig, RigKind
from armsight.records import PoseStatus, spot_target
from armsight.store import read_poses, write_rig, write_target

Array = NDArray[np.float64]
SPEEDS = (0.0, 0.1, 0.3, 0.5)
LATE_S = 1e-3
SECONDS, NOISE_PX = 15.0, 0.05
CHI2_6, NORMAL = 12.592, 1.95996


@dataclass(kw_only=True)
class Tally:
    """Errors (6,) and covariances (6, 6) of all poses of a condition, and what became of its recordings."""

    errors: list[Array] = field(default_factory=list)
    claims: list[Array] = field(default_factory=list)
    asked: int = 0
    refused: int = 0
    doubtful: int = 0

    def row(self) -> list[object]:
        """Shares inside in %, median claims, RMS errors."""
        e, C = np.array(self.errors).reshape(-1, 6), np.array(self.claims).reshape(-1, 6, 6)
        std = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
        q = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0])
        axes = 100.0 * np.mean(np.abs(e) < NORMAL * std, axis=0)
        along = np.median(std, axis=0)
        rms = np.sqrt(np.mean(e**2, axis=0))
        return [
            100.0 * float(np.mean(q < CHI2_6)),
            " ".join(f"{share:.1f}" for share in axes),
            1e3 * float(np.linalg.norm(along[:3])),
            1e3 * float(np.linalg.norm(rms[:3])),
            1e3 * float(np.linalg.norm(along[3:])),
            1e3 * float(np.linalg.norm(rms[3:])),
            100.0 * len(e) / max(self.asked, 1),
            self.doubtful,
            self.refused,
        ]


def rig_of(made: ModuleType, mount: object) -> Rig:
    """Return the product's rig of a mount."""
    places, axes = mount.axes  # type: ignore[attr-defined]
    camera = Camera.pinhole(
        made.WIDTH,
        made.HEIGHT,
        mount.focal_px,  # type: ignore[attr-defined]
        mount.focal_px,  # type: ignore[attr-defined]
        (made.WIDTH - 1) / 2,
        (made.HEIGHT - 1) / 2,
    )
    left, right = (
        RigidTransform.from_components(p, Rotation.from_matrix(R)) for p, R in zip(places, axes, strict=True)
    )
    return Rig(kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=left, T_rig_right=right)


def write_tables(made: ModuleType, folder: Path, seen: tuple[object, object]) -> dict[str, Path]:
    for name, one in zip(("left", "right"), seen, strict=True):
        (folder / f"{name}.csv").write_text(made.table(one, NOISE_PX))
    return {"left_spots": folder / "left.csv", "right_spots": folder / "right.csv"}


def recording(
    made: ModuleType, mount_name: str, speed: float | None, seed: int, folder: Path, tally: Tally, jitter_s: float
) -> None:
    """Calibrate the timing in one recording, measure in another, and compare with the truth. speed: None for waves."""
    mount = made.MOUNTS[mount_name]
    rng = np.random.default_rng([seed, 1000 if speed is None else int(100 * speed), len(mount_name)])
    readout = float(rng.uniform(0.012, 0.022))
    clocks = made.Clocks(
        delay_s=float(rng.uniform(-0.016, 0.016)),
        drift_ppm=float(rng.uniform(-60.0, 60.0)),
        phase_s=float(rng.uniform(0.0, 0.03)),
        readout_s=(0.018, 0.021) if speed is None else (readout, readout * float(rng.uniform(0.9, 1.1))),
        jitter_s=0.0 if speed is None else jitter_s,
        late_s=LATE_S if speed is None else 0.0,
    )
    write_rig(folder / "rig.yaml", rig_of(made, mount))
    names = dict(zip("ABC", map(tuple, made.LIGHTS.tolist()), strict=True))
    write_target(folder / "target.yaml", spot_target(names))
    waved = made.record(rng, made.hand(rng, 0.7, SECONDS, mount), mount, clocks, SECONDS, NOISE_PX)
    way = made.waves(rng, mount) if speed is None else made.hand(rng, speed, SECONDS, mount)
    try:
        tables = write_tables(made, folder, waved)
        calibrate_timing(folder / "rig.yaml", folder / "target.yaml", out=folder / "timed.yaml", **tables)
        tables = write_tables(made, folder, made.record(rng, way, mount, clocks, SECONDS, NOISE_PX))
        files = {"rig": folder / "timed.yaml", "target": folder / "target.yaml", "out": folder / "out"}
        measure(**files, **tables, timing="free")
    except DataRefused as refused:
        print("refused:", mount_name, speed, seed, str(refused)[:90])
        tally.refused += 1
        return
    poses = read_poses(folder / "out" / "poses.csv")
    tally.asked += len(poses)
    tally.doubtful += any(pose.status is PoseStatus.DOUBTFUL for pose in poses)
    for pose in poses:
        if pose.status is PoseStatus.OK and pose.T_parent_target is not None and pose.covariance is not None:
            tally.errors.append(made.off(np.asarray(pose.T_parent_target), way, pose.t_s))
            tally.claims.append(np.asarray(pose.covariance))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=12, help="recordings a condition")
    parser.add_argument("--jitter-ms", type=float, default=2.0)
    parser.add_argument("--waves", action="store_true")
    given = parser.parse_args()
    runs = given.runs
    made = bench.test_scene("hand_held")
    print(bench.machine())
    rows, whole = [], Tally()
    with tempfile.TemporaryDirectory() as name:
        for mount in made.MOUNTS:
            for speed in (None,) if given.waves else SPEEDS:
                tally = Tally()
                for seed in range(runs):
                    recording(made, mount, speed, seed, Path(name), tally, 1e-3 * given.jitter_ms)
                rows.append([mount, "waves" if speed is None else speed, *tally.row()])
                whole.errors += tally.errors
                whole.claims += tally.claims
                whole.asked += tally.asked
                whole.refused += tally.refused
                whole.doubtful += tally.doubtful
    rows.append(["all", "", *whole.row()])
    head = ["cameras", "m/s, peak", "pose in 95 %", "x y z rx ry rz in 95 %", "claimed mm, median", "RMS mm"]
    head += ["claimed mrad, median", "RMS mrad", "poses ok %", "recordings doubtful", "refused"]
    bench.table(f"{runs} recordings of {SECONDS:g} s a condition", head, rows)


if __name__ == "__main__":
    main()
