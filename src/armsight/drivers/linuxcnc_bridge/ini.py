"""What an INI file says of the machine, and the HAL lines that belong to the bridge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

VERSION = 2
"""Of the bridge and what goes over the line."""

PORT = 49160
COUNT = 1e-4
"""Degrees, or the INI's length unit, of one jog count."""

AXES = "XYZABC"
"""Axes of LinuxCNC's world whose external offsets correct the pose of an arm of so many joints."""

BEAT_S = 0.1
"""HAL's watchdog waits so long for the bridge; with other work on the computer 0.05 s trips by itself now and then."""

NML = Path("/usr/share/linuxcnc/linuxcnc.nml")

Ini = dict[str, dict[str, str]]


def read_ini(path: Path) -> Ini:
    """Return the values of an INI file by section and key; of one that is there twice the first, as LinuxCNC does."""
    found: Ini = {}
    section: dict[str, str] = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        text = line.strip()
        if text.startswith("[") and "]" in text:
            section = found.setdefault(text[1 : text.index("]")].strip(), {})
        elif "=" in text and text[0] not in "#;":
            key, _, value = text.partition("=")
            section.setdefault(key.strip(), value.split("#")[0].split(";")[0].strip())
    return found


def number(ini: Ini, section: str, key: str, otherwise: float) -> float:
    """Return a number of an INI file."""
    return float(ini.get(section, {}).get(key) or otherwise)


def listens(ini: Ini, folder: Path) -> bool:
    """Tell whether LinuxCNC opens a TCP port, as with its own NML file, on every network."""
    name = ini.get("EMC", {}).get("NML_FILE") or ini.get("LINUXCNC", {}).get("NML_FILE")
    path = folder / name if name else NML
    rows = path.read_text(errors="replace").splitlines() if path.is_file() else []
    return any("TCP=" in row for row in rows if row.startswith("B "))


def describe(path: Path) -> dict[str, Any]:
    """Return what a driver has to know of the machine of an INI file; where a key is missing, LinuxCNC's default."""
    ini = read_ini(path)
    joints = []
    for j in range(int(number(ini, "KINS", "JOINTS", 0))):
        name = f"JOINT_{j}"
        joints.append(
            {
                "linear": ini.get(name, {}).get("TYPE", "LINEAR").upper() != "ANGULAR",
                "lower": number(ini, name, "MIN_LIMIT", -1e99),
                "upper": number(ini, name, "MAX_LIMIT", 1e99),
                "speed": number(ini, name, "MAX_VELOCITY", 1.0),
                "acceleration": number(ini, name, "MAX_ACCELERATION", 1.0),
            }
        )
    traj = ini.get("TRAJ", {})
    return {
        "bridge": VERSION,
        "ini": str(path),
        "joints": joints,
        "offsets": _offsets(ini) if len(joints) == len(AXES) else [],
        "servo_s": 1e-9 * number(ini, "EMCMOT", "SERVO_PERIOD", 1e6),
        "kinematics": (ini.get("KINS", {}).get("KINEMATICS") or "?").split()[0],
        "linear_units": traj.get("LINEAR_UNITS", "mm"),
        "angular_units": traj.get("ANGULAR_UNITS", "deg"),
        "jog_acceleration": number(ini, "TRAJ", "DEFAULT_LINEAR_ACCELERATION", 1e99),
        "listens": listens(ini, path.parent),
    }


def _offsets(ini: Ini) -> list[dict[str, Any]]:
    """Return what external offsets of the axes may do: the share OFFSET_AV_RATIO of what the axis may; 0 without it."""
    found = []
    for axis in AXES:
        share = min(number(ini, f"AXIS_{axis}", "OFFSET_AV_RATIO", 0.0), 0.9)
        found.append(
            {
                "linear": axis in "XYZ",
                "lower": -1e99,
                "upper": 1e99,
                "speed": share * number(ini, f"AXIS_{axis}", "MAX_VELOCITY", 1.0),
                "acceleration": share * number(ini, f"AXIS_{axis}", "MAX_ACCELERATION", 1.0),
            }
        )
    return found


