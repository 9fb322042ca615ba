"""armsight history, and --cell of the commands whose results are filed."""

import dataclasses
import json
import sqlite3
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import histories
from action_cases import write_pairs
from armsight_lab.history.adding import file_entry
from armsight_lab.history.entry import Entry
from armsight_lab.history.figures import figures_of, parameters_of
from armsight_lab.history.place import place_of
from simulated import simulated

WEEK = timedelta(days=7)


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the history is, as the environment says; nothing is there yet."""
    path = tmp_path / "history.sqlite"
    monkeypatch.setenv("ARMSIGHT_HISTORY", str(path))
    return path


@pytest.fixture(scope="session")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pose pairs of a simulated hand-eye calibration."""
    return write_pairs(tmp_path_factory.mktemp("pairs") / "pairs.csv")


def fill(path: Path, entries: Iterable[Entry]) -> None:
    for entry in entries:
        file_entry(place_of(str(path)), entry)


def handeyes(cell: str, moved: np.ndarray, turned: np.ndarray | None = None) -> list[Entry]:
    """Calibrations of a hand-eye, weekly; moved (n, 3), m; turned (n, 3), rotation vectors in the parent's axes."""
    rng = np.random.default_rng(3)
    first = Rotation.from_euler("xyz", [10, 20, 179.99], degrees=True)
    turned = np.zeros_like(moved) if turned is None else turned
    return [
        histories.handeye_run(
            cell,
            rng.normal([0.1, 0.02, 0.05], 1e-4) + shift,
            Rotation.from_rotvec(turn + rng.normal(0.0, 1e-4, 3)) * first,
            histories.START + i * WEEK,
        )
        for i, (shift, turn) in enumerate(zip(moved, turned, strict=True))
    ]


def test_a_calibration_is_filed_with_inputs_numbers_and_deviations(armsight, history, pairs, tmp_path):
    done = armsight("calibrate", "handeye", "--pairs", pairs, "-o", tmp_path / "handeye.yaml", "--cell", "weld 3")
    assert done.code == 0
    assert "run 1" in done.text
    shown = armsight("history", "show", 1).json
    assert shown["run"]["command"] == "calibrate handeye"
    assert shown["run"]["trusted"] is (done.json["concerns"] == [])
    assert shown["inputs"][0]["path"] == str(pairs)
    assert len(shown["inputs"][0]["sha256"]) == 64
    figures = {one["name"]: one for one in shown["figures"]}
    for key in ("x_m", "y_m", "z_m"):
        assert figures[f"T_flange_camera.{key}"]["std"] == done.json["std"][key]
        assert figures[f"T_base_target.{key}"]["std"] == done.json["std_target"][key]
    assert figures["residual_rms_m"]["value"] == done.json["residual_rms_m"]
    assert [one["name"] for one in shown["parameters"]][:3] == ["handeye.x_m", "handeye.y_m", "handeye.z_m"]
    # the file of the calibration says the same
    again = armsight("history", "add", tmp_path / "handeye.yaml", "--cell", "weld 3")
    assert (again.code, again.json["run"], again.json["command"]) == (0, 2, "calibrate handeye")
    compared = armsight("history", "compare", 1, 2).json
    assert [one["name"] for one in compared["parameters"]][3:] == ["handeye.rx_rad", "handeye.ry_rad", "handeye.rz_rad"]
    for one in compared["parameters"]:
        assert abs(one["difference"]) < 1e-9
        assert one["std"] == pytest.approx(
            np.sqrt(2.0) * done.json["std"][one["name"].removeprefix("handeye.")], rel=1e-6
        )
        assert one["exceeds"] is False


