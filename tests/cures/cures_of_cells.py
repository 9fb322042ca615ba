"""Cures of whole cells: the motion planned and recorded, the clocks of its cameras, tips and lights of its targets."""

from functools import cache, partial
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
from cures_of_arms import START, plan
from cures_of_cameras import MEASURE, RECORD, SIDES
from cures_of_runs import FIND

from armsight.calibrate.cell.assignment import name_lights
from armsight.calibrate.cell.calibrate import _require_motion
from armsight.drivers import AUTOMATIC, CameraSettings
from armsight.kinematics import preset
from armsight.ops.calibration.cell import _require_inside, read_priors, require_sources
from armsight.ops.calibration.spots_of_frames import _require_all
from armsight.ops.measure import _with_zoom
from armsight.ops.measurement.streams import _settings_of_one
from armsight.records import Frame, Motion
from armsight.store import read_spot_track
from armsight.store.recording import RecordingWriter
from armsight_lab.cell_plan import run as cell_plan
from armsight_lab.cell_plan.plan import PlanSettings
from armsight_lab.cell_plan.request import CellPlanJob
from armsight_lab.cell_plan.run import _following

HEAD = "t_s,u_px,v_px,spot\n"
LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])  # of target.yaml
MORE = np.array([[-0.05, 0.06, 0.0], [0.01, 0.09, 0.0], [-0.04, -0.06, 0.0], [0.02, -0.09, 0.0]])


def waved(side, *, seconds=10.0, up_m=0.1, names="A"):
    """Return what a camera of rig.yaml sees of lights that are waved sideways and up: 1 / s, never the same again."""
    rows = HEAD
    for t in np.arange(0.0, seconds, 1.0 / 30.0) + 0.013 * side:
        x = 0.05 + 0.05 * np.sin(6.1 * t + 2.0 * np.sin(0.37 * t))
        y = up_m / 2.0 * np.sin(5.3 * t + 2.0 * np.sin(0.61 * t + 1.0))
        for k, name in enumerate(names):
            X = np.array([x - 0.1 * side, y, 0.6]) + [*LIGHTS, *MORE][k]
            u, v = 400.0 * X[:2] / X[2] + [160.3, 119.6]
            rows += f"{t:.6f},{u:.5f},{v:.5f},{name.strip()}\n"
    return rows


def both(name, **more):
    return {f"{name}-{side}.csv": waved(k, **more) for k, side in enumerate(("left", "right"))}


def tables(name):
    return f"--left-spots {name}-left.csv --right-spots {name}-right.csv"


nameless = both("many", names=7 * " ", seconds=5.0) | both("six", names=6 * " ", seconds=5.0)
FILES = {
    **both("waved"),
    "briefly-left.csv": waved(0),
    "briefly-right.csv": waved(1, seconds=0.9) + waved(1, names="B").removeprefix(waved(1, names="B", seconds=0.9)),
    **both("level", up_m=0.0),
    **{name: text.replace(",spot", "").replace(",\n", "\n") for name, text in nameless.items()},
    "at.csv": "t_s,q1\n0.02,0\n0.05,0\n",
    "other-day.csv": "t_s,q1\n1000,0\n1000.02,0\n",
    **both("lights", seconds=1.0, names="ABC"),
}
TIMING = "calibrate timing --rig rig.yaml -o t.yaml"
FREE = "measure --rig timed.yaml --target target.yaml -o m"
TWO = "measure --rig rig.yaml --target target.yaml --left left.mcap:left --right right.mcap:right -o m"
UNLIKE = [[0.0, 0.04, 0.0], [0.033, 0.0, 0.0], [-0.03, 0.003, 0.0]]
SIZES = ((640, 480), (640, 480))


TABLES = (Path("waved-left.csv"), Path("waved-right.csv"))


def cell(frames=(None, None), spots=TABLES, size=(320, 240)):
    return lambda: require_sources(frames, spots, size)


