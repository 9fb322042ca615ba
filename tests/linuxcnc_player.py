"""The real LinuxCNC runs a G-code program on a genserkins arm, without a screen; what its joints did comes back.

It needs Debian's linuxcnc-uspace, which refuses root: as root it is run as nobody. One instance runs on a machine at a
time. `play(program, craig_rows, ...)` returns the joints once a millisecond, and what LinuxCNC said.
"""

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

LOCK = Path("/tmp/linuxcnc.lock")
NML = Path("/usr/share/linuxcnc/linuxcnc.nml")
UNPRIVILEGED = 65534
PERIOD_S = 1e-3
LONGEST_S = 120.0

AXIS = """
[AXIS_{letter}]
MAX_VELOCITY = {speed}
MAX_ACCELERATION = {acceleration}
MIN_LIMIT = {low}
MAX_LIMIT = {high}
"""
JOINT = """
[JOINT_{number}]
TYPE = ANGULAR
MAX_VELOCITY = {speed}
MAX_ACCELERATION = {acceleration}
MIN_LIMIT = {low}
MAX_LIMIT = {high}
FERROR = 1000
MIN_FERROR = 1000
HOME_OFFSET = {home}
HOME = {home}
HOME_SEQUENCE = 0
"""
INI = """
[EMC]
VERSION = 1.1
MACHINE = arm
DEBUG = 0
NML_FILE = linuxcnc.nml
[KINS]
JOINTS = 6
KINEMATICS = genserkins
[HAL]
HALFILE = arm.hal
[RS274NGC]
PARAMETER_FILE = arm.var
HAL_PIN_VARS = 1
INI_VARS = 1
[DISPLAY]
DISPLAY = ./at_the_screen.py
CYCLE_TIME = 0.1
PROGRAM_PREFIX = .
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.010
[TRAJ]
COORDINATES = X Y Z A B C
LINEAR_UNITS = mm
ANGULAR_UNITS = deg
DEFAULT_LINEAR_VELOCITY = 25
MAX_LINEAR_VELOCITY = {speed_mm_s}
DEFAULT_LINEAR_ACCELERATION = {acceleration_mm_s2}
MAX_LINEAR_ACCELERATION = {acceleration_mm_s2}
MAX_ANGULAR_VELOCITY = 360
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = arm.tbl
"""
HAL = """
loadrt genserkins
loadrt motmod servo_period_nsec=1000000 num_joints=6
loadrt sampler depth=4096 cfg=ffffffb
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf sampler.0 servo-thread
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""
OPERATOR = '''#!/usr/bin/python3
"""In the place of LinuxCNC's screen: homes the arm, runs the program, writes what was said, and ends LinuxCNC."""
import json, subprocess, sys, time
sys.path.append("/usr/lib/python3/dist-packages")
import linuxcnc
said, log = [], open("joints.txt", "w")
sampler = subprocess.Popen(["halsampler", "-t"], stdout=log)
stat, command, errors = linuxcnc.stat(), linuxcnc.command(), linuxcnc.error_channel()
def hear():
    while (one := errors.poll()) is not None:
        said.append(one[1])
def until(holds, limit_s):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        stat.poll(); hear()
        if holds():
            return True
        time.sleep(0.01)
    return False
done = False
try:
    command.state(linuxcnc.STATE_ESTOP_RESET); command.wait_complete()
    command.state(linuxcnc.STATE_ON); command.wait_complete()
    command.mode(linuxcnc.MODE_MANUAL); command.wait_complete(); command.teleop_enable(0); command.wait_complete()
    command.home(-1)
    homed = until(lambda: all(stat.homed[:6]), 10.0)
    command.mode(linuxcnc.MODE_AUTO); command.wait_complete()
    command.program_open(PROGRAM)
    command.auto(linuxcnc.AUTO_RUN, 0)
    until(lambda: stat.interp_state != linuxcnc.INTERP_IDLE, 3.0)
    done = until(lambda: stat.interp_state == linuxcnc.INTERP_IDLE and stat.inpos, LIMIT)
    time.sleep(0.3)
finally:
    hear(); sampler.terminate(); sampler.wait(); log.close()
    json.dump({"homed": homed, "done": done, "said": said}, open("said.json", "w"))
