"""The pages: complete in themselves, safe against what names say, right in their figures, small for long runs."""

import base64
import gzip
import json
import re
from dataclasses import replace
from datetime import datetime
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras.preconditions import images_doubted, images_verdict
from armsight.errors import Inconsistent
from armsight.geometry import pose_difference
from armsight.kinematics import preset
from armsight.measure.results import grounds_of, measure_verdict
from armsight.optics import Camera, Rig, RigKind
from armsight.records import PoseStatus, Spots, TargetPose, spot_target
from armsight.records.result_parts import Difference, Verdict
from armsight.report.arm_view import arm_report
from armsight.report.calibration import calibration_report
from armsight.report.compare_report import Course, compare_report
from armsight.report.figures import MAX_PLOTTED
from armsight.report.html import Page
from armsight.report.measure import measure_report
from armsight.report.run import BoardPicture, BoardViews, MeasureRun, Sample
from armsight.report.scene import add_boards
from armsight.units import figure_of
from refusals import names_it, refuses

PLOTLY = resources.files("armsight.report").joinpath("plotlyjs", "plotly-gl3d.min.js.gz").read_bytes()
LARGEST = 1_500_000
"""Bytes of a report, plotly.js in it."""
HOSTILE = "</script><script>alert(1)</script>\"'><img src=x onerror=alert(2)>&<b>"
CAMERA = Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
RIG = Rig(
    kind=RigKind.STEREO,
    left=CAMERA,
    right=CAMERA,
    T_rig_left=RigidTransform.identity(),
    T_rig_right=RigidTransform.from_translation([0.12, 0.0, 0.0]),
    rms_px=0.1,
)
TARGET = spot_target({"A": (0.0, 0.0, 0.0), "B": (0.05, 0.0, 0.0), "C": (0.0, 0.05, 0.0)}, diameter_m=0.005)
STD = np.array([2e-5, 2e-5, 1e-4, 3e-4, 2e-4, 1e-4])