def filmed(left, right):
    return cell((left, right), (None, None), None)


def inside(size):
    path = Path("waved-left.csv")
    return lambda: _require_inside(read_spot_track(path), path, size)


def turned(*spans_deg):
    """Return a call of joints of which each turns by so much."""
    t = np.linspace(0.0, 1.0, 20)
    return lambda: _require_motion(preset("ur10"), Motion(t_s=t, q=np.radians(spans_deg) * t[:, None]))


def told(shape, places=None):
    names = dict(zip("ABC", np.asarray(shape), strict=True))
    return lambda: name_lights(np.asarray(shape if places is None else places), names)


def zoomed_to(left, right):
    return tuple(CameraSettings(zoom=zoom) for zoom in (left, right))


def deep():
    """Write the frames with 10 bits."""
    for side in ("left", "right"):
        Path("deep", side).mkdir(parents=True)
        for path in Path(side).iterdir():
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            cv2.imwrite(f"deep/{side}/{path.name}", 4 * image.astype(np.uint16))


def apart(late_s):
    """Return a step that records each camera by itself, the right one's stamps so much later."""

    def step():
        for side, start_s in (("left", 0.0), ("right", late_s)):
            with RecordingWriter(Path(f"{side}.mcap")) as writer:
                for k, path in enumerate(sorted(Path(side).iterdir())):
                    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
                    writer.frame(side, Frame(image=image, t_s=start_s + 0.1 * k, sequence=k, source=side))

    return step


def viewed(**more):
    """Return a call that plans a motion in view of the cell's cameras."""
    files = {name: Path(f"cell/{name}.yaml") for name in ("rig", "world", "target")}
    volume = ((-0.95, -0.75), (-0.3, 0.05), (0.1, 0.4))
    planned = plan(**{"facing_rad": 1.05, "volume": volume, **files, **more})

    def go():
        with patch.object(cell_plan, "PlanSettings", partial(PlanSettings, trials=0)):  # what is good is good enough
            planned()

    return go


@cache
def in_view():
    """Plan such a motion: what several cures come to."""
    viewed()()