'''


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """t_s (m,), q_rad (m, 6) and speed_rad_s (m - 1, 6) of the joints while the program moved; said: its messages."""

    t_s: NDArray[np.float64]
    q_rad: NDArray[np.float64]
    said: tuple[str, ...]
    done: bool


def missing() -> str:
    """Return why LinuxCNC cannot be run here; empty where it can."""
    if shutil.which("linuxcnc") is None or not NML.is_file():
        return "LinuxCNC is not installed: apt-get install linuxcnc-uspace"
    return f"another LinuxCNC runs here ({LOCK})" if LOCK.exists() else ""


def play(
    program: str,
    rows: Sequence[tuple[float, float, float]],
    home_rad: NDArray[np.float64],
    *,
    lower_rad: NDArray[np.float64],
    upper_rad: NDArray[np.float64],
    acceleration_m_s2: float,
    acceleration_rad_s2: float,
    joint_speed_deg_s: float = 30.0,
) -> Played:
    """Run a program from where the joints stand at home_rad (6,) and return what they did.

    rows: a (m), alpha (rad), d (m) of each joint in Craig's convention. acceleration_m_s2, acceleration_rad_s2: of the
    axes X Y Z and A B C. joint_speed_deg_s: what each joint may, which LinuxCNC does not keep in world mode.
    """
    with tempfile.TemporaryDirectory(prefix="linuxcnc-") as folder:
        here = Path(folder)
        acceleration_mm_s2 = 1e3 * acceleration_m_s2
        ini = INI.format(speed_mm_s=1000.0, acceleration_mm_s2=acceleration_mm_s2)
        for letter in "XYZ":
            ini += AXIS.format(letter=letter, speed=1000.0, acceleration=acceleration_mm_s2, low=-3000, high=3000)
        turn = np.rad2deg(acceleration_rad_s2)
        for letter in "ABC":
            ini += AXIS.format(letter=letter, speed=90, acceleration=turn, low=-720, high=720)
        for number, (home, low, high) in enumerate(zip(*np.rad2deg([home_rad, lower_rad, upper_rad]), strict=True)):
            ini += JOINT.format(number=number, speed=joint_speed_deg_s, acceleration=200, low=low, high=high, home=home)
        hal = HAL
        for number, (a, alpha, d) in enumerate(rows):
            hal += f"setp genserkins.A-{number} {1e3 * float(a)!r}\nsetp genserkins.ALPHA-{number} {float(alpha)!r}\n"
            hal += f"setp genserkins.D-{number} {1e3 * float(d)!r}\n"
            hal += f"net m{number} joint.{number}.motor-pos-cmd => joint.{number}.motor-pos-fb\n"
            hal += f"net j{number} joint.{number}.pos-cmd => sampler.0.pin.{number}\n"
        hal += "net program motion.coord-mode => sampler.0.pin.6\n"
        operator = OPERATOR.replace("PROGRAM", repr(str(here / "program.ngc"))).replace("LIMIT", f"{LONGEST_S:g}")
        nml = "".join(line.replace("TCP=5005", "") + "\n" for line in NML.read_text().splitlines())
        files = {
            "arm.ini": ini,
            "arm.hal": hal,
            "at_the_screen.py": operator,
            "program.ngc": program,
            "linuxcnc.nml": nml,
        }
        for name, content in {**files, "arm.tbl": "", "arm.var": ""}.items():
            (here / name).write_text(content)
        (here / "at_the_screen.py").chmod(0o755)
        output = _run(here)
        if not (here / "said.json").is_file():
            raise RuntimeError(f"LinuxCNC did not come up: {output[-2000:]}")
        told = json.loads((here / "said.json").read_text())
        samples = [line.split() for line in (here / "joints.txt").read_text().splitlines()]
    table = np.array([[float(cell) for cell in row] for row in samples if len(row) == 8 and row[7] == "1"])
    q = np.deg2rad(table[:, 1:7])
    moves = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > 1e-9)
    keep = slice(moves[0], moves[-1] + 2) if len(moves) else slice(0, 1)
    return Played(
        t_s=PERIOD_S * (table[keep, 0] - table[keep, 0][0]), q_rad=q[keep], said=tuple(told["said"]), done=told["done"]
    )


def _run(folder: Path) -> str:
    """Run LinuxCNC in a folder to its end, as nobody where this is root; return what it printed."""
    environment = {**os.environ, "HOME": str(folder), "RTAPI_FIFO_PATH": str(folder / "fifo")}
    command = ["linuxcnc", str(folder / "arm.ini")]
    if os.geteuid() == 0:
        for one in (folder, *folder.iterdir()):
            os.chown(one, UNPRIVILEGED, UNPRIVILEGED)
        command = ["setpriv", f"--reuid={UNPRIVILEGED}", f"--regid={UNPRIVILEGED}", "--clear-groups", *command]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST_S + 60.0, check=False
    )
    told = folder / "linuxcnc_debug.txt"
    return f"exit {done.returncode}: {done.stdout}{done.stderr}{told.read_text() if told.is_file() else ''}"