def test_a_history_that_fails_loses_neither_result_nor_run(armsight, history, pairs, tmp_path):
    """The result is there with its own exit code, the run is kept beside it, and filed later."""
    history.mkdir()
    out = tmp_path / "handeye.yaml"
    done = armsight("calibrate", "handeye", "--pairs", pairs, "-o", out, "--cell", "a")
    assert done.code == 0
    assert done.json["n_used"] > 0
    assert out.exists()
    assert "NOT FILED" in done.text
    assert "folder" in done.text
    kept = tmp_path / "handeye.unfiled.json"
    assert str(kept) in done.text
    history.rmdir()
    added = armsight("history", "add", kept)
    assert (added.code, added.json["cell"]) == (0, "a")
    assert armsight("history", "show", 1).json["inputs"][0]["flag"] == "pairs"


def test_what_cannot_be_filed_is_refused_before_the_work(armsight, history, pairs, tmp_path):
    out = tmp_path / "handeye.yaml"
    for words, name in (
        (["--cell", "a\nb"], "a\\nb"),
        (["--history", "x.sqlite"], "--cell"),
        (["--cell", "a", "--history", "mysql://u:hunter2@h/d"], "mysql"),
    ):
        refused = armsight("calibrate", "handeye", "--pairs", pairs, "-o", out, *words)
        assert refused.code == 2
        assert name in refused.json["error"]["cause"] + refused.json["error"]["cure"]
        assert "hunter2" not in refused.text
        assert not out.exists()


def test_an_arms_calibration_files_its_table_and_verify_its_zeros(armsight, history, tmp_path):
    made = simulated("arm-points", seed=1)
    words = ["--model", made / "arm.yaml", "--points", made / "holdout.csv"]
    done = armsight("calibrate", "arm", *words, "-o", tmp_path / "arm.yaml", "--cell", "a", "--no-scale")
    assert done.code == 0
    shown = armsight("history", "show", 1).json
    assert shown["run"]["joints"] == "RRRRRR"
    parameters = {one["name"]: one for one in shown["parameters"]}
    zeros = [name for name in done.json["free"] if name.endswith("theta_rad")]
    assert zeros
    for name in zeros:
        assert parameters[f"joint{name[1]}.theta_rad"]["std"] == pytest.approx(done.json["std"][name])
    figures = {one["name"]: one for one in shown["figures"]}
    assert all(figures[f"corrections.{name}"]["std"] == done.json["std"][name] for name in done.json["free"])
    listed = armsight("history", "list", "--command", "calibrate").json
    assert [one["id"] for one in listed["runs"]] == [1]


def test_trend_finds_what_drifted_and_leaves_the_rest(armsight, history, tmp_path):
    n, start = 40, 32
    ramp = np.maximum(np.arange(n) - start + 1, 0) * 0.02 * histories.DEG
    fill(history, list(histories.runs("weld-3", n, drift={3: ramp}, seed=2)))
    fill(history, list(histories.runs("other", 3)))
    done = armsight("history", "trend", "--cell", "weld-3", "-o", tmp_path / "drift")
    assert done.code == 0
    assert done.json["changed"] is True
    first, *others = done.json["figures"]
    assert (first["name"], first["state"]) == ("joint3.theta_rad", "drift")
    assert start <= first["since_run"] <= start + 3
    assert first["noticed_run"] <= start + 4
    assert first["latest"] == pytest.approx(ramp[-1], abs=4.0 * first["latest_std"])
    assert "mastering" in first["to_do"]
    assert [one["state"] for one in others] == ["steady"] * 5
    assert first["runs_a_year"] == pytest.approx(365.25 / 7.0)
    assert json.loads((tmp_path / "drift/trend.json").read_text())["figures"][0] == first
    page = (tmp_path / "drift/report.html").read_text()
    assert "joint3.theta" in page
    for name in ("joint3.theta", "joint3.theta_rad"):  # as history show prints it, and in full
        alone = armsight("history", "trend", "--cell", "weld-3", "--figure", name, "-o", tmp_path / name)
        assert [one["name"] for one in alone.json["figures"]] == ["joint3.theta_rad"]
    assert "1 in 100" in page


