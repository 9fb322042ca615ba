"""Draws docs/images/cell.svg: a simulated cell, what its cameras see, and what armsight says of it.

python tools/readme_picture.py
"""

from __future__ import annotations

import base64
import html
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import armsight
from armsight.kinematics import link_frames
from armsight.ops.simulation.run import simulate
from armsight.store import read_world

Array = NDArray[np.float64]
OUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "cell.svg"
WIDTH, HEIGHT = 1000, 470
FRAME = 0
"""Which of the scenario's frames is shown."""
EYE_M, LOOKED_AT_M, SCALE_PX = np.array([-2.6, -2.7, 1.5]), np.array([-1.02, -0.06, 0.34]), 1000.0
CROP = (330, 210)
STYLE = """
text{font:14px system-ui,sans-serif;fill:#24292f} .code{font:13px ui-monospace,monospace;white-space:pre}
.link{stroke:#57606a;stroke-width:13;stroke-linecap:round;fill:none} .joint{fill:#8b949e}
.camera{stroke:#0969da;stroke-width:2;fill:#ddf4ff;stroke-linejoin:round} .ray{stroke:#bf8700;stroke-width:1;
stroke-dasharray:4 4} .light{fill:#cf222e} .floor{stroke:#d0d7de;stroke-width:1} .small{font-size:12px;fill:#57606a}
"""


