"""A path from two pictures of a scene at rest and what a person picked in one of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.paths.along import path_through_points
from armsight.errors import Cancelled, DataRefused, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.measure.correspondence import Correspondence, PatchSettings, StereoViews, find_in_other_view
from armsight.records import Progress, TaughtPath
from armsight.records.output import Output, output
from armsight.records.result_parts import PointStd
from armsight.shown import Shown
from armsight.store.path_file import write_path
from armsight.store.rigs import World

TOLD = 3
"""Picks that a refusal tells."""


@output
class PickedPointOutput(Output):
    """A point of the path and how it was found."""

    pick: Annotated[int, Doc("The pick that it is, or that it follows on its edge; row of picks.csv from 0.")]
    px: Annotated[tuple[float, float], Doc("Its place in the picked view, px.")]
    other_px: Annotated[tuple[float, float], Doc("Its place in the other view, px.")]
    std_px: Annotated[float, Doc("Standard deviation of that place along the epipolar line, px.")]
    correlation: Annotated[float, Doc("Normalised correlation of both patches.")]
    second: Annotated[float, Doc("That of the best other place on the line; 0 for none.")]
    xyz_m: Annotated[tuple[float, float, float], Doc("The point in the path's frame, m.")]
    std: Annotated[PointStd, Doc("Its standard deviations, of pick and match; not of the rig or its place.")]


@output
class RefusedPickOutput(Output):
    """A place that was not found in the other view."""

    pick: Annotated[int, Doc("The pick, or the one before it on its edge; row of picks.csv from 0.")]
    u_px: Annotated[float, Doc("Its place in the picked view, px.")]
    v_px: Annotated[float, Doc("Its place in the picked view, px.")]
    kind: Annotated[str, Doc("The class of the refusal, one of `armsight.errors`.")]
    why: Annotated[str, Doc("Why it was not found, in words.")]


@output
class PathPicksOutput(Output):
    """armsight path from-picks."""

    file: Annotated[str, Doc("The path.csv written.")]
    frame: Annotated[str, Doc("The frame of the path: rig, or world or base with --world.")]
    n: Annotated[int, Doc("Rows written.")]
    n_picks: Annotated[int, Doc("Picks read.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    points: Annotated[list[PickedPointOutput], Doc("The points of the path.")]
    refused: Annotated[list[RefusedPickOutput], Doc("Places left out with --skip.")]
    taught: TaughtPath

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        for refused in self.refused:
            yield f"  pick {refused.pick} left out: {refused.why}"
        if self.frame == "rig":
            yield "The path is in the rig's own axes: no arm can take it so. Give --world for one in world or base."
        yield f"{self.n} points, {self.length_m:.4f} m, in {self.frame} axes: {self.file}"

    def write(self, path: Path) -> None:
        """Write path.csv."""
        write_path(path, self.taught)


Place = tuple[int, Array]
"""A row of picks.csv, and a place of it or on its edge, px."""
Found = list[tuple[int, Correspondence]]
Refused = list[tuple[int, Array, DataRefused]]


def find_places(
    places: Sequence[Place], views: StereoViews, side: str, settings: PatchSettings, skip: bool, progress: Progress
) -> tuple[Found, Refused]:
    """Return the places of one view that were found in the other one, and those that were not, with the reason.

    Raises the first refusal, with how many there are, where skip is not set; NotEnoughData where fewer than two are
    found.
    """
    found, refused = [], []
    for number, (row, px) in enumerate(places):
        if progress.cancelled():
            raise Cancelled("stopped", consequence="No path is written")
        try:
            found.append((row, find_in_other_view(views, side, px, settings)))
        except DataRefused as error:
            refused.append((row, px, error))
        progress.update(number + 1, len(places))
    if refused and (len(found) < 2 or not skip):
        raise _refusal(refused, len(places))
    if len(found) < 2:
        raise NotEnoughData(
            f"{len(found)} of {len(places)} places are found", consequence="They make no path", cure="Pick others"
        )
    return found, refused


def path_of_places(
    found: Found, refused: Refused, n_picks: int, stand: World, axis: Array, out: Path | None
) -> PathPicksOutput:
    """Return the path through places, in their order; stand: the rig's; axis: the tool's z in the path's frame."""
    T = stand.T_parent_rig
    path = path_through_points(T.apply(np.array([one.xyz_m for _, one in found])), axis, parent=stand.parent)
    R = T.rotation.as_matrix()
    return PathPicksOutput(
        file=str(out),
        frame=stand.parent,
        n=len(path),
        n_picks=n_picks,
        length_m=float(path.length_m[-1]),
        points=[_point(row, one, xyz, R) for (row, one), xyz in zip(found, path.xyz_m, strict=True)],
        refused=[
            RefusedPickOutput(pick=row, u_px=px[0], v_px=px[1], kind=type(error).__name__, why=error.cause)
            for row, px, error in refused
        ],
        taught=path,
    )


def axis_of(text: str | None, views: StereoViews, side: str, T: RigidTransform) -> Array:
    """Return the tool's z in the path's frame: as written, or the optical axis of a view. Raises UsageError."""
    if text is None:
        if side not in ("left", "right"):
            raise UsageError(f"the view {side!r} is neither left nor right")
        return np.asarray((T * views.rig.T_rig_camera(side)).rotation.as_matrix()[:, 2])
    try:
        axis = np.array([float(part) for part in text.split(",")])
    except ValueError:
        axis = np.empty(0)
    if axis.shape != (3,) or not math.isfinite(float(np.sum(axis))):
        raise UsageError(f"{text[:40]!r} is no axis", cure="Give three numbers, for instance 0,0,-1")
    return axis


def _refusal(refused: Refused, total: int) -> DataRefused:
    first = refused[0][2]
    causes = "; ".join(f"pick {k}: {error.cause}" for k, _, error in refused[:TOLD])
    more = f"; and {len(refused) - TOLD} more" if len(refused) > TOLD else ""
    return type(first)(
        f"{len(refused)} of {total} places are not found: {causes}{more}",
        consequence="No path is written",
        cure=f"{first.cure}; or leave them out with --skip" if first.cure else "Leave them out with --skip",
    )


def _point(row: int, one: Correspondence, xyz: Array, R: Array) -> PickedPointOutput:
    x, y, z = np.sqrt(np.diagonal(R @ one.covariance_m2 @ R.T))
    return PickedPointOutput(
        pick=row,
        px=(one.px[0], one.px[1]),
        other_px=(one.other_px[0], one.other_px[1]),
        std_px=one.std_px,
        correlation=one.correlation,
        second=one.second,
        xyz_m=(xyz[0], xyz[1], xyz[2]),
        std=PointStd(x_m=x, y_m=y, z_m=z),
    )
