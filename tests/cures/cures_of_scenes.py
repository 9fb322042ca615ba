"""Cures of what is seen and planned: motions among walls, mirrors, paths that jump, cameras that wait, tables."""

import queue
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from cures_of_arms import ON_ARM, START, STREAMS, path, untimed
from cures_of_cameras import MIRRORS
from cures_of_cells import in_view, viewed
from cures_of_motions import planned, through
from cures_of_runs import MOVING
from cures_of_tables import pair

from armsight.calibrate.mirrors.calibration import calibrate_mirrors
from armsight.drivers import CameraSettings
from armsight.drivers.aravis import AravisCamera
from armsight.kinematics import link_frames
from armsight.ops.arm_files import load_arm
from armsight.store import parse_board

LIMITS = "format: armsight/limits\nversion: 1\n"
KEPT_M = 0.0851
"""By how much walls are kept from the links' middles, 85 mm at the least."""


def box(lower, upper):
    return f"{{name: wall, lower_m: {[*map(float, lower)]}, upper_m: {[*map(float, upper)]}}}"


def walled_in(start, written):
    """Return a call that plans from a start, with limits written of the least and greatest place of its links."""

    def go():
        q = np.array([float(value) for value in start.split(",")])
        links = np.vstack([np.zeros(3), link_frames(load_arm("cell/arm.yaml"), q)[:, :3, 3]])
        Path("walls.yaml").write_text(LIMITS + written(links.min(axis=0) - KEPT_M, links.max(axis=0) + KEPT_M))
        return viewed(start=start, limits=Path("walls.yaml"))()

    return go


def pocket(lower, upper):
    """Return walls to either side of an arm that stretches along x, and one above."""
    walls = (
        box([0.3, -2.0, -2.0], [2.0, lower[1], 2.0]),
        box([0.3, upper[1], -2.0], [2.0, 2.0, 2.0]),
        box([0.3, -2.0, upper[2]], [2.0, 2.0, 2.5]),
    )
    return f"forbidden: [{', '.join(walls)}]\n"


AWAY = START.replace("-0.0078", "3.1338")


def silent(**settings):
    """Return a call that waits for a camera's first frame, which comes after the silence that loses a camera."""

    def go():
        waited = []

        def get(timeout):
            waited.append(timeout)
            if len(waited) < 2:
                raise queue.Empty
            return "frame"

        camera = AravisCamera("a", settings=CameraSettings(**settings))
        camera._frames = SimpleNamespace(get=get)
        return next(iter(camera))

    return go


def spread(count):
    """Return a path of 30 mm on which the tool turns by 103 degrees, in so many rows."""
    along = np.linspace(0.0, 1.0, count)
    return through([[0.03 * at, 0.0, 0.01] for at in along], list(1.8 * along))


CAMERA = "camera_matrix: [[300, 0, 320], [0, 300, 240], [0, 0, 1]]\ndistortion_coefficients: [0, 0, 0, 0, 0]\n"
HEAD, *ROWS = path().splitlines(keepends=True)
EXPORT = f"-o a.script --speed-m-s 0.01 {ON_ARM}"

FILES = {
    "camera.yml": f"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n{CAMERA}",
    "two.yml": pair(),
    "leap.csv": HEAD + "".join(ROWS[:15] + ROWS[46:]),
}
TRIED = {
    (
        "armsight_lab/cell_plan/scene.py",
        "Look at the joints' limits, the workspace and the forbidden boxes (--limits)",
    ): (walled_in(START, lambda lower, upper: f"workspace: {box(lower, upper)}\n"), in_view),
    ("armsight_lab/cell_plan/scene.py", "and begin there (--start)"): (walled_in(AWAY, pocket), in_view),
    ("ops/compare/run.py", "Convert it first: armsight convert camera"): (
        "compare camera.yml camera.yml -o c",
        "convert camera camera.yml -o k.yaml && compare k.yaml k.yaml -o c && "
        "convert rig two.yml -o r.yaml && compare r.yaml r.yaml -o d",
    ),
    ("calibrate/mirrors/calibration.py", "Give its thickness in metres, or 0"): (
        lambda: calibrate_mirrors((), (), parse_board("checkerboard:7x5:0.02"), thickness_m=-0.003),
        f"{MIRRORS} --image mirrors --plate-mm 3 && {MIRRORS.replace('x.yaml', 'y.yaml')} --image mirrors --plate-mm 0",
    ),
    ("control/paths/outliers.py", "where it is meant put rows between (armsight path resample)"): (
        f"path export leap.csv {EXPORT}",
        f"path resample leap.csv -o g.csv --step-m 0.002 && path export g.csv {EXPORT}",
    ),
    ("control/paths/outliers.py", "armsight play --keep-rotation"): (
        planned(spread(2)),
        lambda: [planned(spread(60))(), planned(spread(2), keep_rotation=True)()],
    ),
    ("drivers/aravis.py", "a camera that is set to wait for a trigger"): (silent(), silent(trigger="Line0")),
    ("store/interpret/read.py", "add a column t_s in seconds"): (
        (MOVING.removesuffix(" && "), untimed("measured.csv", "m.csv"), STREAMS.replace("measured.csv", "m.csv")),
        STREAMS,
    ),
}
