"""Cures of cameras, links, servers and files as devices have them, some of them by stand-ins of a few lines."""

import asyncio
import socket
from datetime import UTC, datetime, timedelta
from importlib.metadata import requires
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import cv2
import numpy as np
from cryptography import x509
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cures_of_cameras import CAMERA, RECORD
from cures_of_motions import LIVE_EYES, moved
from cures_of_robots import KEY, SIM
from cures_of_runs import BOARD, CAMERAS, DESIGN, FIND

from armsight.app.live.measurement import LiveJob, require_kind
from armsight.cli.serve import _of_robot
from armsight.console.state import Console
from armsight.drivers import CameraSettings, TimedMoments
from armsight.drivers.aravis import AravisCamera, _layout_of, _Stamps
from armsight.drivers.rtde import link
from armsight.kinematics import preset
from armsight.measure.correspondence import PatchSettings, StereoViews, find_in_other_view
from armsight.ops.identification.live import Known, _ask, _modelled
from armsight.ops.robot.recorder import require_recorded
from armsight.ops.robot.run_motion import recorded_cameras
from armsight.optics import Camera
from armsight.optics.zoom import ZoomSetting
from armsight.records import Frame, JointReading, Silent
from armsight.records.motion import JointHistory
from armsight.store import read_rig, read_world
from armsight.store.recording import Recording, RecordingWriter
from armsight_plant.certificates import read_pair
from armsight_plant.foxglove import FoxglovePublisher
from armsight_plant.options import FoxgloveOptions
from armsight_sim.reproduce.stage import Stage

FILES: dict[str, str] = {}


def paired(max_skew_s):
    """Return a call that pairs frames of two cameras that come 40 ms apart."""

    class Came:
        total = None

        def __init__(self, name, late_s):
            self.name, self.late_s = name, late_s

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def __iter__(self):
            for k in range(100):
                yield Frame(image=np.zeros((4, 6), np.uint8), t_s=0.1 * k + self.late_s, sequence=k, source=self.name)

    def go():
        with TimedMoments(Came("left", 0.0), Came("right", 0.04), max_skew_s=max_skew_s) as pairs:
            return list(pairs)

    return go


def views(period_px):
    """Return what the cameras of rig.yaml see of a wall 1 m away: waves, that come again each so many px or never."""
    u = np.arange(-100.0, 420.0)
    rng = np.random.default_rng(4)
    rows = []
    for _ in range(240):
        wave = cv2.GaussianBlur(rng.normal(size=(1, len(u))), (0, 0), 2.0)[0]
        rows.append(wave)
    wall = np.array(rows)
    if period_px:
        wall = np.tile(wall[:, :period_px], (1, len(u) // period_px + 1))[:, : len(u)]
    wall = np.clip(128.0 + 150.0 * cv2.GaussianBlur(wall, (0, 0), 1.0), 0, 255).astype(np.uint8)
    return wall[:, 100:420], wall[:, 140:460]


def found(near_m, far_m, period_px=0):
    """Return a call that looks for a place of the left view in the right one."""

    def go():
        left, right = views(period_px)
        both = StereoViews(rig=read_rig(Path("rig.yaml")), left=left, right=right)
        return find_in_other_view(both, "left", np.array([200.0, 120.0]), PatchSettings(near_m=near_m, far_m=far_m))

    return go


def published(*, taken):
    """Return a call that publishes at a port that another program holds, or at another one."""

    def go():
        with socket.create_server(("127.0.0.1", 0)) as other:
            port = other.getsockname()[1] if taken else 0
            one = FoxglovePublisher(FoxgloveOptions(host="127.0.0.1", port=port), 1.0, print)

            async def run():
                await one.start()
                await one.stop()

            asyncio.run(run())

    return go


def joints_only():
    with RecordingWriter(Path("joints.mcap")) as writer:
        writer.joints(JointReading(q=np.zeros(6), t_s=0.0, sequence=0, source="log"))


def frames_of(name):
    with Recording(Path(name)) as recording:
        return list(recording.frames("left"))


def history(newest_s):
    """Return a call that asks for joints at 1 s of readings until a time."""

    def go():
        joints = JointHistory(0.01)
        for k in range(5):
            joints.add(JointReading(q=np.zeros(6), t_s=newest_s - 0.04 + 0.01 * k, sequence=k, source="log"))
        return joints.at(1.0)

    return go


def set_to(pixel_format):
    camera = SimpleNamespace(
        get_pixel_format_as_string=lambda: pixel_format,
        dup_available_pixel_formats_as_strings=lambda: ["Mono8", "Mono12"],
    )
    return lambda: _layout_of(camera, "camera:aravis:a")


def stage(frames, **bounds):
    made = Stage(out=Path("r"), seed=1, progress=Silent(), frames=frames)
    return lambda: made.simulate("webcam-cell", room="dark", **bounds)


def answers(yes):
    return lambda: _ask(SimpleNamespace(confirm=lambda question: yes), "Move?")


def linked(*, there):
    """Return a call that begins ur-rtde's process where it is installed; the extra that the cure names has it."""

    def go():
        assert [one for one in requires("armsight") or () if one.startswith("ur-rtde") and "rtde" in one.split(";")[1]]
        with patch.object(link, "_there", lambda name: there), patch.object(link, "MODULES", ("json",)):
            link.Worker("127.0.0.1", link.PORT, ()) if not there else link._there("json")

    return go


def controlled(mine):
    """Return a call of a camera that another program holds, or nobody else."""

    class Device:
        def is_controller(self):
            return mine

    camera = SimpleNamespace(get_device=Device)
    return lambda: AravisCamera("a")._require_control(SimpleNamespace(GvDevice=Device), camera)


def sent(rows):
    """Return a call that takes an image of so many of its four rows from a camera."""
    got = {"timestamp": 1, "frame_id": 1, "image_width": 6, "image_height": 4, "image_padding": (0, 0)}
    got["data"] = bytes(6 * rows)

    def go():
        camera = AravisCamera("a")
        camera._layout = "mono"
        buffer = SimpleNamespace(**{f"get_{name}": lambda value=value: value for name, value in got.items()})
        return camera._frame(buffer, _Stamps("a", 0.0), 1.0)

    return go


def unnamed():
    """Write a certificate of the pair's key that names no application."""
    secret = load_pem_private_key(KEY.read_bytes(), None)
    name, now = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "a")]), datetime.now(UTC)
    made = x509.CertificateBuilder(name, name, secret.public_key(), 7, now, now + timedelta(days=1))
    Path("bare.pem").write_bytes(made.sign(secret, SHA256()).public_bytes(Encoding.PEM))


