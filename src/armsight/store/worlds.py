"""world.yaml: where a rig stands in the world, or at the robot's base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from scipy.spatial.transform import RigidTransform

from armsight.columns import POSE6
from armsight.errors import BadFile
from armsight.records import NamedCovariance, Saveable
from armsight.store.codec import CovarianceModel, Finite, PoseModel, covariance_mapping, named, pose_mapping, validated
from armsight.store.schema import Origin, read_document, write_document

WORLD_FORMAT = "armsight/world"


class WorldModel(Origin):
    """world.yaml: exactly one of T_world_rig and T_base_rig."""

    format: Literal["armsight/world"] = "armsight/world"
    T_world_rig: PoseModel | None = None
    T_base_rig: PoseModel | None = None
    covariance: CovarianceModel | None = None
    residual_rms_m: Finite | None = None
    n_used: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World(Saveable):
    """The rig's pose in its parent frame, 'world' or 'base'; covariance (6, 6) named POSE6, where known."""

    parent: str
    T_parent_rig: RigidTransform
    covariance: NamedCovariance | None = None
    residual_rms_m: float | None = None
    n_used: int | None = None


def world_from_mapping(content: Mapping[str, Any], where: str = "world") -> World:
    """Return what world.yaml's structure describes; BadFile, with the key, where it cannot be."""
    model = validated(WorldModel, content, where)
    if (model.T_world_rig is None) == (model.T_base_rig is None):
        raise BadFile(
            f"{where}: exactly one of T_world_rig and T_base_rig is wanted",
            consequence="The rig's place is not known",
            cure="Give the rig's pose in the frame that the results shall be in",
        )
    with named(where):
        covariance = model.covariance.covariance() if model.covariance else None
        if covariance is not None and covariance.names != POSE6:
            raise BadFile(f"the covariance's names are {covariance.names}, not {POSE6}")
        pose = model.T_world_rig or model.T_base_rig
        if pose is None:
            raise BadFile("no pose")
        return World(
            parent="base" if model.T_world_rig is None else "world",
            T_parent_rig=pose.pose(),
            covariance=covariance,
            residual_rms_m=model.residual_rms_m,
            n_used=model.n_used,
        )


def read_world(path: Path) -> World:
    """Return what a world.yaml says; BadFile where it is none."""
    return world_from_mapping(read_document(path, WORLD_FORMAT), str(path))


def write_world(path: Path, world: World, *, inputs: Sequence[Path] = ()) -> None:
    """Write world.yaml with the hashes of the files it was made from."""
    content = {
        f"T_{world.parent}_rig": pose_mapping(world.T_parent_rig),
        "covariance": covariance_mapping(world.covariance) if world.covariance else None,
        "residual_rms_m": world.residual_rms_m,
        "n_used": world.n_used,
    }
    write_document(path, WORLD_FORMAT, content, inputs)
