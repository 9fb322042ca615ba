"""A path.csv from two pictures of a scene at rest and what a person picked in one of them."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.requests.files import PicksJob
from armsight.arrays import Array
from armsight.control.paths.along import along_edges, path_through_points
from armsight.drivers.images import read_image
from armsight.errors import Cancelled, DataRefused, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.measure.correspondence import Correspondence, StereoViews, find_in_other_view
from armsight.records import Progress
from armsight.records.output import Output, output
from armsight.records.result_parts import PointStd
from armsight.store.path_file import write_path
from armsight.store.picks_file import read_picks
from armsight.store.rigs import read_rig
from armsight.store.worlds import read_world

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


def path_from_picks(job: PicksJob, progress: Progress) -> PathPicksOutput:
    """Write the path through the places that were picked, in their order.

    Raises the first pick's own refusal, with how many there are, where one is not found and skip is not set;
    NotEnoughData where fewer than two are; UsageError, BadFile, BadImage, Inconsistent.
    """
    settings = job.settings  # refused before anything is read
    views = StereoViews(rig=read_rig(job.rig), left=read_image(job.left), right=read_image(job.right))
    picks = read_picks(job.picks)
    parent, T = _frame(job)
    axis = _axis(job, views, T)
    uv, rows = along_edges(picks.uv_px, picks.edges, job.step_px)
    found: list[tuple[int, Correspondence]] = []
    refused: list[tuple[int, Array, DataRefused]] = []
    for number, (px, row) in enumerate(zip(uv, rows, strict=True)):
        if progress.cancelled():
            raise Cancelled("stopped", consequence="No path is written")
        try:
            found.append((int(row), find_in_other_view(views, job.side, px, settings)))
        except DataRefused as error:
            refused.append((int(row), px, error))
        progress.update(number + 1, len(uv))
    if refused and (len(found) < 2 or not job.skip):
        raise _refusal(refused, len(uv))
    if len(found) < 2:
        raise NotEnoughData(
            f"{len(found)} of {len(uv)} places are found", consequence="They make no path", cure="Pick others"
        )
    path = path_through_points(T.apply(np.array([one.xyz_m for _, one in found])), axis, parent=parent)
    write_path(job.out, path)
    R = T.rotation.as_matrix()
    return PathPicksOutput(
        file=str(job.out),
        frame=parent,
        n=len(path),
        n_picks=len(picks.uv_px),
        length_m=float(path.length_m[-1]),
        points=[_point(row, one, xyz, R) for (row, one), xyz in zip(found, path.xyz_m, strict=True)],
        refused=[
            RefusedPickOutput(pick=row, u_px=px[0], v_px=px[1], kind=type(error).__name__, why=error.cause)
            for row, px, error in refused
        ],
    )


def _frame(job: PicksJob) -> tuple[str, RigidTransform]:
    if job.world is None:
        return "rig", RigidTransform.identity()
    world = read_world(job.world)
    return world.parent, world.T_parent_rig


def _axis(job: PicksJob, views: StereoViews, T: RigidTransform) -> Array:
    """Return the tool's z in the path's frame."""
    if job.tool_axis is None:
        if job.side not in ("left", "right"):
            raise UsageError(f"the view {job.side!r} is neither left nor right")
        return np.asarray((T * views.rig.T_rig_camera(job.side)).rotation.as_matrix()[:, 2])
    try:
        axis = np.array([float(part) for part in job.tool_axis.split(",")])
    except ValueError:
        axis = np.empty(0)
    if axis.shape != (3,) or not math.isfinite(float(np.sum(axis))):
        raise UsageError(f"{job.tool_axis[:40]!r} is no axis", cure="Give three numbers, for instance 0,0,-1")
    return axis


def _refusal(refused: list[tuple[int, Array, DataRefused]], total: int) -> DataRefused:
    """Return the first refusal, told for all."""
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
