"""`armsight design` against the simulated world: deviations foretold and simulated, rig by rig; and the lights' noise.

    OMP_NUM_THREADS=1 python benchmarks/design.py [--runs 200] [--rig webcam mirrors] [--images 40]

Every run holds a board anew before the rig (armsight_sim projects it), calibrates the rig from its noisy corners by
armsight's own calibration, and measures the target at 24 places of the volume. 200 runs tell a deviation to 5 %.
--images: pictures of the lights are rendered and searched, and the scatter of their centres is held against the bound.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.drivers import CELLS, load
from armsight.errors import BadImage
from armsight.geometry import xyz_quat
from armsight.measure.boards.find import find_board
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.optics import Camera, Plate, Rig, RigKind
from armsight.optics.mirrors import Mirrors
from armsight.records.camera import LinearNoise, NeighbourCorrelation, NoiseModel
from armsight.records.target import spot_target
from armsight.store import parse_board, rig_mapping, target_mapping, write_rig, write_target
from armsight.store.rigs import World, write_world
from armsight_lab.design.expected_poses import centre_deviation
from armsight_lab.design.planned_calibrations import planned_views
from armsight_lab.design.request import DesignJob
from armsight_lab.design.run import run_design
from bench import machine, table

DEG = np.pi / 180.0
TRIANGLE = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
LARGE = {name: tuple(2.0 * value for value in xyz) for name, xyz in TRIANGLE.items()}
SMALL = {"A": (-0.034, 0.0, 0.0), "B": (0.026, 0.027, 0.0), "C": (0.026, -0.027, 0.0)}
GAIN, READ = 1.0 / 24.0, 1.5
"""Grey levels for an electron, and read noise, of the simulated sensor."""


def camera(width: int, height: int, focal_px: float, distortion: tuple[float, ...] = ()) -> Camera:
    k = [focal_px, focal_px, 0.5 * (width - 1.0), 0.5 * (height - 1.0), 0.0, *distortion]
    return Camera(width=width, height=height, intrinsics=np.array(k + [0.0] * (10 - len(k))))


def jobs(folder: Path) -> dict[str, DesignJob]:
    """Return the plans by name, their files written into a folder."""
    webcam = camera(1280, 720, 950.0, (0.09, -0.18, 0.0008, -0.0005, 0.05))
    narrow = Rig(
        kind=RigKind.STEREO,
        left=webcam,
        right=camera(1280, 720, 953.0, (0.084, -0.171, -0.0006, 0.0007, 0.042)),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.06, 0.0005, -0.001]),
    )
    mirrors = Mirrors(baseline_m=0.12, plate=Plate(thickness_m=1e-3)).rig(camera(768, 576, 1002.0, (-0.11, 0.08)))
    write_rig(folder / "webcam.yaml", narrow)
    write_rig(folder / "mirrors.yaml", mirrors)
    for name, spots in (("triangle", TRIANGLE), ("large", LARGE), ("small", SMALL)):
        write_target(folder / f"{name}.yaml", spot_target(spots, diameter_m=0.006))
    turn = RigidTransform.from_matrix(
        np.array([[0.0, 0.0, -1.0, 1.6], [1.0, 0.0, 0.0, -0.06], [0.0, -1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
    )
    write_world(folder / "world.yaml", World(parent="base", T_parent_rig=turn))
    plain = DesignJob(
        out=folder,
        target=folder / "triangle.yaml",
        volume=((-0.15, 0.21), (-0.12, 0.12), (0.5, 0.9)),
        rig=folder / "webcam.yaml",
        board="checkerboard:9x6:0.025",
        views=20,
    )
    wide = replace(
        plain,
        rig=None,
        target=folder / "large.yaml",
        size=(1280, 1024),
        focal_px=1500.0,
        baseline_m=0.6,
        toe_in_rad=12.0 * DEG,
        volume=((0.05, 0.45), (-0.15, 0.15), (1.1, 1.6)),
        board="checkerboard:9x6:0.04",
        spot_noise_px=0.05,
        corner_noise_px=0.05,
    )
    mirror = replace(
        plain,
        rig=folder / "mirrors.yaml",
        target=folder / "small.yaml",
        volume=((-0.08, 0.08), (-0.07, 0.07), (0.45, 0.7)),
        board="checkerboard:7x5:0.015",
        spot_noise_px=0.05,
        corner_noise_px=0.05,
    )
    arm = replace(
        plain,
        baseline_m=0.12,
        arm="ur10e",
        world=folder / "world.yaml",
        volume=((0.7, 1.0), (-0.2, 0.2), (0.35, 0.65)),
    )
    return {
        "wide": wide,
        "wide, aligned": replace(wide, relative=True),
        "webcam": plain,
        "webcam, aligned": replace(plain, relative=True),
        "mirrors": mirror,
        "mirrors, aligned": replace(mirror, relative=True),
        "webcam, board of 7x5": replace(plain, target=Path("checkerboard:7x5:0.02")),
        "webcam, tool of an arm": arm,
    }


def simulated(chosen: list[str], runs: int, seed: int) -> None:
    rows = []
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept)
        for name, job in jobs(folder).items():
            if chosen and name not in chosen:
                continue
            start = time.perf_counter()
            done = run_design(replace(job, out=folder / name.replace(", ", "-"), simulate=runs, seed=seed, workers=1))
            one = done.simulation
            if one is None:
                raise SystemExit("nothing was simulated")
            ratios = [place.position_m / place.expected_m for place in one.places]
            rows.append(
                [
                    name,
                    1e3 * done.position.median,
                    0.0 if done.orientation is None else done.orientation.median / DEG,
                    f"{one.ratio_position:.3f}",
                    "-" if one.ratio_orientation is None else f"{one.ratio_orientation:.3f}",
                    f"{one.ratio_std:.3f}",
                    f"{min(ratios):.2f} to {max(ratios):.2f}",
                    one.n_failed,
                    f"{one.n_lost} of {one.n_lost + one.n_poses}",
                    f"{time.perf_counter() - start:.0f}",
                ]
            )
            print(rows[-1], flush=True)
    header = ["rig", "position, mm", "orientation, deg", "simulated: position", "orientation", "+-", "places"]
    table(f"{runs} simulated calibrations over the deviations foretold", [*header, "refused", "lost", "s"], rows)


def images(n: int) -> None:
    """Print the scatter of lights' centres in rendered pictures beside the bound, by their size."""
    noise = NoiseModel(
        levels=np.array([0.0, 255.0]),
        variance_levels2=READ**2 + 1.0 / 12.0 + GAIN * np.array([0.0, 255.0]),
        std_levels2=np.zeros(2),
        correlation=NeighbourCorrelation(x=np.zeros(2), y=np.zeros(2)),
        n_frames=10,
        linear=LinearNoise(read_noise_levels=READ, gain_levels=GAIN),
    )
    rows = []
    pair = Rig(
        kind=RigKind.STEREO,
        left=camera(640, 480, 900.0),
        right=camera(640, 480, 900.0),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.1, 0.0, 0.0]),
    )
    for size_px in (3.0, 5.0, 8.0, 12.0, 20.0):
        target = spot_target(TRIANGLE, diameter_m=size_px / 900.0 * 0.6)
        rng = np.random.default_rng(int(size_px))
        poses = [[*rng.uniform([0.0, -0.05, 0.6], [0.1, 0.05, 0.6]), 0.0, 0.0, 0.0, 1.0] for _ in range(n)]
        given = {"rig": rig_mapping(pair), "target": target_mapping(target), "poses": poses}
        cell = load(CELLS, "led-cell")(
            seed=1, frames=n, options={"level": 180.0, "sigma_px": 0.8}, room="dark", pipeline="ideal", given=given
        )
        off = []
        for k, frames in enumerate(cell.frames()):
            for side, frame in zip(("left", "right"), frames, strict=True):
                found = find_spots(frame.image, SpotSettings()).uv_px
                for uv in cell.centres_px(k, side).values():
                    near = found[np.argmin(np.linalg.norm(found - uv, axis=1))] if len(found) else np.full(2, np.nan)
                    off.append(near - uv)
        errors = np.array(off)
        bound = float(centre_deviation(noise, np.array([size_px]))[0])
        rms = float(np.sqrt(np.nanmean(errors**2)))
        rows.append(
            [size_px, f"{bound:.4f}", f"{rms:.4f}", f"{rms / bound:.2f}", f"{1 / np.sqrt(2 * errors.size):.2f}"]
        )
    table(
        f"Centres of lights in {2 * n} rendered pictures",
        ["size, px", "foretold, px", "found, RMS px", "ratio", "+-"],
        rows,
    )


