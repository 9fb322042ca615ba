"""Do lists, lenses and clocks of some cameras belong together? Asked before they are fitted, and of lenses after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.observations import Known, Observations
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.errors import Inconsistent, NotEnoughData
from armsight.optics import Camera
from armsight.optics.mounted import MOST_CAMERAS
from armsight.records import BoardView, NamedCovariance

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
    """Raise Inconsistent where images of one moment are seconds apart."""
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