def test_trend_holds_turns_against_the_first_pose(armsight, history, tmp_path):
    """A turn of the camera about the parent's y, where its rotation vector passes half a turn: no other axis moves."""
    n = 30
    turned = np.zeros((n, 3))
    turned[20:, 1] = 0.003
    fill(history, handeyes("a", np.zeros((n, 3)), turned))
    found = armsight("history", "trend", "--cell", "a", "-o", tmp_path / "t", "--figure", "hand-eye").json["figures"]
    changed = {one["name"]: one for one in found if "since_run" in one}
    assert list(changed) == ["handeye.ry_rad"]
    assert changed["handeye.ry_rad"]["change"] == pytest.approx(0.003, abs=4e-4)
    assert (changed["handeye.ry_rad"]["since_run"], changed["handeye.ry_rad"]["state"]) == (21, "jump")


def test_nothing_is_steady_before_a_run_was_judged(armsight, history, tmp_path):
    for n, state in ((7, "few"), (8, "jump")):  # the last one is a metre off
        fill(
            history,
            histories.baseline_runs(
                f"untold {n}", [0.5 + 1e-4 * k for k in (0, 2, 1, 3, 0, 1, 2, 1)[: n - 1]] + [1.5], None
            ),
        )
        done = armsight("history", "trend", "--cell", f"untold {n}", "--figure", "baseline_m", "-o", tmp_path / str(n))
        assert [one["state"] for one in done.json["figures"]] == [state], done.text
        assert state == "jump" or "(7, 8 are wanted)" in done.json["verdict"]


def test_numbers_that_no_chart_can_hold_are_refused_and_not_called_steady(armsight, history, tmp_path):
    fill(history, histories.baseline_runs("wide", [1e300] * 9 + [2e300] * 3, 1e297))
    done = armsight("history", "trend", "--cell", "wide", "-o", tmp_path / "t")
    assert (done.code, done.json["error"]["kind"]) == (3, "Inconsistent")
    assert "baseline_m" in done.json["error"]["cause"]


def test_two_arms_in_one_cell_are_told_and_not_held_against_each_other(armsight, history, tmp_path):
    from armsight.kinematics import preset

    fill(history, list(histories.runs("a", 3)))
    arm = preset("ur10")
    shorter = dataclasses.replace(arm, joints=arm.joints[:5])
    other = histories.arm_run(shorter, "a", np.zeros(5), histories.START + 9 * WEEK)
    notes = file_entry(place_of(str(history)), other).notes
    assert any("run 1" in note and "5 joints" in note for note in notes)
    refused = armsight("history", "trend", "--cell", "a", "-o", tmp_path / "t")
    assert (refused.code, refused.json["error"]["kind"]) == (3, "Inconsistent")
    assert "run 4" in refused.json["error"]["cause"]
    since = refused.json["error"]["cure"].rpartition("--since ")[2]
    assert armsight("history", "trend", "--cell", "a", "--since", since, "-o", tmp_path / "t").json["n_runs"] == 1


def test_runs_that_doubt_themselves_wrong_clocks_and_numbers_that_are_none(armsight, history, tmp_path):
    entries = handeyes("a", np.zeros((12, 3)))
    first = entries[0]
    place = place_of(str(history))
    for entry in entries[1:]:
        file_entry(place, entry)
    bad = histories.handeye_run(
        "a", [9.0, 9.0, 9.0], Rotation.identity(), histories.START + 20 * WEEK, concerns=["two axes of turning"]
    )
    file_entry(place, bad)
    late = histories.handeye_run("a", [0.1, 0.02, 0.05], Rotation.identity(), histories.START + 3000 * WEEK)
    file_entry(place, late)
    assert any("clock" in note for note in file_entry(place, first).notes)
    with sqlite3.connect(history) as held:  # a number of a result that was none
        held.execute("UPDATE figures SET value = NULL WHERE run_id = 3")
        held.execute("DELETE FROM runs WHERE created LIKE '208%'")
    words = ["history", "trend", "--cell", "a", "-o", tmp_path / "t", "--overwrite"]
    done = armsight(*words).json
    assert (done["n_doubted"], done["changed"]) == (1, False)
    figure = armsight(*words, "--figure", "T_flange_camera.x_m").json["figures"][0]
    assert (figure["n"], figure["silent"]) == (11, 1)
    shown = armsight("history", "show", 12).json["run"]
    assert (shown["trusted"], shown["reason"]) == (False, "two axes of turning")


