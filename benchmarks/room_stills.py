"""The stills of rooms/: our poses, OpenCV's blob detector, and the best a fixed threshold could do, side by side."""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.optics import Rig
from armsight.records import Frame
from armsight.store import read_rig, read_target
from bench import DATA, interleaved_ms, table
from verdicts import SIDES, Array, Verdict, blob_detector, judge, near, pose_error

ROOMS = DATA / "rooms"
REACH_PX = 1.0

THRESHOLDS = (90.0, 150.0)
"""Grey levels between which the anchor may choose, for every light the one that the truth likes better."""

WINDOW_PX = 14


@dataclass(frozen=True, eq=False)
class Still:
    """One pair with its truth: lights (2,) by (side, name)."""

    number: int
    pictures: dict[str, NDArray[np.uint8]]
    T: Array
    lights: dict[tuple[str, str], Array]
    camera: str

    def frames(self) -> tuple[Frame, Frame]:
        """Return the pictures as frames."""
        left, right = (
            Frame(image=self.pictures[side], t_s=0.0, sequence=0, source=f"{side}/{self.number:03d}") for side in SIDES
        )
        return left, right


def rows_of(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of rooms/."""
    with (ROOMS / name).open(newline="") as file:
        return list(csv.DictReader(file))


def read_stills() -> list[Still]:
    """Return all stills."""
    lights: dict[int, dict[tuple[str, str], Array]] = defaultdict(dict)
    for row in rows_of("truth_spots.csv"):
        if row["visible"] == "1":
            uv = np.array([float(row["u_disc_px"]), float(row["v_disc_px"])])
            lights[int(row["frame"])][row["camera"], row["spot"]] = uv
    cameras = {int(row["frame"]): row["camera"] for row in rows_of("truth_frames.csv")}
    out = []
    for row in rows_of("truth.csv"):
        n, T = int(row["frame"]), np.eye(4)
        T[:3, :3] = Rotation.from_quat([float(row[key]) for key in ("qx", "qy", "qz", "qw")]).as_matrix()
        T[:3, 3] = [float(row[key]) for key in ("x_m", "y_m", "z_m")]
        pictures = {side: read_picture(ROOMS / side, n) for side in SIDES}
        out.append(Still(number=n, pictures=pictures, T=T, lights=lights[n], camera=cameras[n]))
    return out


def read_picture(folder: Path, number: int) -> NDArray[np.uint8]:
    """Return one picture as it was written, grey or BGR."""
    path = next(folder.glob(f"{number:03d}.*"))
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.uint8)


def stills(repeats: int) -> None:
    """Print the table of all stills, its summary, and the anchor's."""
    if not ROOMS.exists():
        print("rooms: not here, skipped")
        return
    rig, target = read_rig(ROOMS / "rig.yaml"), read_target(ROOMS / "target.yaml")
    setup, blobs = Setup(rig, target), blob_detector()
    rows, verdicts, errors, anchors, blob_found, times = [], [], [], [], 0, []
    for still in read_stills():
        verdict = judge(setup, still.frames(), still.T, still.lights, reach_px=REACH_PX)
        ms = interleaved_ms(
            {
                "ours": lambda still=still: measured_or_not(setup, still),
                "blobs": lambda still=still: [blobs(still.pictures[side]) for side in SIDES],
            },
            repeats,
            warm_up=0,
        )
        at = {side: blobs(still.pictures[side]) for side in SIDES}
        n = sum(near(at[side], uv, REACH_PX) for (side, _), uv in still.lights.items())
        spots, T = anchor(rig, target.xyz_m, target.names, still)
        errors += [spots[key] - uv for key, uv in still.lights.items()]
        anchors.append(pose_error(T, still.T))
        verdicts.append(verdict)
        blob_found += n
        times.append({name: float(np.median(t)) for name, t in ms.items()})
        rows.append([*row_of(still, verdict, times[-1]["ours"]), n, sum(map(len, at.values())), times[-1]["blobs"]])
    head = ["still", "camera", "found of 6", "status", "mm", "deg", "chi2 / 6", "ms both", "wrong"]
    table("Stills in rooms", [*head, "blobs: found", "blobs", "blobs: ms both"], rows)
    summary(verdicts, times, blob_found, sum(len(still.lights) for still in read_stills()), errors, anchors)


def measured_or_not(setup: Setup, still: Still) -> object:
    """Run the product for its time; whatever it says."""
    try:
        return measure_pair(setup, *still.frames())
    except Exception as error:
        return error


def row_of(still: Still, verdict: Verdict, ms: float) -> list[object]:
    """Return our part of a still's row."""
    errors = [verdict.position_mm, verdict.orientation_deg, verdict.chi2 / 6.0] if verdict.ok else ["", "", ""]
    status = verdict.status if verdict.ok else f"{verdict.status}: {verdict.why}"
    wrong = "WRONG" if verdict.wrong else ""
    return [still.number, still.camera, len(verdict.found), status, *errors, round(ms), wrong]


def summary(
    verdicts: list[Verdict],
    times: list[dict[str, float]],
    blob_found: int,
    lights: int,
    errors: list[Array],
    anchors: list[Array],
) -> None:
    """Print ours, the blob detector and the anchor side by side."""
    ours = [v for v in verdicts if v.ok]
    spots = [s.error_px for v in ours for s in v.named]
    mm, deg = [v.position_mm for v in ours], [v.orientation_deg for v in ours]
    ms = {name: [t[name] / 2.0 for t in times] for name in times[0]}
    found = f"{sum(len(v.found) for v in verdicts)} of {lights}"
    wrong = sum(v.wrong for v in verdicts)
    d = np.array(anchors)
    rows = [
        ["armsight", found, rms(spots), len(ours), wrong, *middle(mm), *middle(deg), range_of(ms["ours"])],
        ["SimpleBlobDetector", f"{blob_found} of {lights}", "", "", "", *[""] * 6, range_of(ms["blobs"])],
        [
            "anchor: threshold chosen by the truth, centroid, names known, OpenCV's triangulation, Kabsch",
            f"{len(errors)} of {lights}",
            rms(errors),
            len(d),
            "",
            *middle(1e3 * np.linalg.norm(d[:, :3], axis=1)),
            *middle(np.rad2deg(np.linalg.norm(d[:, 3:], axis=1))),
            "",
        ],
    ]
    head = ["", "lights found", "px RMS per axis", "poses", "wrong", "mm median", "mm RMS", "mm max"]
    table("Stills in rooms, together", [*head, "deg median", "deg RMS", "deg max", "ms an image"], rows)


def rms(errors: list[Array]) -> str:
    """Return the root mean square per axis of errors (2,)."""
    return f"{np.sqrt(np.mean(np.square(errors))):.4f}" if errors else "-"


def middle(values: object) -> list[object]:
    """Return median, RMS and largest of some errors."""
    x = np.asarray(values, float)
    return [float(np.median(x)), float(np.sqrt(np.mean(x**2))), float(x.max())] if len(x) else ["-"] * 3


def range_of(ms: list[float]) -> str:
    """Return the median and the range of some times."""
    return f"{np.median(ms):.0f} ({min(ms):.0f}-{max(ms):.0f})"


def anchor(rig: Rig, model: Array, names: tuple[str, ...], still: Still) -> tuple[dict[tuple[str, str], Array], Array]:
    """Return centroids and pose of one who knows where the lights are, which is which and where to cut them off."""
    spots = {key: centroid(grey(still.pictures[key[0]]), uv) for key, uv in still.lights.items()}
    P, flat = [], []
    for side in SIDES:
        camera, T = rig.camera(side), rig.T_rig_camera(side).inv()
        P.append(np.hstack([T.rotation.as_matrix(), T.translation[:, None]]))
        uv = np.array([spots[side, name] for name in names])
        flat.append(cv2.undistortPoints(uv[:, None], camera.matrix, camera.distortion)[:, 0].T.copy())
    X = cv2.triangulatePoints(P[0], P[1], *flat)
    return spots, kabsch((X[:3] / X[3]).T, model)


def kabsch(points: Array, model: Array) -> Array:
    """Return T (4, 4) that takes the model (n, 3) to the points (n, 3)."""
    mean, origin = points.mean(axis=0), model.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - mean).T @ (model - origin))
    T = np.eye(4)
    T[:3, :3] = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    T[:3, 3] = mean - T[:3, :3] @ origin
    return T


def grey(picture: NDArray[np.uint8]) -> Array:
    """Return grey levels of a picture."""
    return (picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)).astype(float)


def centroid(image: Array, uv: Array) -> Array:
    """Return the centroid, by grey levels above a threshold, nearest to the truth that one of the thresholds gives."""
    y0, x0 = round(float(uv[1])) - WINDOW_PX, round(float(uv[0])) - WINDOW_PX
    part = image[y0 : y0 + 2 * WINDOW_PX + 1, x0 : x0 + 2 * WINDOW_PX + 1]
    y, x = np.mgrid[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]]
    best = np.full(2, np.inf)
    for threshold in THRESHOLDS:
        _, labels = cv2.connectedComponents((part > threshold).astype(np.uint8), connectivity=8)
        mine = labels[WINDOW_PX, WINDOW_PX]
        if mine:
            w = np.where(labels == mine, part - threshold, 0.0)
            at = np.array([(w * x).sum(), (w * y).sum()]) / w.sum()
            best = min(best, at, key=lambda p: float(np.linalg.norm(p - uv)))
    return best
