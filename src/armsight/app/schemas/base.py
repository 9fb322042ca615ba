"""What all results for programs share, and the small models that several of them hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from armsight.app.display import Row, as_html, as_text, flat_rows
from armsight.store.atomic import json_text, write_json


def absent(value: object) -> bool:
    """Return whether a key that may be left out is left out: `Field(None, exclude_if=absent, ...)`."""
    return value is None


class Output(BaseModel):
    """A result as programs get it: fixed keys, SI units, the unit in the key's name.

    A key without a default is always there, null where there is no data for it. A key with a default is left out of
    the JSON object where it does not apply.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain numbers, texts, lists and dictionaries, keys as in the JSON object."""
        return self.model_dump(mode="json", by_alias=True)

    def to_json(self) -> str:
        """Return it as strict JSON text in one line; a number that is not finite (no data) becomes null."""
        return json_text(self.to_dict(), indent=None)

    def write(self, path: Path) -> None:
        """Replace the file with it as JSON, in one step."""
        write_json(path, self.to_dict())

    def _shown(self) -> tuple[str, list[Row]]:
        return type(self).__name__, list(flat_rows(self.to_dict()))

    def __repr__(self) -> str:
        return as_text(*self._shown())

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return as_html(*self._shown())


class PoseOutput(Output):
    """The pose of one frame in another; the key says which: T_a_b is the pose of b in a."""

    xyz_m: tuple[float, float, float] = Field(description="Position, m, in the first frame's axes.")
    quat_xyzw: tuple[float, float, float, float] = Field(description="Orientation as a unit quaternion, scalar last.")


class PointStd(Output):
    """Standard deviations of a point."""

    x_m: float = Field(description="Of x, m.")
    y_m: float = Field(description="Of y, m.")
    z_m: float = Field(description="Of z, m.")

    @property
    def translation_m(self) -> tuple[float, float, float]:
        """Those of x, y and z in m."""
        return self.x_m, self.y_m, self.z_m


class PoseStd(PointStd):
    """Standard deviations of a pose: of its position, and of a small rotation about each axis."""

    rx_rad: float = Field(description="Of the rotation about x, rad.")
    ry_rad: float = Field(description="Of the rotation about y, rad.")
    rz_rad: float = Field(description="Of the rotation about z, rad.")

    @property
    def rotation_rad(self) -> tuple[float, float, float]:
        """Those about x, y and z in rad."""
        return self.rx_rad, self.ry_rad, self.rz_rad


class RejectedFile(Output):
    """An image that was left out."""

    file: str = Field(description="The image's file or source.")
    why: str = Field(description="Why it was left out, in words.")


class RejectedRow(Output):
    """A row that was left out."""

    row: int = Field(description="The row of the input table, from 1.")
    why: str = Field(description="Why it was left out, in words.")


class Refusal(Output):
    """Why a command gave no result."""

    kind: str = Field(description="The class of the error, one of `armsight.errors`.")
    cause: str = Field(description="What is wrong.")
    consequence: str = Field(description="What was not done; may be empty.")
    cure: str = Field(description="What the operator can do; may be empty.")
    exit_code: int = Field(description="The exit code of the command: 2 usage, 3 data, 4 device, 130 stopped, 1 else.")


class RefusalOutput(Output):
    """Any command, where it fails."""

    error: Refusal = Field(description="Why there is no result.")
