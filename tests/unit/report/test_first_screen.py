"""The first screen of a page: what to do, figures that are no rounding, and plots and tables on a telephone."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.identify import Sweeps
from armsight.calibrate.identify.result import LEANS
from armsight.calibrate.identify.sweeps import leaning
from armsight.cli.tables import figure
from armsight.ops.verification.output import _verdict
from armsight.optics import Camera, Rig, RigKind
from armsight.records.result_parts import Verdict
from armsight.report.html import STYLE, Page, table
from armsight.units import with_deviation
from refusals import names_it


def page():
    verdict = Verdict(level="good", headline="Good", reasons=["It is good."], next=["Go <on>."])
    return Page(title="Title", subtitle="", verdict=verdict, cards=())


def test_rounding_is_no_figure():
    exact = SimpleNamespace(task=np.full((12, 6), 4.5e-17), how=SimpleNamespace(parts=()), cause=None)
    assert names_it(_verdict(exact), "0 mm", "0 deg")
    assert figure(4.51e-14) == "0" and figure(0.0451) == "0.0451"
    assert with_deviation(0.5, 1e-14) == ("0.5000", "0")


def test_tables_leave_out_what_says_nothing_and_say_that_they_scroll():
    assert "<thead>" not in table(["", ""], [["rig", "stereo"]])
    shown = table(["joint", "zero", ""], [["1", "0.5", ""], ["2", "0.1", ""]], numbers=(1,))
    assert shown.count("<td") == 4 and shown.count('class="n"') == 3
    assert table(["joint", ""], [["1", ""], ["2", "why"]]).count("<td") == 4
    assert 'class="t"' not in table(["fx", "unit"], [["947.9", "px"]])  # as narrow as its words
    assert 'class="t"' in table(["row", "why"], [["1", "it hardly moved between the poses"]])
    assert '"scroll sideways \\2192"' in STYLE


@pytest.mark.parametrize(("apart_m", "turn_deg", "deep"), [(0.12, 0.0, True), (1.414, -90.0, False)])
def test_depth_is_told_where_the_rig_is_weak_in_it(apart_m, turn_deg, deep):
    """Two cameras side by side tell depth badly; two that look at right angles tell all directions alike."""
    camera = Camera.pinhole(1280, 720, 950.0, 950.0, 640.0, 360.0)
    back = apart_m / np.sqrt(2.0) if not deep else 0.0
    at = [apart_m, 0.0, 0.0] if deep else [back, 0.0, back]
    place = RigidTransform.from_components(at, Rotation.from_euler("y", turn_deg, degrees=True))
    rig = Rig(kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=RigidTransform.identity(), T_rig_right=place)
    points = np.array([[0.0, 0.0, 1.0], [0.05, 0.02, 1.02], [-0.03, 0.04, 0.97]])
    uv = np.stack(rig.project(points), axis=1)
    lean = leaning(rig, Sweeps(joint=np.zeros(3, int), q=np.zeros((3, 1)), xyz_m=points, uv_px=uv))
    assert (lean > LEANS) == deep
    assert leaning(rig, Sweeps(joint=np.zeros(3, int), q=np.zeros((3, 1)), xyz_m=points)) is None