def test_numbers_find_their_deviations_wherever_a_result_tells_them():
    found = {
        one.name: one
        for one in figures_of(
            {
                "time": {"offset_s": 0.2, "std_s": 0.01},
                "time_offset_s": 0.3,
                "time_offset_std_s": 0.02,
                "target_scale": {"factor": 1.001, "std": 0.002, "p": 0.5},
                "tip_m": [0.1, 0.2, 0.3],
                "std": {"x_m": 1.0, "y_m": 2.0, "z_m": 3.0, "base.x_m": 4.0},
                "joints": [{"index": 1, "a_m": 0.5, "std": {"a_m": 0.1}, "offset_rad": 0.01, "std_rad": 0.002}],
                "alignment": {"plate": {"seen_thickness_m": 0.003, "seen_thickness_std_m": 1e-5}},
                "gain": True,
                "nothing": None,
                "rejected": [{"row": 1}] * 65,
            }
        )
    }
    told = {name: one.std for name, one in found.items() if one.std is not None}
    assert told == {
        "time.offset_s": 0.01,
        "time_offset_s": 0.02,
        "target_scale.factor": 0.002,
        "tip_m.1": 1.0,
        "tip_m.2": 2.0,
        "tip_m.3": 3.0,
        "joints.1.a_m": 0.1,
        "joints.1.offset_rad": 0.002,
        "alignment.plate.seen_thickness_m": 1e-5,
    }
    assert found["std.base.x_m"].value == 4.0
    assert found["joints.1.offset_rad"].unit == "rad"
    assert not {"gain", "nothing"} & set(found)
    assert not any(name.startswith("rejected") for name in found)


def test_what_may_drift_has_one_name_whatever_found_it():
    verified = {"joints": [{"index": 1, "offset_rad": 0.01, "std_rad": 0.002}, {"index": 2, "offset_rad": None}]}
    assert [(one.name, one.std) for one in parameters_of(verified, None).quantities] == [("joint1.offset_rad", 0.002)]
    stereo = {"baseline_m": 0.12, "std": {"baseline_m": 1e-5}}
    assert [(one.name, one.std) for one in parameters_of(stereo, None).quantities] == [("baseline_m", 1e-5)]
    places = {"left": [0.0, 0.0, 0.0], "top": [0.1, 0.2, 0.3]}
    three = {"baseline_m": None, "position_m": places, "std": {"top.tx_m": 1e-4, "top.ty_m": 2e-4, "top.tz_m": 3e-4}}
    assert [(one.name, one.value, one.std) for one in parameters_of(three, None).quantities] == [
        ("camera.top.x_m", 0.1, 1e-4),  # the first camera is held where it is
        ("camera.top.y_m", 0.2, 2e-4),
        ("camera.top.z_m", 0.3, 3e-4),
    ]
    tip = {"tip_m": [0.0, 0.0, 0.1], "std": {"x_m": 1e-4, "y_m": 1e-4, "z_m": 1e-4}}
    assert [one.name for one in parameters_of(tip, None).quantities] == ["tip.x_m", "tip.y_m", "tip.z_m"]
    drifting = {"value": 4e-4, "std": None, "note": "the visits drift by 0.45 mm"}
    norm = {
        "iso9283": {"AP_m": {"value": 3e-4, "std": 2e-5}, "RP_m": drifting, "AP_m P1": {"value": 3e-4, "std": 2e-5}}
    }
    assert [(one.name, one.value, one.std, one.unit) for one in parameters_of(norm, None).quantities] == [
        ("AP_m", 3e-4, 2e-5, "m")
    ]
    joint = {"type": "revolute", "theta_rad": 0.1, "std": {"theta_rad": 1e-4}}
    assert parameters_of({"joints": [joint, {**joint, "type": "prismatic"}]}, None).joints == "RP"
