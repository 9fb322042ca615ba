"""Strangers' controllers: a calibrated DH table, an RSI in relative mode."""

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
def test_corrections_that_add_up_are_noticed_by_the_probe(tmp_path):
    relative = ("--sen", "ImFree", "--mode", "relative")
    code, told, way_deg = beside_the_controller(tmp_path, 49164, *JOG, controller=relative)
    assert code == 4 and names_it(told, "relative")
    assert way_deg < 0.1  # it was 30.6 where 2.9 were asked for