def main() -> None:
    """Simulate, measure, draw."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate("webcam-cell", folder, frames=FRAME + 1)
        arm, q = armsight.read_arm(folder / "arm_true.yaml"), armsight.read_joints(folder / "joints.csv")[1][FRAME]
        rig, target = armsight.read_rig(folder / "rig.yaml"), armsight.read_target(folder / "target.yaml")
        T_base_rig = read_world(folder / "world.yaml").T_parent_rig.as_matrix()
        images = [cv2.imread(str(folder / side / f"{FRAME:06d}.png")) for side in ("left", "right")]
    left, right = (np.asarray(image, np.uint8) for image in images)
    result = armsight.estimate_pose(left, right, rig, target)
    if result.T_rig_target is None:
        raise SystemExit(f"choose another frame: {result.why}")
    T_base_target = T_base_rig @ result.T_rig_target
    parts = ['<g clip-path="url(#cell)">', *floor(), *drawn_arm(link_frames(arm, q)[:, :3, 3])]
    lights = target.xyz_m @ T_base_target[:3, :3].T + T_base_target[:3, 3]
    for T_rig_camera, label in ((np.eye(4), "left"), (rig.T_rig_right.as_matrix(), "right")):
        parts += drawn_camera(T_base_rig @ T_rig_camera, lights, label)
    parts += [*drawn_target(T_base_target, lights), "</g>"]
    T_rig_target = result.T_rig_target
    seen_px = rig.project(target.xyz_m @ T_rig_target[:3, :3].T + T_rig_target[:3, 3])
    for n, (image, side) in enumerate(((left, "left"), (right, "right"))):
        parts += picture(image, armsight.find_spots(image).uv_px, np.asarray(seen_px[n]), target.names, n, side)
    parts += numbers(repr(result))
    body = "\n".join(parts)
    OUT.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">\n'
        "<title>Two webcams see three lights on a robot's flange; armsight tells where they are</title>\n"
        f'<style>{STYLE}</style>\n<clipPath id="cell"><rect width="620" height="{HEIGHT}"/></clipPath>\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="8" fill="#fff"/>\n{body}\n</svg>\n',
        encoding="utf-8",
    )


def on_paper(points_m: Array) -> Array:
    """Return where on the picture points (n, 3) of the base's axes are, (n, 2), in perspective."""
    ahead = LOOKED_AT_M - EYE_M
    ahead = ahead / np.linalg.norm(ahead)
    aside = np.cross(ahead, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    seen = (np.atleast_2d(points_m) - EYE_M) @ np.stack([aside, -np.cross(aside, ahead), ahead]).T
    return np.asarray(SCALE_PX * seen[:, :2] / seen[:, 2:] + (300.0, 250.0))


def line(points_m: Array, name: str) -> str:
    """Return a line through points."""
    way = " ".join(f"{u:.1f},{v:.1f}" for u, v in on_paper(points_m))
    return f'<polyline class="{name}" points="{way}" fill="none"/>'


def floor() -> list[str]:
    """Return a grid of half metres on the floor."""
    marks = np.arange(-2.0, 0.51, 0.5)
    lines = [line(np.array([[x, -1.0, 0.0], [x, 1.0, 0.0]]), "floor") for x in marks]
    return lines + [line(np.array([[-2.0, y, 0.0], [0.5, y, 0.0]]), "floor") for y in np.arange(-1.0, 1.01, 0.5)]


def drawn_arm(places_m: Array) -> list[str]:
    """Return links and joints of an arm whose frames are at places (n, 3)."""
    joints = [f'<circle class="joint" cx="{u:.1f}" cy="{v:.1f}" r="9"/>' for u, v in on_paper(places_m[:-1])]
    return [line(np.vstack([[0.0, 0.0, 0.0], places_m]), "link"), *joints]


def drawn_camera(T: Array, lights_m: Array, label: str) -> list[str]:
    """Return a camera as its field of view's corner, and its rays to the lights."""
    corners = 0.11 * np.array([[x, y, 1.0] for x, y in ((-0.67, -0.38), (0.67, -0.38), (0.67, 0.38), (-0.67, 0.38))])
    corners = corners @ T[:3, :3].T + T[:3, 3]
    sides = [line(np.array([T[:3, 3], a, b]), "camera") for a, b in zip(corners, np.roll(corners, 1, 0), strict=True)]
    u, v = on_paper(T[:3, 3])[0]
    text = f'<text class="small" x="{u - 14:.0f}" y="{v + (34 if label == "left" else -22):.0f}">{label}</text>'
    return [*(line(np.array([T[:3, 3], p]), "ray") for p in lights_m), *sides, text]


def drawn_target(T: Array, lights_m: Array) -> list[str]:
    """Return the target's axes and lights."""
    axes = [
        line(np.array([T[:3, 3], T[:3, 3] + 0.14 * T[:3, i]]), f'ray" style="stroke-dasharray:none;stroke-width:3;'
             f"stroke:{colour}")
        for i, colour in enumerate(("#cf222e", "#1a7f37", "#0969da"))
    ]  # fmt: skip
    return axes + [f'<circle class="light" cx="{u:.1f}" cy="{v:.1f}" r="4"/>' for u, v in on_paper(lights_m)]


def picture(
    image: NDArray[np.uint8], spots_px: Array, lights_px: Array, names: tuple[str, ...], n: int, side: str
) -> list[str]:
    """Return a camera's picture about the target: its lights by name, and what else was found."""
    w, h = CROP
    x, y = np.rint(lights_px.mean(axis=0) - [0.5 * w, 0.5 * h]).astype(int)
    _, data = cv2.imencode(".jpg", image[y : y + h, x : x + w], (cv2.IMWRITE_JPEG_QUALITY, 85))
    left, top = 640, 14 + n * 140
    scale = 200.0 / w
    coded = base64.b64encode(data.tobytes()).decode()
    parts = [
        f'<image x="{left}" y="{top}" width="{w * scale:.0f}" height="{h * scale:.0f}" '
        f'href="data:image/jpeg;base64,{coded}"/>'
    ]
    inside = spots_px[((spots_px > (x + 8, y + 8)) & (spots_px < (x + w - 8, y + h - 8))).all(axis=1)]
    for spot in inside:
        away = np.linalg.norm(lights_px - spot, axis=1)
        own = bool(away.min() < 2.0)
        u, v = (spot - (x, y)) * scale + (left, top)
        parts.append(
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="7" fill="none" stroke="{"#4ac26b" if own else "#9aa1a9"}" '
            f'stroke-width="{2 if own else 1}"/>'
        )
        if own:
            parts.append(
                f'<text x="{u + 9:.1f}" y="{v + 5:.1f}" style="fill:#4ac26b">{names[int(away.argmin())]}</text>'
            )
    rows = (f"{side} camera", f"{len(inside)} bright spots,", f"{len(names)} are the target's")
    return parts + [
        f'<text class="small" x="{left + 208}" y="{top + 14 + 18 * i}">{row}</text>' for i, row in enumerate(rows)
    ]


def numbers(told: str) -> list[str]:
    """Return what a result prints."""
    rows = told.splitlines()
    return [
        f'<text class="code" x="640" y="{320 + 20 * i}" xml:space="preserve">{html.escape(row)}</text>'
        for i, row in enumerate(rows)
    ]


if __name__ == "__main__":
    main()
