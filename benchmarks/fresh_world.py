"""A small world for planted faults: arms, trackers, cameras, boards and lights. It shares no code with the product."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray

# Arms, as a URDF says them: each joint at xyz, rpy of the one before, then turned about or moved along its axis.


@dataclass(frozen=True)
class Axis:
    """One joint: where it is in the link before, its axis, whether it slides, its limits."""

    xyz: tuple[float, float, float]
    axis: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slides: bool = False
    lower: float = -2.8
    upper: float = 2.8


@dataclass(frozen=True)
class Chain:
    """A serial arm, from base_link to its tool link."""

    joints: tuple[Axis, ...]
    tool_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tool_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zeros: tuple[float, ...] = ()

    def fk(self, q: Array) -> Array:
        """Return the tool in base (n, 4, 4) at readings q (n, joints)."""
        q = np.atleast_2d(q) + (np.array(self.zeros) if self.zeros else 0.0)
        T = np.tile(np.eye(4), (len(q), 1, 1))
        for k, joint in enumerate(self.joints):
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            move = np.tile(np.eye(4), (len(q), 1, 1))
            if joint.slides:
                move[:, :3, 3] = q[:, k, None] * axis
            else:
                move[:, :3, :3] = Rotation.from_rotvec(q[:, k, None] * axis).as_matrix()
            T = T @ pose(joint.xyz, fixed(joint.rpy)) @ move
        return T @ pose(self.tool_xyz, fixed(self.tool_rpy))

    def knocked(self, zeros: Mapping[int, float]) -> Chain:
        """Return the arm whose joint k (from 1) stands further than its reading, rad or m."""
        return replace(self, zeros=tuple(zeros.get(k + 1, 0.0) for k in range(len(self.joints))))

    def bent(self, rng: np.random.Generator, length_m: float, angle_rad: float) -> Chain:
        """Return the arm as built: each link's lengths and angles off by these standard deviations."""
        joints = [
            replace(
                j,
                xyz=tuple(np.array(j.xyz) + rng.normal(0, length_m, 3)),
                rpy=tuple(np.array(j.rpy) + rng.normal(0, angle_rad, 3)),
            )
            for j in self.joints
        ]
        return replace(self, joints=tuple(joints))

    def stretched(self, rng: np.random.Generator, length_m: float) -> Chain:
        """Return the arm whose lengths are off, no angle: what a joint's zero is stays beyond doubt."""

        def longer(xyz: Sequence[float]) -> tuple[float, ...]:
            return tuple(v + rng.normal(0, length_m) if v else 0.0 for v in xyz)

        return replace(self, joints=tuple(replace(j, xyz=longer(j.xyz)) for j in self.joints))

    def draw(self, rng: np.random.Generator, rows: int, share: float = 0.5) -> Array:
        """Return readings (rows, joints) over a share of each joint's range, about its middle."""
        middle = np.array([(j.lower + j.upper) / 2 for j in self.joints])
        half = np.array([(j.upper - j.lower) / 2 for j in self.joints])
        return middle + share * half * rng.uniform(-1, 1, (rows, len(self.joints)))

    def urdf(self, *, more: str = "", unit: float = 1.0, limit: float = 1.0, tip: str = "tool0") -> str:
        """Return the file. unit and limit: factors on lengths and on limits of turning joints, for files that err."""
        names = ["base_link", *(f"link{k + 1}" for k in range(len(self.joints)))]
        text = ['<robot name="own">', *(f'<link name="{name}"/>' for name in [*names, tip])]
        for k, j in enumerate(self.joints):
            kind, factor = ("prismatic", unit) if j.slides else ("revolute", limit)
            text += [
                f'<joint name="ax{k + 1}" type="{kind}"><parent link="{names[k]}"/><child link="{names[k + 1]}"/>',
                f'<origin xyz="{words(unit * np.array(j.xyz))}" rpy="{words(j.rpy)}"/><axis xyz="{words(j.axis)}"/>',
                f'<limit lower="{factor * j.lower}" upper="{factor * j.upper}" velocity="2" effort="90"/></joint>',
            ]
        text += [
            f'<joint name="to_tool" type="fixed"><parent link="{names[-1]}"/><child link="{tip}"/>',
            f'<origin xyz="{words(unit * np.array(self.tool_xyz))}" rpy="{words(self.tool_rpy)}"/></joint>',
        ]
        return "\n".join([*text, more, "</robot>"])


