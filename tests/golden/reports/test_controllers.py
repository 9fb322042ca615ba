"""Strangers' controllers: calibrated DH tables, an RSI of another type or in relative mode, a hand-eye turned round."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import armsight
import warm_python
from refusals import names_it
from reports import case


def test_a_controllers_own_calibrated_table_is_read():
    folder = case("arms-02")
    arm = armsight.read_arm(folder / "ur5-calibrated.yaml")
    joints = np.loadtxt(folder / "joints.csv", delimiter=",", skiprows=1)
    right = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    T = arm.fk(joints)
    assert np.allclose(T[:, :3, 3], right[:, :3], atol=1e-8)
    turned = Rotation.from_matrix(T[:, :3, :3]) * Rotation.from_quat(right[:, 3:]).inv()
    assert turned.magnitude().max() < 1e-8


# Against the controller of the case, in real time, as its owner ran it.


def listens(port: int) -> bool:
    """Whether a program of this computer is bound to a UDP port."""
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def beside_the_controller(tmp_path, port: int, *words: str, controller: tuple[str, ...]) -> tuple[int, str, float]:
    """Run a command of ours, and the case's controller once it is waited for.

    Returns its exit code, what it told, and the farthest that a joint went, degrees.
    """
    command = [warm_python.commands() / "armsight", "robot", *words, "--robot", f"rsi:{port}"]
    words_of_it = tmp_path / "told.txt"
    with words_of_it.open("w") as file:
        begun = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, cwd=tmp_path)
    while begun.poll() is None and not listens(port):
        time.sleep(0.01)
    play = [sys.executable, case("arms-19") / "krc.py", str(port), "--for_s", "6", *controller]
    told = subprocess.run(play, stdout=subprocess.PIPE, text=True, cwd=tmp_path, check=True).stdout
    ways = re.search(r"largest way deg \[([^]]*)]", told)
    assert ways, told
    return begun.wait(60), words_of_it.read_text(), max(float(way) for way in ways[1].split(","))


JOG = ("jog", "--joint", "1", "--by", "0.05", "--yes")


@pytest.mark.alone
def test_another_sen_type_is_named_and_the_rsi_file_cures_it(tmp_path):
    code, told, way_deg = beside_the_controller(tmp_path, 49162, *JOG, controller=("--sen", "KUKA"))
    assert (code, way_deg) == (4, 0.0) and names_it(told, "Sen type", "--rsi-config")
    cured = (*JOG, "--rsi-config", str(case("arms-19") / "eth.xml"))
    code, told, way_deg = beside_the_controller(tmp_path, 49163, *cured, controller=("--sen", "KUKA"))
    assert code == 0, told
    assert way_deg == pytest.approx(np.degrees(0.05), abs=0.02)


@pytest.mark.alone
def test_corrections_that_add_up_are_noticed_by_the_probe(tmp_path):
    relative = ("--sen", "ImFree", "--mode", "relative")
    code, told, way_deg = beside_the_controller(tmp_path, 49164, *JOG, controller=relative)
    assert code == 4 and names_it(told, "relative")
    assert way_deg < 0.1  # it was 30.6 where 2.9 were asked for


@pytest.mark.alone
def test_a_hand_eye_turned_round_stops_the_servo(tmp_path):
    turned, cell, ours = "180", tmp_path / "servo-cell", warm_python.commands() / "armsight"

    def armsight_(*words: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([ours, *map(str, words)], capture_output=True, text=True, cwd=tmp_path, check=False)

    assert armsight_("simulate", "pachidis2005-static", "--frames", 1, "-o", cell).returncode == 0
    subprocess.run([sys.executable, case("arms-23") / "turn.py", turned], cwd=tmp_path, check=True)
    given = ("--rig", cell / "rig.yaml", "--target", cell / "target.yaml", "--handeye", f"he-{turned}.yaml")
    motion = ("--hand", "still", "--seconds", "6", "--yes", "-o", "out", "--json")
    done = armsight_("servo", "--robot", "sim:pachidis2005-static", *given, *motion)
    assert done.returncode == 3
    told = json.loads(done.stdout)
    assert told["wrong_premise"] == "hand-eye" and names_it(told["stopped_by"], f"{turned} deg")
    assert told["error"]["max_m"] < 0.015, told