def modelled(**known):
    arm = preset("ur10")
    known = Known(rig=read_rig(Path("cell/rig.yaml")), model=arm, **known)
    return _modelled(known, np.zeros(0), 0.1)


FISHEYE = Camera.fisheye(width=640, height=480, fx=300.0, fy=300.0, cx=320.0, cy=240.0)

EXPOSED = CameraSettings(exposure_s=0.01)

TRIED = {
    ("drivers/timed_moments.py", "Set both cameras to the same frame rate, or allow more with --max-skew"): (
        paired(0.01),
        paired(0.05),
    ),
    ("drivers/aravis.py", "Give --pixel-format with one of"): (set_to("Mono12"), set_to("Mono8")),
    ("drivers/aravis.py", "Stop the other program"): (controlled(mine=False), controlled(mine=True)),
    ("drivers/aravis.py", "Leave its pixel format and size"): (sent(rows=3), sent(rows=4)),
    ("drivers/rtde/link.py", "pip install"): (linked(there=False), linked(there=True)),
    ("measure/correspondence/find.py", "Widen the depths"): (found(1.02, 4.0), found(0.8, 4.0)),
    ("measure/correspondence/find.py", "Give the depths more narrowly"): (
        found(0.5, 4.0, period_px=30),
        found(0.8, 1.3, period_px=30),
    ),
    ("armsight_plant/foxglove.py", "Choose another port"): (published(taken=True), published(taken=False)),
    ("store/recording/reader.py", "Give a recording made by"): (
        (joints_only, lambda: frames_of("joints.mcap")),
        (RECORD, lambda: frames_of("a.mcap")),
    ),
    ("armsight_lab/history/database.py", "Check folder, permissions"): (
        f"{FIND} && history add w.yaml --cell a --history left/frame0.png/h.db",
        "history add w.yaml --cell a --history h.db",
    ),
    ("records/motion.py", "a constant lag belongs into --latency"): (history(0.5), history(1.0)),
    ("ops/identification/live.py", "Give --yes to move without"): (answers(False), answers(True)),
    ("app/live/measurement.py", "Give all cameras; or, for one"): (
        lambda: require_kind(LiveJob(cameras={"complex": "camera:0"}), read_rig(Path("rig.yaml"))),
        lambda: [
            require_kind(LiveJob(cameras={"left": "camera:0", "right": "camera:2"}), read_rig(Path("rig.yaml"))),
            require_kind(LiveJob(cameras={"complex": "camera:0"}), read_rig(Path("mirrors.yaml"))),
        ],
    ),
    ("ops/robot/recorder.py", "Make room, or name another disk"): (
        lambda: require_recorded("no space is left"),
        lambda: require_recorded(""),
    ),
    ("armsight_sim/reproduce/stage.py", "Give --frames {}, or leave it away"): (stage(9, most=3), stage(3, most=3)),
    ("armsight_sim/reproduce/stage.py", "Give --frames {} or more"): (stage(2, least=3), stage(3, least=3)),
    ("armsight_lab/design/volume.py", "Give more --cells, or"): (
        f"{DESIGN} {CAMERAS} {BOARD} --relative --cells 1",
        f"{DESIGN} {CAMERAS} {BOARD} --relative --cells 3",
    ),
    ("cli/serve.py", "Give --robot DRIVER:DEVICE"): ("serve --", lambda: _of_robot(SIM, None, None, None)),
    ("cli/serve.py", "Give --tokens FILE"): (
        "serve --add-token you:watch --",
        "serve --add-token you:watch --tokens tokens.yaml --",
    ),
    ("console/state.py", "Start with --robot"): (
        lambda: Console.of_folder(Path("cell")).require_robot(),
        lambda: Console.of_folder(Path("cell"), robot=object()).require_robot(),
    ),
    ("optics/zoom.py", "Calibrate a fisheye without --zoom"): (
        lambda: ZoomSetting(zoom=100.0, camera=FISHEYE),
        f"{CAMERA} --lens fisheye",
    ),
    ("armsight_plant/certificates.py", "Have one made with URI"): (
        (unnamed, lambda: read_pair(Path("bare.pem"), KEY)),
        ("serve --make-certificate made --", lambda: read_pair(*sorted(Path("made").iterdir()))),
    ),
    ("ops/identification/live.py", "Give --model and --world"): (
        modelled,
        lambda: modelled(world=read_world(Path("cell/world.yaml"))),
    ),
    ("ops/robot/run_motion.py", "Give them too: --left and --right"): (
        moved(camera_settings=EXPOSED),
        lambda: recorded_cameras(LIVE_EYES, EXPOSED, Path("moved")),
    ),
}
