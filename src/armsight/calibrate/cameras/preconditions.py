"""Can these views calibrate a camera? Asked before solving, with cause and cure; and afterwards: can it be trusted?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy import float64
from numpy.typing import NDArray
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.kernels import matrices_of
from armsight.calibrate.cameras.observations import Known, Observations
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.optics import Camera
from armsight.optics.mounted import MOST_CAMERAS
from armsight.records import BoardView, NamedCovariance
from armsight.records.result_parts import Verdict

if TYPE_CHECKING:
    from armsight.calibrate.cameras.outlier_rejection import RobustFit

LEAST_VIEWS = 3
"""Two views fix the intrinsics without redundancy only; the third is what can contradict."""
ENOUGH_VIEWS = 8
LEAST_POINTS = 4
SAME_PLACE_PX = 1.0
"""Views whose points lie this close (RMS) show the same pose: a held board moves more between two shots."""
NEAR_MIDDLE_PX = 50.0
"""Views whose points' means differ by more are not compared point by point (they may show different parts)."""
LEAST_TILT_DEG = 5.0
"""Views whose normals all lie within this of each other leave the focal length to the noise."""
DOUBTFUL_TILT_DEG = 15.0
"""Where the fit fails and the starting poses, which take a lens's distortion for tilt, differ by less, that is why."""
ENOUGH_TILT_DEG = 20.0
COVERED = 0.5
"""Share of the image around which points lie from which the lens is called known: 70 % of its width and height."""
LEAST_SPREAD = 0.5
"""Points within less than half the image's width and half its height say nothing about the lens elsewhere."""
ENOUGH_SPREAD = 0.7


def different_views(observations: Observations) -> tuple[NDArray[np.intp], list[tuple[str, str]]]:
    """Return the positions of the views to use, and (source, why) of those with too few points or shown already.

    Raises NotEnoughData where fewer than LEAST_VIEWS are left.
    """
    kept: list[int] = []
    names = [" / ".join(sources) for sources in observations.sources]
    refused: list[tuple[str, str]] = []
    seen = observations.weight > 0.0  # (G, C, n)
    few = seen.sum(axis=2).min(axis=1)  # (G,)
    count = np.maximum(seen.sum(axis=(1, 2)), 1)[:, None]
    middle = (observations.uv * seen[..., None]).sum(axis=(1, 2)) / count  # (G, 2)
    close = np.linalg.norm(middle[:, None] - middle[None], axis=2) < NEAR_MIDDLE_PX
    for g in range(observations.n_views):
        if few[g] < LEAST_POINTS:
            refused.append((names[g], f"only {few[g]} points of the board are seen, {LEAST_POINTS} are needed"))
            continue
        near = np.flatnonzero(close[g, :g])
        twin = next((k for k in near.tolist() if k in kept and _same(observations, seen, g, k)), None)
        if twin is not None:
            refused.append((names[g], f"shows the board in the same place as {names[twin]}"))
        else:
            kept.append(g)
    if len(kept) < LEAST_VIEWS:
        raise NotEnoughData(
            f"{observations.n_views} views show the board in {len(kept)} different poses, {LEAST_VIEWS} are needed",
            consequence="Nothing was calibrated",
            cure="Take ten to twenty images, with the board tilted in different directions and all over the image",
        )
    return np.array(kept, dtype=np.intp), refused


def _same(observations: Observations, seen: NDArray[np.bool_], a: int, b: int) -> bool:
    """Tell whether two views show the board in the same position in every camera."""
    both = seen[a] & seen[b]
    if not both.any():
        return False
    distance = observations.uv[a][both] - observations.uv[b][both]
    return bool(np.sqrt((distance**2).sum(axis=1).mean()) < SAME_PLACE_PX)