TRIED = {
    ("ops/calibration/cell.py", "Give --left and --right, or --left-spots"): (
        cell(spots=(TABLES[0], None)),
        lambda: [cell()(), filmed("left", "right")()],
    ),
    ("ops/calibration/cell.py", "Record first, while"): (
        filmed("camera:0", "camera:1"),
        ("record --left left --right right -o cell.mcap", filmed("cell.mcap", "cell.mcap")),
    ),
    ("ops/calibration/cell.py", "Add --size 1280x720"): (cell(size=None), cell()),
    (
        "ops/calibration/cell.py",
        "Give the size of the images in which the spots were found: --size, or --right-size of the right one",
    ): (inside((160, 120)), inside((320, 240))),
    ("ops/calibration/spots_of_frames.py", "Give --left and --right, or --left-spots"): (
        f"{TIMING} --left-spots waved-left.csv",
        f"{TIMING} {tables('waved')}",
    ),
    ("ops/calibration/spots_of_frames.py", "Give both live, or record"): (
        f"{TIMING} --left camera:0 --right left",
        (lambda: _require_all([True, True]), "record --left left --right right -o wave.mcap"),
    ),
    ("calibrate/timing/coarse.py", "Wave the target for 10 to 20 s"): (
        f"{TIMING} {tables('briefly')}",
        f"{TIMING} {tables('waved')}",
    ),
    ("calibrate/timing/coarse.py", "Wave it up and down as well"): (
        f"{TIMING} {tables('level')}",
        f"{TIMING} {tables('waved')}",
    ),
    ("calibrate/timing/naming.py", "Wave a target of up to"): (
        f"{TIMING} {tables('many')}",
        f"{TIMING} {tables('six')}",
    ),
    ("armsight_lab/cell_plan/run.py", "Give the folder that `armsight calibrate cell"): (
        plan(after=Path("left")),
        lambda: _following(CellPlanJob(model="ur10", start=START, out=Path("m.csv"), after=Path("cell"))),
    ),
    ("ops/calibration/cell.py", "Give the world.yaml that"): (
        lambda: read_priors([Path("cell/world.yaml")], SIZES),
        (FIND, lambda: read_priors([Path("w.yaml")], SIZES)),
    ),
    ("ops/calibration/cell.py", "Give {}; a calibrated arm"): (
        lambda: read_priors([Path("cell/arm.yaml")], SIZES),
        (FIND, lambda: read_priors([Path("w.yaml")], SIZES)),
    ),
    ("calibrate/cell/calibrate.py", "Record a motion in which every joint"): (
        turned(20, 20, 0, 20, 20, 20),
        turned(20, 20, 20, 20, 20, 20),
    ),
    ("calibrate/cell/assignment.py", "See that all its lights shine"): (told(UNLIKE, UNLIKE[:2]), told(UNLIKE)),
    ("calibrate/cell/assignment.py", "Move a light so that all"): (
        told([[0.0, 0.04, 0.0], [0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]]),
        told(UNLIKE),
    ),
    ("ops/measurement/streams.py", "Give --left and --right, or --left-spots"): (
        f"{FREE} --left-spots lights-left.csv",
        f"{FREE} {SIDES} && {FREE} {tables('lights')} --overwrite",
    ),
    ("ops/measurement/streams.py", "or one recording for both"): (
        f"{FREE} --left left",
        f"{FREE} {SIDES} && {RECORD} && {FREE} --left a.mcap --overwrite",
    ),
    ("ops/measurement/streams.py", "Record first: armsight record"): (
        f"{FREE} --left camera:0 --right camera:2",
        f"record {SIDES} -o wave.mcap && {FREE} --left wave.mcap",
    ),
    ("ops/measurement/free_output.py", "Check that the times of --at"): (
        f"{FREE} {SIDES} --at other-day.csv",
        f"{FREE} {SIDES} --at at.csv",
    ),
    ("ops/measurement/streams.py", "and measure with the rig.yaml it writes"): (
        f"{MEASURE} --rate 100",
        f"{TIMING} {tables('waved')} && {MEASURE.replace('rig.yaml', 't.yaml')} --rate 100",
    ),
    ("ops/measurement/streams.py", "Give --timing pairs"): (
        (deep, f"{FREE} --left deep/left --right deep/right --bits 10"),
        f"{FREE} --left deep/left --right deep/right --bits 10 --timing pairs",
    ),
    ("ops/measurement/streams.py", "the same value; or leave --set-zoom"): (
        lambda: _settings_of_one(zoomed_to(100.0, 200.0), "a.png"),
        lambda: [_settings_of_one(zoomed_to(100.0, 100.0), "a.png"), _settings_of_one(AUTOMATIC, "a.png")],
    ),
    ("drivers/timed_moments.py", "or allow more with --max-skew; with --fps"): (
        (apart(0.04), f"{TWO}"),
        f"{TWO} --max-skew 0.05 --overwrite",
    ),
    ("ops/measure.py", "Give --zoom-left and --zoom-right, or one"): (
        f"{MEASURE} --set-zoom",
        lambda: _with_zoom(AUTOMATIC, (100.0, None)),
    ),
    ("armsight_lab/cell_plan/plan.py", "Give more time (--duration)"): (viewed(duration_s=0.1), in_view),
    ("armsight_lab/cell_plan/plan.py", "Give a volume that arm and cameras reach"): (
        viewed(volume=((2.0, 2.2), (0.0, 0.2), (0.0, 0.2))),
        in_view,
    ),
    ("armsight_lab/cell_plan/scene.py", "Check where the rig stands (--world)"): (viewed(facing_rad=1e-3), in_view),
}
