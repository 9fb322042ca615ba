"""Cures of robots: moving, playing, following, supervising, serving, publishing. Times pass by a clock set by hand."""

from pathlib import Path

from armsight.clock import ManualClock
from armsight.drivers.jog_inputs import KeyboardInput
from armsight.kinematics import preset
from armsight.ops import robots
from armsight.ops.action import action_of
from armsight.ops.requests.motion import settings_of
from armsight.ops.requests.plant import PlantFlags
from armsight.ops.robot.jog import _check_frame as check_hand
from armsight.ops.robot.opening import ClockedRobot, arm_model, driver_settings, guard_for, open_robot

SIM = "sim:webcam-cell"
URL = "opc.tcp://127.0.0.1:4840"
CERTIFICATE, KEY, TOKENS = Path("keys/opcua-cert.pem"), Path("keys/opcua-key.pem"), Path("tokens.yaml")
BOX = "forbidden:\n- {name: wall, lower_m: [-2, -0.3, -1], upper_m: [0, -0.2, 1]}\n"
LIMITS = "format: armsight/limits\nversion: 1\n"
FILES = {
    "box.yaml": LIMITS + BOX,
    "free.yaml": LIMITS,
    "narrow.yaml": f"{LIMITS}joints: [{{lower: -0.2, upper: 0.2}}, {{}}, {{}}, {{}}, {{}}, {{}}]\n",
    "aside.yaml": f"{LIMITS}joints: [{{lower: 0.2, upper: 1.0}}, {{}}, {{}}, {{}}, {{}}, {{}}]\n",
}


def jog(*, yes=True, **job):
    def go():
        clock = ManualClock()
        robot = open_robot(SIM, clock)
        given = ClockedRobot(robot=robot, clock=clock, called=SIM)
        return action_of(robots.jog).run({"robot": given, "joint": 1, "by": 0.1, "confirm": lambda _: yes, **job})

    return go


def plant(**flags):
    return lambda: PlantFlags(**flags).made(print)


SAFE = {"opcua": URL, "opcua_certificate": CERTIFICATE, "opcua_key": KEY}


class Bare:
    """A robot of whose arm nothing is known."""

    name, n_joints, cycle_s = "bare", 6, 0.008


TRIED = {
    ("ops/robot/jog.py", "Give one of them (--joint)"): (jog(joint=7), jog(joint=6)),
    ("ops/robot/jog.py", "Give rad or m (--by)"): (jog(by=0.0), jog(by=0.1)),
    ("ops/robot/jog.py", "Give radians (--by"): (jog(by=5.0), jog(by=0.0873)),
    ("ops/robot/jog.py", "Ask for a shorter way (--by)"): (
        jog(by=0.5, limits=Path("narrow.yaml")),
        jog(by=0.1, limits=Path("narrow.yaml")),
    ),
    ("ops/robot/jog.py", "Go back within them (--by"): (
        jog(by=-0.1, limits=Path("aside.yaml")),
        jog(by=0.2, limits=Path("aside.yaml")),
    ),
    ("ops/robot/jog.py", "or look at the limits (--limits)"): (
        jog(by=0.5, limits=Path("box.yaml"), speed=1.0),
        jog(by=0.02, limits=Path("box.yaml"), speed=1.0),
    ),
    ("ops/robot/jog.py", "Give joints, base or tool"): (
        lambda: check_hand("wrist", True, SIM),
        lambda: check_hand("tool", True, SIM),
    ),
    ("ops/robot/jog.py", "or --frame joints"): (
        lambda: check_hand("tool", False, "egm"),
        lambda: check_hand("joints", False, "egm"),
    ),
    ("drivers/jog_inputs.py", "Use --joint and --by"): (lambda: KeyboardInput(0, 9), jog(joint=1, by=0.1)),
    ("ops/robot/opening.py", "Omit --robot-set"): (
        lambda: driver_settings(SIM, {"cycle_s": "0.01"}),
        lambda: driver_settings(SIM),
    ),
    ("ops/robot/opening.py", "Give it with --arm"): (
        lambda: driver_settings("alter:1.2.3.4", {"arm": "ur10"}),
        lambda: driver_settings("alter:1.2.3.4", arm=preset("ur10")),
    ),
    ("ops/robot/opening.py", "Omit --rsi-config"): (
        lambda: driver_settings("egm:6510", rsi_config=Path("a.xml")),
        lambda: [driver_settings("egm:6510"), driver_settings("rsi:49152", rsi_config=Path("a.xml"))],
    ),
    ("ops/requests/motion.py", "each key once"): (
        lambda: settings_of(["controller"]),
        lambda: settings_of(["controller=192.168.0.10"]),
    ),
    ("ops/robot/opening.py", "Give the arm of this robot"): (
        lambda: guard_for(Bare(), preset("panda"), None),
        lambda: guard_for(Bare(), preset("ur10"), None),
    ),
    ("ops/robot/opening.py", "or limits without boxes"): (
        lambda: guard_for(Bare(), None, Path("box.yaml")),
        lambda: [guard_for(Bare(), preset("ur10"), Path("box.yaml")), guard_for(Bare(), None, Path("free.yaml"))],
    ),
    ("ops/robot/opening.py", "Give --arm with its arm.yaml"): (
        lambda: arm_model("egm:6510", None),
        lambda: arm_model("egm:6510", "irb120"),
    ),
    ("armsight_plant/publishing.py", "Give --opcua, --mqtt or"): (
        plant(stale_after_s=5.0),
        lambda: [plant(stale_after_s=5.0, foxglove="8765")(), plant()()],
    ),
    ("armsight_plant/publishing.py", "Give --opcua-certificate and"): (
        plant(opcua=URL, opcua_users=TOKENS, opcua_anonymous=True),
        plant(**SAFE, opcua_users=TOKENS, opcua_anonymous=True),
    ),
    ("armsight_plant/options.py", "Give both --opcua-certificate"): (
        plant(opcua=URL, opcua_certificate=CERTIFICATE, opcua_anonymous=True),
        plant(**SAFE, opcua_anonymous=True),
    ),
    ("armsight_plant/options.py", "makes a pair"): (plant(opcua=URL), lambda: plant(**SAFE, opcua_users=TOKENS)()),
    ("armsight_plant/options.py", "or --opcua-anonymous to let"): (
        plant(**SAFE),
        lambda: [plant(**SAFE, opcua_users=TOKENS)(), plant(**SAFE, opcua_anonymous=True)()],
    ),
    ("armsight_plant/options.py", "and the password in a file"): (
        plant(mqtt="mqtts://me:secret@a.example/cell"),
        plant(mqtt="mqtts://a.example/cell", mqtt_user="me", mqtt_password_file=Path("password")),
    ),
}