def fixed(rpy: Sequence[float]) -> Rotation:
    """Return the rotation of a URDF's roll, pitch, yaw."""
    return Rotation.from_euler("xyz", rpy)


def pose(xyz: object, turn: Rotation | None = None) -> Array:
    """Return a (4, 4) or (n, 4, 4) pose."""
    xyz = np.asarray(xyz, float)
    T = np.zeros((*xyz.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) if turn is None else turn.as_matrix()
    T[..., :3, 3], T[..., 3, 3] = xyz, 1.0
    return T


def words(values: object) -> str:
    return " ".join(f"{float(v):.12g}" for v in np.atleast_1d(np.asarray(values, float)))


HALF = np.pi / 2
ELBOW = Chain(
    (
        Axis((0, 0, 0.21), (0, 0, 1)),
        Axis((0.045, 0, 0.19), (0, 1, 0), lower=-1.4, upper=1.9),
        Axis((0, 0, 0.37), (0, 1, 0), lower=-2.4, upper=1.1),
        Axis((0.12, 0, 0.06), (1, 0, 0)),
        Axis((0.26, 0, 0), (0, 1, 0), lower=-1.9, upper=1.9),
        Axis((0.085, 0, 0), (1, 0, 0)),
    ),
    (0.02, 0, 0),
    (0, HALF, 0),
)
"""Six joints with a wrist in one point."""
SIDEWAYS = Chain(
    (
        Axis((0, 0, 0.155), (0, 0, 1)),
        Axis((0, 0.142, 0), (0, 1, 0), lower=-2.2, upper=0.4),
        Axis((0, -0.124, 0.447), (0, 1, 0), lower=-0.3, upper=2.5),
        Axis((0, 0, 0.402), (0, 1, 0), lower=-2.6, upper=0.9),
        Axis((0, 0.103, 0), (0, 0, 1), lower=0.4, upper=2.6),
        Axis((0, 0, 0.098), (0, 1, 0)),
    ),
    (0, 0.091, 0),
    (-HALF, 0, 0),
)
"""Six joints with three parallel axes."""
SEVEN = Chain(
    (
        Axis((0, 0, 0.16), (0, 0, 1)),
        Axis((0, 0, 0.18), (0, 1, 0), lower=-1.9, upper=1.9),
        Axis((0, 0, 0.21), (0, 0, 1)),
        Axis((0, 0, 0.19), (0, -1, 0), lower=-1.9, upper=1.9),
        Axis((0, 0, 0.2), (0, 0, 1)),
        Axis((0, 0, 0.2), (0, 1, 0), lower=-1.9, upper=1.9),
        Axis((0, 0, 0.08), (0, 0, 1)),
    ),
    (0, 0, 0.07),
)
GANTRY = Chain(
    (
        Axis((0.1, -0.3, 0.9), (1, 0, 0), slides=True, lower=0, upper=1.1),
        Axis((0, 0, 0.05), (0, 1, 0), slides=True, lower=0, upper=0.8),
        Axis((0, 0.07, 0), (0, 0, -1), slides=True, lower=0, upper=0.5),
        Axis((0, 0, -0.12), (0, 0, -1)),
    ),
    (0.06, 0, -0.05),
)
SCARA = Chain(
    (
        Axis((0, 0, 0.33), (0, 0, 1), lower=-2.2, upper=2.2),
        Axis((0.275, 0, 0.02), (0, 0, 1), lower=-2.3, upper=2.3),
        Axis((0.225, 0, 0), (0, 0, -1), slides=True, lower=0, upper=0.18),
        Axis((0, 0, 0), (0, 0, -1)),
    ),
    (0.0, 0.0, -0.03),
)

# Motions and readings.


def motion(middle: Sequence[float], reach: float, rng: np.random.Generator) -> Callable[[Array], Array]:
    """Return an irregular smooth motion, q (n, joints) of t_s (n,): four waves a joint, of 0.05 to 0.45 Hz."""
    centre = np.asarray(middle, float)
    hz, phase = rng.uniform(0.05, 0.45, (4, 1, len(centre))), rng.uniform(0, 2 * np.pi, (4, 1, len(centre)))
    return lambda t_s: centre + reach / 2 * np.sin(2 * np.pi * hz * np.asarray(t_s)[:, None] + phase).sum(axis=0)


def shaken(T: Array, rng: np.random.Generator, place_m: float, turn_rad: float = 0.0) -> Array:
    """Return measured poses: each with its own noise."""
    out = T.copy()
    out[:, :3, 3] += rng.normal(0, place_m, (len(T), 3))
    out[:, :3, :3] = Rotation.from_rotvec(rng.normal(0, turn_rad, (len(T), 3))).as_matrix() @ T[:, :3, :3]
    return out


def columns(T: Array, prefix: str = "", unit: float = 1.0) -> dict[str, Array]:
    """Return x_m .. qw of poses, under a prefix."""
    quat = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
    places = {f"{prefix}{a}_m": unit * T[:, i, 3] for i, a in enumerate("xyz")}
    return places | {f"{prefix}q{a}": quat[:, i] for i, a in enumerate("xyzw")}


def joints(q: Array, suffix: str = "", unit: float = 1.0) -> dict[str, Array]:
    return {f"q{k + 1}{suffix}": unit * q[:, k] for k in range(q.shape[1])}


def table(path: Path, data: Mapping[str, object], *, separator: str = ",", decimal: str = ".") -> Path:
    """Write columns by name; what is no number is written as it is, NaN as an empty cell."""

    def cell(value: object) -> str:
        if isinstance(value, str):
            return value
        number = float(value)  # type: ignore[arg-type]
        return "" if np.isnan(number) else f"{number:.10g}".replace(".", decimal)

    rows = zip(*data.values(), strict=True)  # type: ignore[call-overload]
    path.write_text("\n".join([separator.join(data), *(separator.join(map(cell, row)) for row in rows)]) + "\n")
    return path


# Cameras: x right, y down, z forward, in px.


@dataclass(frozen=True)
class Eye:
    """One camera; T_rig_camera is where it stands."""

    K: Array
    D: Array
    size: tuple[int, int]
    T: Array

    def see(self, points: Array) -> Array:
        """Return pixels (n, 2) of points (n, 3) in rig axes."""
        mine = (points - self.T[:3, 3]) @ self.T[:3, :3]
        return cv2.projectPoints(mine, np.zeros(3), np.zeros(3), self.K, self.D)[0][:, 0]

    def inside(self, uv: Array, rim: float = 6.0) -> Array:
        return ((uv > rim) & (uv < np.array(self.size) - 1 - rim)).all(axis=1)

    def yaml(self, indent: str = "    ", T: bool = True) -> str:
        """Return the keys of a camera of rig.yaml or camera.yaml."""
        K, quat = self.K, Rotation.from_matrix(self.T[:3, :3]).as_quat()
        lines = [f"width: {self.size[0]}", f"height: {self.size[1]}"]
        lines += [
            f"{n}: {v!r}"
            for n, v in zip(("fx", "fy", "cx", "cy"), map(float, K[[0, 1, 0, 1], [0, 1, 2, 2]]), strict=True)
        ]
        lines += [f"distortion: {[float(d) for d in self.D]}"]
        if T:
            xyz = [float(v) for v in self.T[:3, 3]]
            lines += [f"T_rig_camera: {{xyz_m: {xyz}, quat_xyzw: {[float(v) for v in quat]}}}"]
        return "\n".join(indent + line for line in lines)


def eye(focal: float, size: tuple[int, int] = (640, 480), T: Array | None = None, bend: float = 0.0) -> Eye:
    K = np.array([[focal, 0, size[0] / 2 + 3.7], [0, focal * 1.003, size[1] / 2 - 5.2], [0, 0, 1]])
    return Eye(K, np.array([bend, -0.4 * bend, 4e-4, -3e-4, 0.0]), size, np.eye(4) if T is None else T)


def pair(baseline: float = 0.16, focal: float = 720.0, bend: float = -0.12) -> tuple[Eye, Eye]:
    """Return two cameras beside each other, a little turned."""
    T = pose([baseline, 0.002, 0.004], Rotation.from_rotvec([0.004, -0.05, 0.006]))
    return eye(focal, bend=bend), eye(focal * 1.01, T=T, bend=bend * 0.9)


def rig_yaml(path: Path, eyes: tuple[Eye, Eye], more: str = "") -> Path:
    parts = [f"  {side}:\n{e.yaml()}" for side, e in zip(("left", "right"), eyes, strict=True)]
    path.write_text("\n".join(["format: armsight/rig", "version: 1", "kind: stereo", "cameras:", *parts, more]) + "\n")
    return path


def camera_yaml(path: Path, e: Eye) -> Path:
    path.write_text(f"format: armsight/camera\nversion: 1\n{e.yaml('', T=False)}\n")
    return path


def lights_yaml(path: Path, lights: Mapping[str, Sequence[float]]) -> Path:
    spots = ", ".join(f"{name}: [{', '.join(f'{v:.9g}' for v in xyz)}]" for name, xyz in lights.items())
    path.write_text(f"format: armsight/target\nversion: 1\nkind: spots\nspots_m: {{{spots}}}\n")
    return path


def world_yaml(path: Path, key: str, T: Array) -> Path:
    quat = [float(v) for v in Rotation.from_matrix(T[:3, :3]).as_quat()]
    xyz = [float(v) for v in T[:3, 3]]
    path.write_text(f"format: armsight/world\nversion: 1\n{key}: {{xyz_m: {xyz}, quat_xyzw: {quat}}}\n")
    return path


def light_picture(uv: Array, size: tuple[int, int], rng: np.random.Generator, sigma: float = 2.2) -> Array:
    """Return a dark picture (rows, columns) with one round light at each pixel, noise of 1.5 levels."""
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    out = np.full((size[1], size[0]), 12.0)
    for u, v in uv:
        out += 190.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * sigma**2))
    return np.clip(out + rng.normal(0, 1.5, out.shape), 0, 255).round().astype(np.uint8)