def check_tilt(poses: Array, name: str, least_deg: float = LEAST_TILT_DEG) -> list[str]:
    """Return advice on how the board is tilted, from its poses (G, 6); raises Degenerate for no tilt.

    name: of the camera, for the message ("the left camera").
    """
    R = np.empty((len(poses), 3, 3))
    matrices_of(np.ascontiguousarray(poses[:, 3:]), R)
    normals = R[:, :, 2]  # (G, 3)
    between = np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)))
    if between.max() >= least_deg:
        if between.max() < ENOUGH_TILT_DEG:
            return [f"{name}: the board's tilt varies by {between.max():.0f} degrees only; tilt it by 20 to 40"]
        return []
    slant = float(np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0))).max())
    how = "is never tilted" if slant < least_deg else "is always tilted the same way"
    raise Degenerate(
        f"{name}: the board {how} (its directions differ by {between.max():.1f} degrees at most)",
        consequence="Focal length and distance cannot be told apart, and nothing was calibrated",
        cure="Tilt the board by 20 to 40 degrees, towards different sides",
    )


def check_spread(observations: Observations, c: int, name: str) -> list[str]:
    """Return advice on how the points of camera c cover its image; raises Degenerate for one part of it only."""
    uv = observations.uv[:, c][observations.weight[:, c] > 0.0]
    size = np.array(observations.sizes[c], float)
    low, high = uv.min(axis=0), uv.max(axis=0)
    share = (high - low) / size
    if (share < LEAST_SPREAD).all():
        u, v = (0.5 * (low + high)).tolist()
        raise Degenerate(
            f"{name}: the board is only seen around ({u:.0f}, {v:.0f}) px, over {100 * share[0]:.0f} % of the "
            f"image's width and {100 * share[1]:.0f} % of its height",
            consequence="The lens is unknown elsewhere, and nothing was calibrated",
            cure="Show the board all over the image, into its corners, and closer",
        )
    if share.min() < ENOUGH_SPREAD:
        return [
            f"{name}: the points cover {100 * share[0]:.0f} % of the image's width and {100 * share[1]:.0f} % of its "
            "height; outside them the lens is extrapolated"
        ]
    return []


def image_share(uv_px: NDArray[np.float64], width: int, height: int) -> float:
    """Return the share of an image that lies between points (n, 2): their convex hull."""
    if not len(uv_px):
        return 0.0
    return float(cv2.contourArea(cv2.convexHull(uv_px.astype(np.float32)))) / (width * height)


def check_count(n: int) -> list[str]:
    """Return advice on the number of views."""
    return [f"{n} views are few; {ENOUGH_VIEWS} to 20 in different poses make it sure"] if n < ENOUGH_VIEWS else []


OVERFITTED = 1.5
"""Left-out error over fitted error: above it the fit follows its own images more than the camera."""
MIN_USED = 0.7
"""Share of the images used, below which the set itself is in doubt."""
GOOD_RMS_PX = 0.6
"""Residual on images left out of the fit, beyond which boards, lenses or light are not as they should be."""


def images_doubted(
    n_used: int,
    n_images: int,
    rms_px: float,
    left_out_px: float | None,
    seen: Mapping[str, tuple[Camera, NDArray[float64]]],
    *,
    noun: str = "images",
    thing: str = "board",
) -> list[str]:
    """Return what speaks against relying on a calibration. seen: each camera with all points (n, 2) found in it, px."""
    out = []
    if n_used < MIN_USED * n_images:
        out.append(f"only {n_used} of {n_images} {noun} could be used")
    if left_out_px is not None and left_out_px > OVERFITTED * rms_px:
        out.append(f"{noun} left out of the fit are met {left_out_px / rms_px:.1f} times worse than those in it")
    if left_out_px is not None and left_out_px > GOOD_RMS_PX:
        out.append(f"{noun} left out of the fit are met to {left_out_px:.3g} px, beyond {GOOD_RMS_PX} px")
    for name, (camera, uv_px) in seen.items():
        share = image_share(uv_px, camera.width, camera.height) if len(uv_px) else 1.0
        if share < COVERED:
            out.append(f"the {thing} covered only {100 * share:.0f} % of the {name} image")
    return out


