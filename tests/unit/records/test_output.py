"""Keys of results: left out or null as promised. Which they are is held by docs/schemas (test_json_docs)."""

import json
from dataclasses import FrozenInstanceError
from math import inf, nan
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import Part, RejectedPair
from armsight.errors import BadFile
from armsight.fields import Doc
from armsight.ops.demo import TruthError
from armsight.records.output import Output, extended, figure, output
from armsight.records.result_parts import PointStd
from armsight.store.atomic import write_json
from armsight.store.codec import read_output
from refusals import refuses


def test_a_key_that_does_not_apply_is_left_out_and_a_figure_without_data_is_null() -> None:
    known, unknown = Part(size=1e-3, deviation=1e-4), Part(size=2e-3, deviation=inf)
    assert known.to_dict() == {"value": 1e-3, "std": 1e-4}
    assert unknown.to_dict() == {"value": None, "at_most": 2e-3}


def test_a_number_that_is_not_finite_becomes_null_in_text_only(tmp_path: Path) -> None:
    error = TruthError(rms=nan, max=inf, claimed=1.0)
    assert error.to_dict()["max"] == inf
    assert json.loads(error.to_json()) == {"rms": None, "max": None, "claimed": 1.0}
    write_json(tmp_path / "out" / "error.json", error.to_dict())
    assert json.loads((tmp_path / "out" / "error.json").read_text()) == {"rms": None, "max": None, "claimed": 1.0}


def test_a_result_cannot_be_changed_and_takes_no_unknown_key() -> None:
    std = PointStd(x_m=1.0, y_m=2.0, z_m=3.0)
    assert std.translation_m == (1.0, 2.0, 3.0)
    with pytest.raises(FrozenInstanceError):
        std.x_m = 0.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        PointStd(x_m=1.0, y_m=2.0, z_m=3.0, w_m=4.0)  # type: ignore[call-arg]


def test_numbers_of_any_kind_poses_and_arrays_become_what_json_knows_and_a_method_may_be_a_key() -> None:
    @output
    class Found(Output):
        """A result."""

        rms_m: Annotated[float, Doc("A whole number of Python.")]
        rows: Annotated[tuple[int, ...], Doc("Whole numbers.")]
        T_a_b: Annotated[RigidTransform, Doc("A pose.")]
        weights: Annotated[dict[str, NDArray[np.float64] | None], Doc("Arrays.")]
        hidden: int = 0

        @figure("Twice the error, m.")
        def double_m(self) -> float:
            return 2.0 * self.rms_m

        @figure("Left out.", optional=True)
        def nothing(self) -> float | None:
            return None

    pose = RigidTransform.from_translation([1.0, 2.0, 3.0])
    found = Found(rms_m=2, rows=(np.int64(3),), T_a_b=pose, weights={"a": np.ones(2), "b": None})  # type: ignore[arg-type]
    assert repr(found.to_dict()) == repr(
        {
            "rms_m": 2.0,
            "rows": [3],
            "T_a_b": {"xyz_m": [1.0, 2.0, 3.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
            "weights": {"a": [1.0, 1.0], "b": None},
            "double_m": 4.0,
        }
    )
    assert found == extended(found, Found) != extended(found, Found, rms_m=3.0)
    assert repr(extended(found, Found, rms_m=np.float64(0.5), rows=(np.int64(3),)).double_m) == "1.0"
    assert repr(extended(found, Found, rms_m=np.float64(0.5), rows=(np.int64(3),)).rows) == "(3,)"


def test_a_result_that_was_written_is_read_again() -> None:
    known = RejectedPair(row=3, name="row 3", why="it repeats row 1")
    assert read_output(RejectedPair, json.loads(known.to_json()), "a file") == known
    with refuses(BadFile, "rwo"):
        read_output(RejectedPair, {"rwo": 1, "name": "a", "why": "b"}, "a file")
