"""Cures of calls in Python: units and shapes of what is given."""

import socket
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

import armsight
from armsight.control.guard import Box
from armsight.control.guard.plausible import check_corners
from armsight.control.paths.exports import krl, rapid
from armsight.control.paths.program import Program, program_moves
from armsight.control.play.path_source import JointMotionSource
from armsight.control.play.shape import Weave
from armsight.control.servo.law import chosen_gain, delay_cycles, on_axis
from armsight.drivers.images import ImageReading, image_of_8_bits
from armsight.drivers.opening import open_source
from armsight.drivers.remote.wire import ServerAddress
from armsight.kinematics import preset
from armsight.kinematics.joints import Coupling
from armsight.measure.settings import Pace
from armsight.ops.arrays import as_size
from armsight.ops.simulation.scenarios import load_scenario
from armsight.optics import Camera, Plate
from armsight.records import Motion, Spots, TaughtPath
from armsight.records.camera import CameraTiming
from armsight.records.checks import require_rigid
from armsight.records.target import Colour, TargetKind, board_target
from armsight.server.waiting import listening
from armsight.server.web_server import ServeOptions, check_options
from armsight.store import read_rig, read_target
from armsight.store.arm_file import write_arm
from armsight.store.urdf import urdf_text
from armsight_lab.api.design import _mount, _size
from armsight_lab.batch.cluster import Workers
from armsight_lab.cell_plan.run import _extent
from armsight_lab.design.request import mount_of
from armsight_plant.options import mqtt_options

FILES: dict[str, str] = {}
CERTIFICATE, KEY = Path("keys/opcua-cert.pem"), Path("keys/opcua-key.pem")
IRB = preset("irb120")
AT = np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])
STILL = np.full((4, 6), 0.1)
DEEP = np.full((2, 2), 4000, np.uint16)
LIGHT = np.full((2, 2), 40, np.uint8)


def each(*calls):
    """Return a call of several."""
    return lambda: [call() for call in calls]


def coupled(share):
    return lambda: armsight.Arm(name="a", joints=IRB.joints, couplings=(Coupling(joint="j3", by="j2", share=share),))


def motion(override):
    return lambda: JointMotionSource(Motion(t_s=np.arange(4.0), q=STILL), override=override)


def program(**more):
    rows = RigidTransform.from_translation([[0.3, 0.0, 0.3], [0.4, 0.0, 0.3]])
    moves = program_moves(TaughtPath.of_poses(rows, speed_m_s=0.1, parent="base"))
    return Program(**{"name": "a", "moves": moves, "acceleration_m_s2": 0.5, "turn_rad_s": 1.0, **more})


def camera(width):
    return lambda: Camera(width=width, height=480, intrinsics=np.array([500.0, 500, 320, 240, *[0.0] * 6]))


def followed(*t_s):
    """Return a call that tracks a target over frames of these times."""

    def go():
        tracker = armsight.PoseTracker(read_rig(Path("rig.yaml")), read_target(Path("target.yaml")))
        views = [cv2.imread(f"{side}/frame0.png", cv2.IMREAD_GRAYSCALE) for side in ("left", "right")]
        return [tracker.update(*views, t_s=t) for t in t_s]

    return go


def listens(*, taken):
    """Return a call that listens at a port that another program holds, or at another one."""

    def go():
        with (
            socket.create_server(("127.0.0.1", 0)) as other,
            listening("127.0.0.1", other.getsockname()[1] if taken else 0),
        ):
            pass

    return go


def soft(compliance):
    """Return an arm whose joints give way under its links."""
    joints = tuple(replace(one, compliance=compliance, mass_kg=40.0, com_m=(0.3, 0.0, 0.0)) for one in IRB.joints)
    return replace(IRB, joints=joints)