class Tags(HTMLParser):
    """Collects tags, attributes that load something, the text people see, and the figures' JSON."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.loads, self.text, self.scripts, self._in = [], [], "", [], ""
        packed = re.search(r'<script type="text/plain" id="plotly">([^<]*)</script>', page)
        self.has_plotly = packed is not None and base64.b64decode(packed[1]) == PLOTLY
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._in = tag
        self.loads += [value for name, value in attrs if name in ("src", "href", "data", "action", "srcset")]
        assert not [name for name, _ in attrs if name.startswith("on")], attrs

    def handle_endtag(self, tag):
        self._in = ""

    def handle_data(self, data):
        if self._in == "script":
            self.scripts.append(data)
        elif self._in != "style":
            self.text += data

    @property
    def figures(self):
        return json.loads(gzip.decompress(base64.b64decode(self.scripts[0])))


def poses_and_truth(n=40, *, lost=(), position=(), scale=1.0, seed=1):
    """A track with noise as its covariance says (times scale), with gaps."""
    rng = np.random.default_rng(seed)
    poses, truth = [], []
    for i in range(n):
        w = 2 * np.pi * i / n
        true = RigidTransform.from_components(
            [0.1 * np.cos(w), 0.1 * np.sin(w), 0.8], Rotation.from_euler("xyz", [0.1, 0.3 * np.sin(w), w])
        )
        e = scale * STD * rng.standard_normal(6)
        pose = RigidTransform.from_components(
            np.asarray(true.translation) + e[:3], Rotation.from_rotvec(e[3:]) * true.rotation
        )
        truth.append(true)
        common = {"t_s": i / 30, "parent": "rig"}
        if i in lost:
            poses.append(TargetPose(status=PoseStatus.LOST, why=f"no light in the left frame ({i} px seen)", **common))
        elif i in position:
            poses.append(
                TargetPose(
                    status=PoseStatus.POSITION_ONLY,
                    T_parent_target=RigidTransform.from_translation(pose.translation).as_matrix(),
                    covariance=np.diag(STD[:3] ** 2),
                    spots=("A",),
                    why=HOSTILE,
                    **common,
                )
            )
        else:
            poses.append(
                TargetPose(
                    status=PoseStatus.OK,
                    T_parent_target=pose.as_matrix(),
                    covariance=np.diag(STD**2),
                    spots=("A", "B", "C"),
                    **common,
                )
            )
    return poses, truth


def sample(names=("A",), colour=False):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 30, (480, 640, 3) if colour else (480, 640), dtype=np.uint8)
    n = len(names)
    spots = Spots(
        uv_px=np.full((n, 2), 100.25),
        covariance_px2=np.tile(np.eye(2) * 1e-3, (n, 1, 1)),
        peak=np.ones(n),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
        rejected=((5.0, 6.0, HOSTILE),),
    )
    return Sample(frame=3, side="left", image=image, names=names, spots=spots, seen=spots, source=HOSTILE, why=HOSTILE)


def judged(poses, truth=None, *, error=None, consistency=None):
    """What a run of these poses comes to."""
    whole = sum(pose.status.size == 6 for pose in poses)
    counts = {"n_frames": len(poses), "n_ok": whole, "n_doubtful": 0}
    rest = {
        "timing": None,
        "by_camera": None,
        "error": error,
        "consistency": consistency,
        "grounds": grounds_of(poses, truth),
    }
    return measure_verdict(SimpleNamespace(**counts, **rest))


def full_run(**more):
    poses, truth = poses_and_truth(lost=(7, 8, 20), position=(11,))
    residuals = {side: np.column_stack([np.arange(100.0), *np.full((2, 100), 0.1)]) for side in ("left", "right")}
    given = {
        "poses": poses,
        "truth": truth,
        "rig": RIG,
        "target": TARGET,
        "residuals": residuals,
        "samples": [sample((HOSTILE,)), sample(colour=True)],
        "median_ms": 0.3,
        "p99_ms": 0.9,
        "title": HOSTILE,
        "facts": [(HOSTILE, HOSTILE)],
        "assumptions": [HOSTILE],
    }
    given |= more
    if "verdict" not in given:
        given["verdict"] = judged(given["poses"], given["truth"])
    return MeasureRun(**given)


def full_calibration(**more):
    """What a page reads of the calibration of a pair."""
    rng = np.random.default_rng(2)
    uv_px, left = rng.uniform((0, 0), (640, 480), (500, 2)), 0.1 * rng.standard_normal((500, 2))
    stands = dict.fromkeys(
        ("convergence_rad", "vertical_rad", "vertical_px", "roll_rad", "height_m", "advance_m"), 1e-3
    )
    given = {
        "thing": HOSTILE,
        "clouds": lambda: {"left": (uv_px, left), "right": (uv_px, left)},
        "pair_rig": lambda: RIG,
        "baseline_std_m": 1e-5,
        "alignment": SimpleNamespace(**stands, std=None),
        "sources": [(f"{HOSTILE}/{HOSTILE}{i}.png",) * 2 for i in range(9)],
        "view_rms_px": rng.uniform(0.05, 0.15, 9),
        "n_pairs": 10,
        "n_used": 9,
        "rms_px": 0.135,
        "verdict_": Verdict(level="care", headline="Usable with care", reasons=[HOSTILE], next=[HOSTILE]),
        "holdout_rms_px": 0.161,
        "epipolar_rms_px": 0.17,
        "holdout_epipolar_rms_px": 0.178,
        "metric": {"expected_m": 0.025, "mean_m": 0.025003, "rms_m": 0.000198},
        "metric_is_left_out": True,
        "rejected": [(HOSTILE, HOSTILE)],
        "advice": [HOSTILE],
    }
    return SimpleNamespace(**(given | more))


def calibration_page(**more):
    return calibration_report(full_calibration(**more), HOSTILE, facts=[(HOSTILE, HOSTILE)])


def assert_figures_hold_together(figures):
    """Every trace's axes are in the layout, and every axis it is tied to is there: plotly draws nothing otherwise."""
    for figure in figures:
        layout = figure["layout"]
        assert {trace["type"] for trace in figure["data"]} <= {"scatter", "scatter3d", "mesh3d"}  # plotly's bundle
        for trace in figure["data"]:
            if trace["type"] == "scatter3d":
                assert len(trace["x"]) == len(trace["y"]) == len(trace["z"])
                continue
            assert len(trace["x"]) == len(trace["y"])
            for letter in "xy":
                ref = trace.get(f"{letter}axis", letter)
                assert ref != f"{letter}1"  # plotly's first axes have no number
                assert f"{letter}axis{ref[1:]}" in layout
        for name, content in layout.items():
            if name[1:5] == "axis":
                for tie in ("anchor", "overlaying", "scaleanchor", "matches"):
                    if tie in content:
                        assert f"{content[tie][0]}axis{content[tie][1:]}" in layout, (name, tie)


@pytest.mark.parametrize("make", [lambda: measure_report(full_run()), calibration_page])
def test_a_page_is_complete_in_itself_and_runs_nothing_that_names_say(make):
    page = make()
    tags = Tags(page)
    assert tags.tags.count("script") == 3  # the figures, plotly, what draws them
    assert "img" not in tags.tags
    assert HOSTILE in tags.text  # shown as it is
    assert all(load.startswith(("data:image/", "#")) for load in tags.loads)
    assert "default-src 'none'" in page
    assert tags.has_plotly
    assert_figures_hold_together(tags.figures)


