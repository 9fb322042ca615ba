"""world.yaml: where a rig stands in the world, or at the robot's base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from scipy.spatial.transform import RigidTransform

from armsight.columns import POSE6
from armsight.errors import BadFile
from armsight.records import NamedCovariance, Saveable
from armsight.store.codec import CovarianceModel, Finite, PoseModel, covariance_mapping, pose_mapping
from armsight.store.schema import Kind, Origin


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


def _world(model: WorldModel) -> World:
    if (model.T_world_rig is None) == (model.T_base_rig is None):
        raise BadFile(
            "exactly one of T_world_rig and T_base_rig is wanted",
            consequence="The rig's place is not known",
            cure="Give the rig's pose in the frame that the results shall be in",
        )
    covariance = model.covariance.covariance() if model.covariance else None
    if covariance is not None and covariance.names != POSE6:
        raise BadFile(f"the covariance's names are {covariance.names}, not {POSE6}")
    parent, pose = ("base", model.T_base_rig) if model.T_world_rig is None else ("world", model.T_world_rig)
    return World(
        parent=parent,
        T_parent_rig=pose.pose(),  # type: ignore[union-attr]  # one of them is there
        covariance=covariance,
        residual_rms_m=model.residual_rms_m,
        n_used=model.n_used,
    )


def _content(world: World) -> dict[str, Any]:
    return {
        f"T_{world.parent}_rig": pose_mapping(world.T_parent_rig),
        "covariance": covariance_mapping(world.covariance) if world.covariance else None,
        "residual_rms_m": world.residual_rms_m,
        "n_used": world.n_used,
    }


WORLD_YAML = Kind(name="world", model=WorldModel, record=_world, content=_content)
world_from_mapping, read_world, write_world = WORLD_YAML.parse, WORLD_YAML.read, WORLD_YAML.write