TRIED = {
    ("api/tracker.py", "Give the times of the exposures"): (followed(1.0, 0.5), followed(0.5, 1.0)),
    ("armsight_lab/batch/cluster.py", "Give --jobs from 1"): (lambda: Workers(n=0), lambda: Workers(n=1)),
    ("armsight_lab/design/request.py", "Write for instance --mount"): (
        lambda: mount_of("0,0"),
        each(lambda: mount_of("0,0,0.1"), lambda: mount_of("0,0,0.1,0,90,0")),
    ),
    ("armsight_lab/cell_plan/run.py", "Write for instance --volume"): (
        lambda: _extent(((0.3, 0.3), (-0.2, 0.2), (0.1, 0.4))),
        lambda: _extent(((0.3, 0.6), (-0.2, 0.2), (0.1, 0.4))),
    ),
    ("ops/simulation/scenarios.py", "Known are: {}; or give"): (
        lambda: load_scenario("hand-cell"),
        lambda: load_scenario("webcam-cell"),
    ),
    ("kinematics/arm.py", "Check compliance"): (lambda: soft(5.0).sagged(AT), lambda: soft(1e-5).sagged(AT)),
    ("kinematics/rigid.py", "armsight convert arm FILE"): (
        lambda: urdf_text(soft(1e-5)),
        (lambda: write_arm(Path("soft.yaml"), soft(1e-5)), "convert arm soft.yaml --rigid -o rigid.yaml"),
    ),
    ("server/waiting.py", "Choose another port with --port"): (listens(taken=True), listens(taken=False)),
    ("armsight_lab/api/design.py", "Give (width, height) in px"): (lambda: _size((640,)), lambda: _size((640, 480))),
    ("armsight_lab/api/design.py", "Give (x, y, z) in m"): (
        lambda: _mount((1.0, 2.0)),
        each(lambda: _mount((0.0, 0.0, 0.1)), lambda: _mount((0.0, 0.0, 0.1, 0.0, 90.0, 0.0))),
    ),
    ("ops/arrays.py", "Give (width, height) in px"): (lambda: as_size((0, 480)), lambda: as_size((640, 480))),
    ("control/guard/plausible.py", "Write m (from mm"): (
        lambda: check_corners(Box(lower_m=[-900.0, 0, 0], upper_m=[900.0, 500, 500]), "forbidden"),
        lambda: check_corners(Box(lower_m=[-0.9, 0, 0], upper_m=[0.9, 0.5, 0.5]), "forbidden"),
    ),
    ("control/paths/exports.py", "the number of TOOL_DATA"): (lambda: krl(program()), lambda: krl(program(tool="1"))),
    ("control/paths/exports.py", "the name of the tooldata"): (
        lambda: rapid(program()),
        lambda: rapid(program(tool="torch")),
    ),
    ("control/paths/program.py", "500 mm/s^2 are 0.5"): (
        lambda: program(acceleration_m_s2=500.0),
        lambda: program(acceleration_m_s2=0.5),
    ),
    ("control/play/path_source.py", "0.5 (--override)"): (motion(50.0), motion(0.5)),
    ("control/play/shape.py", "Give metres, for instance"): (
        lambda: Weave.parse("sine:2:8"),
        lambda: Weave.parse("sine:0.002:0.008"),
    ),
    ("control/play/shape.py", "Give none, sine:"): (
        lambda: Weave.parse("sine"),
        each(lambda: Weave.parse("none"), lambda: Weave.parse("zigzag:0.002:0.008")),
    ),
    ("control/servo/law.py", "Give a delay of zero or more"): (
        lambda: delay_cycles(-0.1, 0.008),
        lambda: delay_cycles(0.1, 0.008),
    ),
    ("control/servo/law.py", "Give a gain up to"): (
        lambda: chosen_gain(50.0, 0.008, 0.1),
        lambda: chosen_gain(float(f"{chosen_gain(None, 0.008, 0.1).no_overshoot:.4g}"), 0.008, 0.1),
    ),
    ("control/servo/law.py", "Give metres, zero or more"): (
        lambda: on_axis(RigidTransform.identity(), -0.3),
        lambda: on_axis(RigidTransform.identity(), 0.3),
    ),
    ("drivers/images.py", "Say it, such as --bits 12"): (
        lambda: image_of_8_bits(DEEP, None, "a.png"),
        lambda: image_of_8_bits(DEEP, 12, "a.png"),
    ),
    ("drivers/images.py", "Give --bits {} or more"): (
        lambda: image_of_8_bits(DEEP, 10, "a.png"),
        lambda: image_of_8_bits(DEEP, 12, "a.png"),
    ),
    ("drivers/images.py", "Leave --bits away, or take"): (
        lambda: image_of_8_bits(LIGHT, 12, "a.png"),
        lambda: image_of_8_bits(LIGHT, None, "a.png"),
    ),
    ("drivers/images.py", "Leave --bits away"): (
        lambda: open_source("camera:0", reading=ImageReading(bits=12)),
        lambda: open_source("camera:0"),
    ),
    ("drivers/opening.py", "Leave --times away"): (
        lambda: open_source("camera:0", times_s=[0.0]),
        lambda: open_source("camera:0"),
    ),
    ("drivers/remote/wire.py", "Use wss://, and a server"): (
        lambda: ServerAddress(url="ws://cell.example:8767", token="t" * 20),
        lambda: ServerAddress(url="wss://cell.example:8767", token="t" * 20),
    ),
    ("kinematics/arm.py", "and leave rows without a reading out"): (
        lambda: IRB.fk([[0.1] * 6, [np.nan] * 6]),
        lambda: IRB.fk([[0.1] * 6]),
    ),
    ("kinematics/arm.py", "Give radians: the numbers look"): (
        lambda: IRB.fk([90.0, 0, 0, 0, 0, 0]),
        lambda: IRB.fk(np.radians([90.0, 0, 0, 0, 0, 0])),
    ),
    ("kinematics/joints.py", "Give a share of about one"): (coupled(57.3), coupled(1.0)),
    ("kinematics/numeric.py", "Give metres: the numbers"): (
        lambda: IRB.ik(RigidTransform.from_translation([300.0, 0.0, 400.0])),
        lambda: IRB.ik(RigidTransform.from_translation([0.3, 0.0, 0.4])),
    ),
    ("measure/settings.py", "Give seconds, or none"): (
        lambda: Pace(deadline_s=0.0),
        each(lambda: Pace(deadline_s=0.01), Pace),
    ),
    ("optics/camera.py", "Give the thickness in metres"): (
        lambda: Plate(thickness_m=1.0),
        lambda: Plate(thickness_m=0.001, index=1.5),
    ),
    ("optics/camera.py", "Give its size in px"): (camera(0), camera(640)),
    ("armsight_plant/options.py", "Give --mqtt-user"): (
        lambda: mqtt_options("mqtts://a.example/cell", ca=None, user="", password_file=Path("password")),
        lambda: mqtt_options("mqtts://a.example/cell", ca=None, user="me", password_file=Path("password")),
    ),
    ("records/checks.py", "Give [[R, t]"): (
        lambda: require_rigid("T", np.full((1, 4, 4), 2.0)),
        lambda: require_rigid("T", np.eye(4)[None]),
    ),
    ("records/measured.py", "such as 0.1**2"): (
        lambda: Spots.of_centres(np.zeros((3, 2)), np.array([0.1, 0.1])),
        lambda: Spots.of_centres(np.zeros((3, 2)), 0.1**2 * np.eye(2)),
    ),
    ("records/target.py", "Count the inner corners"): (
        lambda: board_target(TargetKind.CHECKERBOARD, 1, 6, 0.025),
        lambda: board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025),
    ),
    ("records/target.py", "Give (from, to) in degrees"): (
        lambda: Colour(hue_deg=(-20.0, 20.0)),
        lambda: Colour(hue_deg=(340.0, 20.0)),
    ),
    ("records/camera.py", "0.005 to 0.05"): (
        lambda: CameraTiming(readout_s=20.0),
        lambda: CameraTiming(readout_s=0.02),
    ),
    ("server/web_server.py", "Give both --tls-cert"): (
        lambda: check_options(ServeOptions(tls_cert=CERTIFICATE)),
        lambda: check_options(ServeOptions(tls_cert=CERTIFICATE, tls_key=KEY)),
    ),
    ("server/web_server.py", "or leave --bind away"): (
        lambda: check_options(ServeOptions(bind="192.0.2.1")),
        lambda: check_options(ServeOptions()),
    ),
}