def board_picture(e: Eye, T_rig_board: Array, print_: Array, per_m: float, rng: np.random.Generator) -> Array:
    """Return what a camera sees of a flat print, whose pixel (0, 0) lies at the board's origin, per_m pixels a metre.

    Each of 3 x 3 rays a pixel is cut with the board's plane; what is beside the print is a grey wall.
    """
    width, height = e.size
    fine = np.mgrid[0 : 3 * height, 0 : 3 * width][::-1].reshape(2, -1).T / 3.0 - 1.0 / 3.0
    rays = cv2.undistortPoints(fine.astype(np.float64)[:, None], e.K, e.D)[:, 0]
    rays = np.c_[rays, np.ones(len(rays))] @ e.T[:3, :3].T
    normal, place = T_rig_board[:3, 2], T_rig_board[:3, 3] - e.T[:3, 3]
    hit = rays * ((place @ normal) / (rays @ normal))[:, None] - place
    xy = (hit @ T_rig_board[:3, :2] * per_m).astype(np.float32)
    maps = [xy[:, i].reshape(3 * height, 3 * width) for i in (0, 1)]
    seen = cv2.remap(print_, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=120)
    soft = cv2.GaussianBlur(cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    return np.clip(soft + rng.normal(0, 1.5, soft.shape), 0, 255).round().astype(np.uint8)