def corners(n: int) -> None:
    """Print the scatter of a board's corners in rendered pictures: what --corner-noise-px stands for."""
    rig = Rig(
        kind=RigKind.STEREO,
        left=camera(1280, 720, 950.0),
        right=camera(1280, 720, 950.0),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([0.12, 0.0, 0.0]),
    )
    board = parse_board("checkerboard:9x6:0.025")
    views = planned_views(rig, board, n, 0.1).T_rig_board
    poses = [np.concatenate(xyz_quat(views[k])).tolist() for k in range(n)]
    given = {"rig": rig_mapping(rig), "board": {"columns": 9, "rows": 6, "square_m": 0.025}, "poses": poses}
    cell = load(CELLS, "board-cell")(seed=1, frames=n, room="dark", printed=given)
    errors, stated, missed = [], [], 0
    for k, frames in enumerate(cell.frames()):
        true = rig.project(views[k].apply(board.xyz_m))
        for uv, frame in zip(true, frames, strict=True):
            try:
                found = find_board(frame.image, board)
            except BadImage:
                missed += 1
                continue
            errors.append((found.uv_px - uv[found.index]).ravel())
            stated.append(found.sigma_px)
    off = np.concatenate(errors)
    rows = [[len(errors), missed, float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(np.square(stated))))]]
    table("Corners of a board in rendered pictures", ["pictures", "not found", "RMS, px", "as stated, px"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--rig", nargs="*", default=[])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--images", type=int, default=0)
    chosen = parser.parse_args()
    print(machine())
    if chosen.images:
        images(chosen.images)
        corners(chosen.images // 3)
    if chosen.runs:
        simulated(chosen.rig, chosen.runs, chosen.seed)


if __name__ == "__main__":
    main()