def test_figures_of_a_run_are_in_the_page():
    poses, truth = poses_and_truth(200)
    page = Tags(measure_report(full_run(poses=poses, truth=truth)))
    errors = np.array([pose_difference(p.pose, t) for p, t in zip(poses, truth, strict=True)])
    for i, scale in enumerate([1e3] * 3 + [180 / np.pi] * 3):
        assert figure_of(float(np.sqrt(np.mean(errors[:, i] ** 2)) * scale)) in page.text
    assert "200 of 200 frames (100.0 %)" in page.text
    assert figure_of(0.1 * np.sqrt(2.0), "px") in page.text
    inside = np.mean(np.sum((errors / STD) ** 2, axis=1) <= 12.5916)
    assert names_it(page.text, f"{100 * inside:.1f} %", "95 %")
    assert "claims are true" in page.text


@pytest.mark.parametrize(("scale", "said"), [(0.2, "larger than the errors"), (2.0, "too small")])
def test_claims_that_the_truth_does_not_bear_out_are_not_called_true(scale, said):
    poses, truth = poses_and_truth(200, scale=scale)
    text = Tags(measure_report(full_run(poses=poses, truth=truth))).text
    assert said in text
    assert "claims are true" not in text


VERDICTS = {
    "Complete": lambda: {"poses": poses_and_truth(40, lost=(3,))[0]},
    "With gaps": lambda: {"poses": poses_and_truth(40, lost=range(10))[0]},
    "No pose": lambda: {"poses": poses_and_truth(40, lost=range(40))[0]},
    "Broken off": lambda: {"poses": poses_and_truth(40)[0], "error": "left: the camera is gone"},
    "Claim doubted": lambda: dict(zip(("poses", "truth"), poses_and_truth(400, scale=2.0), strict=True)),
    "Inconsistent": lambda: {"poses": poses_and_truth(40)[0], "consistency": found("inconsistent", "Fasten it.")},
}


def found(verdict, advice=""):
    return SimpleNamespace(verdict=verdict, sentence="The rig moved.", advice=advice)


@pytest.mark.parametrize("word", VERDICTS)
def test_the_verdict_says_what_happened(word):
    verdict = judged(**VERDICTS[word]())
    assert verdict.headline == word
    if word == "No pose":
        assert names_it(verdict.reasons[0], "left frame", "0 px")
    if word == "Broken off":
        assert names_it(verdict.reasons[0], "camera is gone", "40 of 40")
    if word == "Inconsistent":
        assert verdict.next == ["Fasten it."]
    unchecked = judged(**VERDICTS["Complete"](), consistency=found("unchecked"))
    assert unchecked.headline == "Complete" and unchecked.next != judged(**VERDICTS["Complete"]()).next


NOTHING = {
    "no frames": lambda: {"poses": (), "truth": None, "samples": (), "residuals": {}},
    "one frame": lambda: dict(zip(("poses", "truth"), poses_and_truth(1), strict=True)),
    "all lost": lambda: dict(zip(("poses", "truth"), poses_and_truth(3, lost=range(3)), strict=True)),
    "positions only": lambda: dict(zip(("poses", "truth"), poses_and_truth(3, position=range(3)), strict=True)),
    "no spots, no times": lambda: {"samples": [sample(())], "median_ms": None, "p99_ms": None},
    "no residuals": lambda: {"residuals": {"left": np.empty((0, 3))}, "parent": "world"},
    "residuals of zero": lambda: {"residuals": {"left": np.zeros((4, 3))}},
}


@pytest.mark.parametrize("case", NOTHING)
def test_runs_with_nothing_in_them_still_make_a_page(case):
    tags = Tags(measure_report(full_run(**NOTHING[case]())))
    assert "nan" not in tags.text.lower()
    assert_figures_hold_together(tags.figures)