def images_verdict(
    found: str,
    doubts: Sequence[str],
    advice: Sequence[str],
    *,
    squares: bool,
    noun: str = "images",
    thing: str = "board",
) -> Verdict:
    """Return the verdict of a calibration. found: what fits how well; squares: whether the board's are in doubt."""
    if doubts:
        todo = f"Take more {noun}, with the {thing} tilted and up to the images' corners, and calibrate again."
        if squares:
            todo = (
                f"Measure the {thing} along both sides with a calliper; calibrate again with one whose squares are "
                "square, from images as the camera takes them."
            )
        said = f"{found}. But {'; '.join(doubts)}."
        return Verdict(level="care", headline="Usable with care", reasons=[said], next=[todo])
    todo = "Use it; calibrate again when focus, zoom or a mount has moved."
    if advice:
        todo = f"Use it; what would make it better: {'; '.join(advice)}."
    return Verdict(level="good", headline="Good", reasons=[f"{found}."], next=[todo])


OTHER_LENS = 1e-6
"""A lens known beforehand is another one where its own doubt would move it so far this often."""
APART_S = 1.0
"""Images of one moment are never further apart than this by clocks that agree."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownLens:
    """A lens calibrated before: its covariance is how far it may move, None holds it."""

    camera: Camera
    covariance: NamedCovariance | None = None


def require_lists(
    views: Mapping[str, Sequence[BoardView | None]],
    lenses: Mapping[str, KnownLens],
    times_s: Mapping[str, Sequence[float]] | None,
) -> None:
    """Raise Inconsistent where lists of images, lenses and times are not of the same cameras and moments, NotEnoughData
    where a camera never saw the board."""
    if not 1 < len(views) <= MOST_CAMERAS:
        raise Inconsistent(
            f"{len(views)} cameras are given", consequence="A rig of them has 2 to 8", cure="Give so many"
        )
    blind = [name for name, each in views.items() if all(one is None for one in each)]
    if blind:
        raise NotEnoughData(
            f"the board was found in no image of {', '.join(blind)}",
            consequence="Nothing was calibrated",
            cure="Focus that camera and light the board; show the board to it",
        )
    counts = {name: len(each) for name, each in views.items()}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{name} {n}" for name, n in counts.items())
        raise Inconsistent(
            f"the cameras have different numbers of images: {told}",
            consequence="Nobody knows which belong together",
            cure="Give one image of every camera for each moment, in the same order",
        )
    unknown = (set(lenses) | set(times_s or {})) - set(views)
    if unknown:
        raise Inconsistent(
            f"no camera is called {', '.join(sorted(unknown))}; there are {', '.join(views)}",
            consequence="Nothing was calibrated",
            cure="Use the names of --camera",
        )
    _require_apart(views)


def _require_apart(views: Mapping[str, Sequence[BoardView | None]]) -> None:
    """Raise Inconsistent where two cameras are one source: no two see a board at the very same pixels."""
    found = list(views.items())
    for i, (name, one) in enumerate(found):
        for other, two in found[i + 1 :]:
            both = [(a, b) for a, b in zip(one, two, strict=True) if a is not None and b is not None]
            if both and all(a.uv_px.shape == b.uv_px.shape and (a.uv_px == b.uv_px).all() for a, b in both):
                raise Inconsistent(
                    f"{name} and {other} show the board at the very same pixels in all {len(both)} common images",
                    consequence="They are one source by two names, and nothing was calibrated",
                    cure=f"Give {other} its own images",
                )


def require_sizes(observations: Observations, lenses: Mapping[str, KnownLens]) -> None:
    """Raise Inconsistent where a lens is of images of another size."""
    for name, size in zip(observations.cameras, observations.sizes, strict=True):
        if name in lenses and (lenses[name].camera.width, lenses[name].camera.height) != size:
            given = lenses[name].camera
            raise Inconsistent(
                f"the images of {name} are {size[0]}x{size[1]} px, the lens given for it {given.width}x{given.height}",
                consequence="The lens is another camera's, or was calibrated at another resolution",
                cure=f"Give the camera.yaml of {name} at {size[0]}x{size[1]} px, or leave it away",
            )


def require_one_clock(t_s: Array, seen: NDArray[np.bool_], names: tuple[str, ...]) -> None:
    """Raise Inconsistent where images of one moment are seconds apart, or a camera took two of them at one time."""
    for c, name in enumerate(names):
        at_s, often = np.unique(t_s[seen[:, c], c], return_counts=True)
        if (often > 1).any():
            raise Inconsistent(
                f"{(often > 1).sum()} times of {name} are of two images, the first {at_s[often > 1][0]:.6f} s",
                consequence="The board was not at two places at one time; nothing was calibrated",
                cure="Give each image once, with the time of its exposure",
            )
    for c, name in enumerate(names[1:], 1):
        # cameras that see nothing together are compared through the moments' usual time
        both = np.logical_and(seen[:, 0], seen[:, c])
        apart = t_s[:, c] - (t_s[:, 0] if both.any() else np.nanmedian(np.where(seen, t_s, np.nan), axis=1))
        off = float(np.median(apart[both if both.any() else seen[:, c]]))
        if abs(off) > APART_S:
            raise Inconsistent(
                f"by its clock the images of {name} are {off:+.1f} s from those of {names[0]} at the same moment",
                consequence="Either the clocks differ by seconds or the lists do not belong together",
                cure="Record all cameras on one computer, or give times on one clock; without times the board must be "
                "held still for every picture",
            )


def require_lenses(robust: RobustFit, known: Known | None, lenses: Mapping[str, KnownLens]) -> None:
    """Raise Inconsistent where a lens known beforehand had to move further than its own doubt allows."""
    if known is None:
        return
    for name in lenses:
        own = [i for i, one in enumerate(known.names) if one.startswith(f"{name}.")]
        if not own:
            continue
        off = np.array([robust.fit.value(known.names[i]) - known.mean[i] for i in own])
        chi2 = float(off @ known.information[np.ix_(own, own)] @ off)
        if chi2 > chdtri(len(own), OTHER_LENS):
            raise Inconsistent(
                f"the lens given for {name} does not fit its images: it would have to move by {np.sqrt(chi2):.0f} of "
                "its own standard deviations",
                consequence="It is another camera's, or focus or zoom have changed; nothing was calibrated",
                cure=f"Check which camera.yaml is that of {name}, or calibrate the lens again",
            )


def on_exact(names: str) -> list[str]:
    """Return what to know of lenses that are held: 0.1 % of a focal length moved a place by 3 of its deviations."""
    if not names:
        return []
    return [
        f"the lens of {names} is taken as exact: what it is off by is in no deviation; free it, or give its covariance"
    ]


def beforehand(lenses: Mapping[str, KnownLens]) -> tuple[frozenset[str], Known | None]:
    """Return which numbers of lenses known beforehand are held, and what is known of the others."""
    held, names, means, blocks = set[str](), list[str](), list[float](), list[Array]()
    for name, lens in lenses.items():
        every = lens.camera.names
        free = () if lens.covariance is None else tuple(one for one in every if one in lens.covariance.names)
        held |= {f"{name}.{one}" for one in every if one not in free}
        if free and lens.covariance is not None:
            names += [f"{name}.{one}" for one in free]
            means += [float(lens.camera.intrinsics[every.index(one)]) for one in free]
            # px beside pure numbers: scaled before it is inverted
            std = np.sqrt(np.diag(lens.covariance.block(free)))
            blocks.append(np.linalg.inv(lens.covariance.block(free) / np.outer(std, std)) / np.outer(std, std))
    if not names:
        return frozenset(held), None
    information, at = np.zeros((len(names), len(names))), 0
    for block in blocks:
        information[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return frozenset(held), Known(names=tuple(names), mean=np.array(means), information=information)
