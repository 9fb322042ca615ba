"""Cures of what cameras see of lights and boards: tips pivoted, targets measured, sweeps, noise, planes of glass."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from cures_of_cameras import NOISE
from cures_of_motions import identified
from cures_of_robots import SIM
from cures_of_runs import row
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras.preconditions import check_tilt
from armsight.calibrate.handeye.pairs import PosePairs
from armsight.calibrate.mirrors.calibration import _plate_used
from armsight.kinematics import preset

LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.03, 0.0], [0.03, -0.03, 0.0]])  # of target.yaml
TIP_M = np.array([0.0, 0.0, 0.05])
AROUND = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)


def turned(by_deg, sides=AROUND):
    """Return rotation vectors: by so much, towards each of the sides."""
    return [np.radians(by_deg) * np.array([np.cos(side), np.sin(side), 0.0]) for side in sides]


def pivoted(folder, turns):
    """Return a step that draws frames of target.yaml's lights, turned about TIP_M, before the cameras of rig.yaml."""

    def step():
        rng = np.random.default_rng(3)
        v, u = np.mgrid[:240, :320]
        for k, turn in enumerate(turns):
            X = Rotation.from_rotvec(turn).apply(LIGHTS - TIP_M) + np.array([0.05, 0.0, 0.6])
            for i, side in enumerate(("left", "right")):
                image = 12.0 + rng.normal(0.0, 1.0, (240, 320))
                for at in X - [0.1 * i, 0.0, 0.0]:
                    x, y = 400.0 * at[:2] / at[2] + [160.3, 119.6]
                    image += 150.0 * np.exp(-0.5 * ((u - x) ** 2 + (v - y) ** 2) / 1.8**2)
                Path(folder, side).mkdir(parents=True, exist_ok=True)
                cv2.imwrite(f"{folder}/{side}/{k:02}.png", np.clip(np.rint(image), 0, 255).astype(np.uint8))

    return step


def seen(folder):
    return f"--rig rig.yaml --left {folder}/left --right {folder}/right"


def poses(turns):
    """Return a table of poses of a tool that is turned about its end."""
    rows = "x_m,y_m,z_m,qx,qy,qz,qw\n"
    for turn in turns:
        R = Rotation.from_rotvec(turn)
        rows += row([*(np.array([0.4, 0.1, 0.3]) - R.apply([0.0, 0.0, 0.1])), *R.as_quat()])
    return rows


def slowly():
    """Write stills of which every 25th pixel is renewed in a frame."""
    Path("slow").mkdir()
    rng = np.random.default_rng(5)
    light = 15.0 + 180.0 * np.tile(np.linspace(0.0, 1.0, 320), (240, 1))
    image = light
    for k in range(100):
        new = light + rng.normal(size=light.shape) * np.sqrt(2.0 + light / 10.0)
        image = np.where(rng.random(light.shape) < 0.04, new, image)
        cv2.imwrite(f"slow/{k:03}.png", np.rint(image).astype(np.uint8))


def averaged():
    """Write stills that are means of two neighbours."""
    Path("mean").mkdir()
    rng = np.random.default_rng(5)
    light = 15.0 + 180.0 * np.tile(np.linspace(0.0, 1.0, 320), (240, 1))
    raw = [light + rng.normal(size=light.shape) * 3.0 * np.sqrt(2.0 + light / 10.0) for _ in range(13)]
    for k, (a, b) in enumerate(pairwise(raw)):
        cv2.imwrite(f"mean/{k:03}.png", np.rint(0.5 * (a + b)).astype(np.uint8))


def swept(home, *, px=False):
    """Return a sweep of three joints, the others at home(joint): places, or the pixels of rig.yaml 3 m before them."""
    arm, rows = preset("stanford-rrp"), "joint,q1,q2,q3,x_m,y_m,z_m\n"
    if px:
        rows = rows.replace("x_m,y_m,z_m", "left_u_px,left_v_px,right_u_px,right_v_px")
    rng = np.random.default_rng(0)
    for joint, (low, high) in enumerate([(0.0, 4.0), (0.5, 1.8), (0.6, 1.1)]):
        for value in np.linspace(low, high, 10):
            q = home(joint)
            q[joint] = value
            place = arm.fk(q)[:3, 3] + rng.normal(0.0, 2e-4, 3)
            if px:
                uv = [400.0 * (place[:2] - [0.1 * k, 0.0]) / (place[2] + 3.0) + [160.3, 119.6] for k in (0, 1)]
                place = np.concatenate(uv)
            rows += f"{joint + 1}," + row([*q, *place])
    return rows


def tilts(*vectors):
    return lambda: check_tilt(np.array([[0.0, 0.0, 0.5, *vector] for vector in vectors]), "the camera")