def test_a_long_run_stays_small_and_keeps_its_outlier():
    some, true = poses_and_truth(500, lost=range(100, 110))
    poses, truth = [replace(some[i % 500], t_s=i / 30) for i in range(10_000)], [true[i % 500] for i in range(10_000)]
    wild = np.add(poses[6543].pose.translation, (0.0, 0.05, 0.0))
    poses[6543] = replace(
        poses[6543], T_parent_target=RigidTransform.from_components(wild, poses[6543].pose.rotation).as_matrix()
    )
    rng = np.random.default_rng(0)
    residuals = {"left": np.column_stack([np.arange(60_000) // 6, 0.05 * rng.standard_normal((60_000, 2))])}
    page = measure_report(full_run(poses=poses, truth=truth, residuals=residuals))
    assert len(page) < LARGEST
    tags = Tags(page)
    largest = max(len(trace["x"]) for figure in tags.figures for trace in figure["data"])
    assert largest <= 3 * MAX_PLOTTED  # a band goes there and back
    y = max(v for trace in tags.figures[3]["data"] if trace.get("yaxis") == "y2" for v in trace["y"] if v is not None)
    assert y == pytest.approx(50.0, abs=0.2)  # mm, the outlier of the error in y


def test_a_truth_of_another_length_is_refused():
    with refuses(Inconsistent, "3 true poses", "40"):
        full_run(truth=poses_and_truth(3)[1], verdict=judged(()))
    with refuses(Inconsistent, "left, right"):
        full_run(residuals={"middle": np.zeros((1, 3))})


UV = np.random.default_rng(2).uniform((0, 0), (640, 480), (500, 2))
CALIBRATIONS = {
    "nothing": (9, 0.161, UV, ""),
    "few used": (5, 0.161, UV, "only 5 of 10 pairs could be used"),
    "over-fitted": (9, 0.5, UV, "3.7 times worse"),
    "left out badly": (9, 0.7, UV, "0.7 px, beyond 0.6 px"),
    "one corner": (9, 0.161, 0.3 * UV, "% of the left image"),
}


@pytest.mark.parametrize("case", CALIBRATIONS)
def test_the_verdict_on_a_calibration(case):
    used, left_out, uv, reason = CALIBRATIONS[case]
    doubts = images_doubted(used, 10, 0.135, left_out, {"left": (CAMERA, uv)}, noun="pairs")
    verdict = images_verdict("9 of 10 pairs fit", doubts, [], squares=False, noun="pairs")
    assert verdict.level == ("care" if reason else "good")
    assert reason in verdict.reasons[0] and len(doubts) == (0 if not reason else 2 if case == "left out badly" else 1)
    page = Tags(calibration_page(verdict_=verdict)).text
    assert all(part in page for part in (verdict.headline, *verdict.reasons, *verdict.next))


CHROMIUM = Path("/usr/bin/chromium")


def boards_page():
    poses = [RigidTransform.from_translation([0.1 * k, 0.0, 1.0]) for k in range(3)]
    picture = BoardPicture(
        name="left/a-picture-with-a-long-name-0001.png",
        jpeg=b"",
        width=640,
        height=480,
        uv_px=np.array([[10.0, 20.0], [300.0, 200.0]]),
        residual_px=np.array([0.1, 0.4]),
    )
    views = BoardViews(
        parent="the camera",
        outline_m=np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.1, 0.0]]),
        T_parent_board=poses,
        cameras=[("camera", CAMERA, RigidTransform.identity())],
        names=["left/a-picture-with-a-long-name-0001.png"] * 3,
        rms_px=[0.1, 0.2, 0.3],
        pictures=[(k, picture) for k in range(3)],
    )
    page = Page(
        title="boards", subtitle="", verdict=Verdict(level="good", headline="Good", reasons=[""], next=[""]), cards=()
    )
    add_boards(page, views)
    return page.html(created=datetime(2026, 1, 1))


def compare_page():
    rows = [Difference(name="left.cx", unit="px", a=320.0, b=321.8, difference=1.8, std=0.43)] * 24
    course = Course(t_s=np.arange(50.0), values=np.full((50, 6), 1e-3), std=np.full((50, 6), 1e-3))
    names = ("/a/very/long/way/to/a/result/before.yaml", "after.yaml")
    verdict = Verdict(level="bad", headline="They differ", reasons=["It moved."], next=["Look."])
    return compare_report("rig", names, verdict, rows, effects=[("shift", "1.8 px")], notes=["One."], course=course)


PAGES = {
    "measure": lambda: measure_report(full_run()),
    "calibration": calibration_page,
    "boards": boards_page,
    "compare": compare_page,
    "arm": lambda: arm_report(preset("irb120"), np.zeros(6)),
}


@pytest.mark.skipif(not CHROMIUM.exists(), reason="there is no Chromium")
def test_pages_fit_a_telephone_and_draw_without_an_error(tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox", "--disable-gpu"])
        tab = browser.new_page(viewport={"width": 390, "height": 800}, color_scheme="dark")
        tab.set_default_timeout(150_000)  # of a busy computer
        troubles = []
        tab.on("pageerror", lambda error: troubles.append(str(error)))
        for name, make in PAGES.items():
            file = tmp_path / f"{name}.html"
            file.write_text(make(), encoding="utf-8")
            assert file.stat().st_size < LARGEST, name
            tab.goto(file.as_uri())
            tab.wait_for_selector("html[data-drawn]", state="attached")
            assert tab.evaluate("document.documentElement.scrollWidth") <= 390, name
            undrawn = tab.evaluate(
                "[...document.querySelectorAll('.plot')].filter(p => !p.querySelector('svg')).length"
            )
            assert undrawn == 0, name
        browser.close()
    assert troubles == []
