"""Cures of rigs of some cameras: their names, what joins a rig or is placed anew, and lenses known before."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.many import solve_cameras
from armsight.calibrate.cameras.preconditions import KnownLens, require_lists, require_sizes
from armsight.calibrate.cameras.two_sides import TwoSided
from armsight.ops.calibration.many_cameras import Wanted, require_names
from armsight.ops.calibration.shown import require_lenses, shown_of
from armsight.ops.measurement.streams import FrameSources
from armsight.optics import Camera, parallel_rig
from armsight.records import BoardView, TargetKind, board_target, spot_target

sys.path.insert(0, str(Path(__file__).parents[1] / "truth"))
import turning_plate
from ring_of_cameras import SIZE

BOARD = "--board checkerboard:7x5:0.02 --frames 5"
LEFT, RIGHT = "--camera left=boards/left", "--camera right=boards/right"
RIG = parallel_rig(Camera.pinhole(320, 240, 400.0, 400.0, 160.0, 120.0), 0.1)
BOTH = {"left": "l.mp4", "right": "r.mp4"}
FILES = {}
NAMES = ("a", "b", "c", "d")
FRONT, BACK = (
    board_target(TargetKind.CHARUCO, 7, 5, 0.04, marker_m=0.03, dictionary=name)
    for name in ("DICT_4X4_50", "DICT_5X5_50")
)
LIT = spot_target({"A": (0.0, 0.0, 0.0), "B": (0.1, 0.0, 0.0), "C": (0.0, 0.1, 0.0), "D": (0.0, 0.0, 0.05)})
THREE = spot_target({"A": (0.0, 0.0, 0.0), "B": (0.1, 0.0, 0.0), "C": (0.0, 0.1, 0.0)})


def shown(*given):
    """Return a call that asks what is shown: board, back, target."""
    return lambda: shown_of(*given)


def wanted(cameras, **more):
    """Return a call that asks whether this can be what is meant."""
    none = {"rig": RIG, "add": None, "again": None, "lenses": {}, "hold_lenses": False}
    return Wanted(cameras=cameras, **{**none, **more}).require


def cameras(n):
    """Return a call that checks the names of so many."""
    return lambda: require_names({f"c{i}": f"{i}.mp4" for i in range(n)})


def lists(lens):
    """Return a call that checks the lists of two cameras and a lens by a name."""
    seen = {
        name: [BoardView(uv_px=np.eye(2) * size, index=np.arange(2), sigma_px=0.1, width=size, height=size, source="")]
        for name, size in (("left", 10), ("right", 20))
    }
    return lambda: require_lists(seen, {lens: KnownLens(camera=RIG.left)}, None)


def sizes(*size, lens="left"):
    """Return a call that checks a lens of 320x240 px against images of this size."""
    seen = SimpleNamespace(cameras=("left",), sizes=(size,))
    return lambda: require_sizes(seen, {lens: KnownLens(camera=RIG.left)})


def two_sided(most_tilt):
    """Return a call that places cameras on opposite sides of a plate that turns, tilted to all sides or not."""

    def run():
        true = turning_plate.plate((-25.0, 25.0, 155.0, 205.0), 5, most_tilt=most_tilt)
        seen = true.views(NAMES, 0.1, np.random.default_rng(1))
        lenses = {
            name: KnownLens(camera=Camera(width=SIZE[0], height=SIZE[1], intrinsics=k))
            for name, k in zip(NAMES, true.k, strict=True)
        }
        return solve_cameras(
            seen, TwoSided(turning_plate.FRONT, turning_plate.BACK), BoardOptions(folds=0), lenses=lenses
        )

    return run


def moments(**sources):
    """Return a call that opens the moments of a rig that is no pair."""
    return lambda: FrameSources(**sources).moments(None, colour=False)


TRIED = {
    ("calibrate/cameras/two_sides.py", "Take ten and more pictures"): (two_sided(0.0), two_sided(0.6)),
    ("ops/measurement/streams.py", "Give each camera's frames"): (
        moments(image="boards/left"),
        moments(cameras={"left": "boards/left", "side": "boards/right"}),
    ),
    ("ops/calibration/many_cameras.py", "Repeat --camera NAME=SRC"): (
        f"calibrate cameras {LEFT} {BOARD} -o c.yaml",
        f"{{}} {RIGHT} && calibrate camera boards/left {BOARD} -o left.yaml",
    ),
    ("ops/calibration/many_cameras.py", "Leave some away; further ones"): (
        cameras(9),
        lambda: [cameras(7)(), cameras(2)()],
    ),
    ("ops/calibration/many_cameras.py", "Record them first (armsight record"): (
        f"calibrate cameras --camera left=camera:0 --camera right=camera:1 {BOARD} -o c.yaml",
        "record --left boards/left --right boards/right --frames 5 -o films.mcap && "
        "convert recording films.mcap -o films && "
        f"calibrate cameras --camera left=films/left --camera right=films/right {BOARD} -o c.yaml",
    ),
    ("ops/calibration/many_cameras.py", "Give one --add NAME=SRC"): (
        wanted(BOTH),
        lambda: [wanted(BOTH, add={"top": "t.mp4"})(), wanted(BOTH, again="right")()],
    ),
    ("ops/calibration/many_cameras.py", "=SRC beside the others"): (
        wanted({"left": "l.mp4"}, again="right"),
        wanted(BOTH, again="right"),
    ),
    ("ops/calibration/many_cameras.py", "with its images as --camera"): (
        wanted({"left": "l.mp4"}, add={"right": "r.mp4"}),
        lambda: [wanted(BOTH, again="right")(), wanted({"left": "l.mp4"}, add={"top": "r.mp4"})()],
    ),
    ("ops/calibration/many_cameras.py", "Use the rig's names, or --add"): (
        wanted({"left": "l.mp4", "side": "r.mp4"}, again="left"),
        lambda: [wanted(BOTH, again="left")(), wanted({"left": "l.mp4"}, add={"side": "r.mp4"})()],
    ),
    ("ops/calibration/many_cameras.py", "Give --rig rig.yaml"): (
        wanted(BOTH, rig=None, add={"top": "t.mp4"}),
        wanted(BOTH, add={"top": "t.mp4"}),
    ),
    ("ops/calibration/shown.py", "Give --board, or --target"): (
        shown(None, None, None),
        lambda: [shown(FRONT, None, None)(), shown(None, None, LIT)()],
    ),
    ("ops/calibration/shown.py", "Leave --back away, or give"): (
        shown(None, BACK, LIT),
        lambda: [shown(None, None, LIT)(), shown(FRONT, BACK, None)()],
    ),
    ("ops/calibration/shown.py", "Give a target.yaml of such lights"): (
        shown(None, None, THREE),
        lambda: [shown(None, None, LIT)(), shown(FRONT, None, None)()],
    ),
    ("ops/calibration/shown.py", "=camera.yaml, from armsight calibrate camera; or"): (
        lambda: require_lenses(("left",), {}, LIT),
        lambda: [
            require_lenses(("left",), {"left": RIG.left}, LIT),
            require_lenses(("left",), {}, TwoSided(FRONT, BACK)),
        ],
    ),
    ("calibrate/cameras/preconditions.py", "Use the names of --camera"): (lists("top"), lists("right")),
    ("calibrate/cameras/preconditions.py", "px, or leave it away"): (
        sizes(640, 480),
        lambda: [sizes(320, 240)(), sizes(640, 480, lens="right")()],
    ),
}