def pairs(covariance):
    T = RigidTransform.from_components(np.eye(4, 3), Rotation.from_rotvec(np.eye(4, 3)))
    C = np.tile(covariance, (4, 1, 1))
    return lambda: PosePairs(T_base_flange=T, T_camera_target=T, names=tuple("abcd"), camera_covariance=C)


LIMITS = ",".join(6 * ["0:1"])
LIVE = f"--live {SIM} --left camera:{SIM}:left --right camera:{SIM}:right --limits {LIMITS}"
IDENTIFY = "identify --sweep swept.csv -o a.yaml"
TOOLTIP = "calibrate tooltip -o t.yaml --poses"
PIVOT = "calibrate pivot --target target.yaml -o t.yaml"
LIT_TARGET = "calibrate target -o lights.yaml"
FILES = {
    "swept.csv": swept(lambda joint: [0.0, 1.5, 0.7 + 0.02 * joint]),
    "swept-px.csv": swept(lambda joint: [0.0, 1.5, 0.7], px=True),
    "swept-home.csv": swept(lambda joint: [0.0, 1.5, 0.7]),
    "hinge.csv": poses([[0.02 * k, 0.0, 0.0] for k in range(20)]),
    "tilted.csv": poses([*turned(20), *turned(24)]),
}
ALIKE = 1e-6 * np.eye(6)
STILL = 8 * [np.zeros(3)]

TRIED = {
    ("ops/calibration/pivot.py", "Rest the tool's end on one point"): (
        (pivoted("still", STILL), f"{PIVOT} {seen('still')}"),
        (pivoted("tipped", [*turned(20), *turned(25)]), f"{PIVOT} {seen('tipped')}"),
    ),
    ("calibrate/light_target/checks.py", "Record it anew, turned"): (
        (pivoted("still", STILL), f"{LIT_TARGET} {seen('still')}"),
        (pivoted("tipped", [*turned(20), *turned(40)]), f"{LIT_TARGET} {seen('tipped')}"),
    ),
    ("ops/calibrate_rig.py", "or --image with both views"): (
        f"{LIT_TARGET} --rig rig.yaml",
        (pivoted("tipped", [*turned(20), *turned(40)]), f"{LIT_TARGET} {seen('tipped')}"),
    ),
    ("calibrate/tooltip.py", "Tilt the tool by 20 degrees and more in at least two"): (
        f"{TOOLTIP} hinge.csv",
        f"{TOOLTIP} tilted.csv",
    ),
    ("calibrate/camera_noise/stills.py", "or use every n-th frame"): (
        (slowly, f"{NOISE.replace('stills', 'slow')} small.yaml"),
        f"{NOISE.replace('stills', 'slow')} small.yaml --every 20",
    ),
    ("calibrate/camera_noise/stationary.py", "or use every n-th frame"): (
        (averaged, f"{NOISE.replace('stills', 'mean')} small.yaml"),
        f"{NOISE.replace('stills', 'mean')} small.yaml --every 2",
    ),
    ("calibrate/cameras/preconditions.py", "Tilt the board by 20 to 40"): (
        tilts([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
        tilts([0.35, 0.0, 0.0], [-0.35, 0.0, 0.0], [0.0, 0.7, 0.0]),
    ),
    ("calibrate/handeye/pairs.py", "Give symmetric, positive 6 x 6"): (pairs(-ALIKE), pairs(ALIKE)),
    ("calibrate/mirrors/calibration.py", "or give --plate-mm"): (
        lambda: _plate_used(0.5, 0.001, None),
        lambda: _plate_used(0.5, 0.001, 0.003),
    ),
    ("calibrate/identify/identify.py", "or give exact values (--increments"): (
        f"{IDENTIFY} --increments order",
        f"{IDENTIFY} --increments known && {IDENTIFY.replace('swept', 'swept-home')} --increments order",
    ),
    ("ops/robot_inputs.py", "Give the rig that saw them"): (
        IDENTIFY.replace("swept", "swept-px"),
        f"{IDENTIFY.replace('swept', 'swept-px')} --rig rig.yaml",
    ),
    ("ops/identify.py", "Give --sweep; or --rig"): ("identify -o a.yaml", IDENTIFY),
    ("cli/identify.py", "Add --live ROBOT, or leave it out"): (f"{IDENTIFY} --speed 0.2", IDENTIFY),
    ("cli/identify.py", "Leave --sweep, --joints and"): (
        f"{IDENTIFY} {LIVE} --rig cell/rig.yaml --target cell/target.yaml",
        IDENTIFY,
    ),
    ("cli/identify.py", "Give --rig, --target, --limits, and"): (f"identify --live {SIM} -o a.yaml", identified),
}