JOINT_LINES = """\
net armsight-count-{j} streamer.0.pin.{j} => joint.{j}.jog-counts
net armsight-cmd-{j} joint.{j}.pos-cmd => sampler.0.pin.{j}
net armsight-fb-{j} joint.{j}.pos-fb => sampler.0.pin.{k}
net armsight-jog-enable => joint.{j}.jog-enable
setp joint.{j}.jog-scale {count}
setp joint.{j}.jog-accel-fraction 1
setp joint.{j}.jog-vel-mode 0
"""

AXIS_LINES = """\
net armsight-offset-count-{axis} streamer.0.pin.{j} => axis.{axis}.eoffset-counts
net armsight-offset-{axis} axis.{axis}.eoffset => sampler.0.pin.{k}
net armsight-offsets => axis.{axis}.eoffset-enable
setp axis.{axis}.eoffset-scale {count}
"""

OFFSET_LINES = """\
# Corrections of a pose while LinuxCNC runs a program, which is paused where they end.
{axes}net armsight-running halui.program.is-running
net armsight-pause => halui.program.pause
net armsight-inhibit => motion.feed-inhibit
"""

LINES = """\
# armsight's link: [HAL]HALFILE of the INI, behind the machine's own.
# Goals come as jog counts, one row for each servo cycle; the joints are sampled in the same cycles.
loadrt streamer depth=400 cfg={counts}
loadrt sampler depth=4000 cfg={samples}
addf streamer.0 servo-thread 1
addf sampler.0 servo-thread
{joints}{offsets}\
# A bridge that dies while somebody drives lets the machine fall off, {beat} s after its last sign of life.
loadrt watchdog num_inputs=1
loadrt or2 names=armsight-or
addf watchdog.set-timeouts servo-thread
addf watchdog.process servo-thread
addf armsight-or servo-thread
setp watchdog.timeout-0 {beat}
net armsight-heartbeat => watchdog.input-0
net armsight-session => watchdog.enable-in
net armsight-ok watchdog.ok-out => armsight-or.in0
net armsight-free => armsight-or.in1
net armsight-enable armsight-or.out => motion.enable
# What the bridge has to know.
net armsight-enabled motion.motion-enabled
net armsight-homed motion.is-all-homed
net armsight-teleop motion.teleop-mode
net armsight-coord motion.coord-mode
net armsight-estop halui.estop.is-activated
net armsight-auto halui.mode.is-auto
net armsight-mdi halui.mode.is-mdi
# Leave these out where armsight may not end the e-stop, switch on, home, or choose the mode.
net armsight-estop-reset => halui.estop.reset
net armsight-machine-off => halui.machine.off
net armsight-machine-on => halui.machine.on
net armsight-home-all => halui.home-all
net armsight-manual => halui.mode.manual
net armsight-joint-mode => halui.mode.joint
net armsight-world-mode => halui.mode.teleop
loadusr -Wn armsight /usr/bin/python3 {bridge} run {ini} --bind {bind} --port {port}
"""


def hal_lines(ini: Path, bridge: str, bind: str, port: int) -> str:
    """Return the HAL lines that belong to the machine of an INI file; bridge: where this folder is."""
    n = len(describe(ini)["joints"])
    joints = "".join(JOINT_LINES.format(j=j, k=n + j, count=COUNT) for j in range(n))
    more = len(AXES) if n == len(AXES) else 0
    axes = "".join(
        AXIS_LINES.format(axis=axis.lower(), j=n + i, k=2 * n + i, count=COUNT) for i, axis in enumerate(AXES[:more])
    )
    return LINES.format(
        counts=(n + more) * "s",
        samples=(2 * n + more) * "f",
        joints=joints,
        offsets=OFFSET_LINES.format(axes=axes) if more else "",
        beat=BEAT_S,
        bridge=bridge,
        ini=ini,
        bind=bind,
        port=port,
    )
