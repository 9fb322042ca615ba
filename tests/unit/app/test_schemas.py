"""Keys of results: described, left out or null as promised. Which they are is held by docs/schemas (test_json_docs)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import inf, nan
from pathlib import Path

import pytest
from pydantic import ValidationError

from armsight.app.schemas import files, handeye, measure
from armsight.app.schemas.base import Output, PointStd, absent
from armsight.app.schemas.catalogue import OUTPUTS


def models(base: type[Output] = Output) -> Iterator[type[Output]]:
    """Every model of the package."""
    for model in base.__subclasses__():
        if model.__module__.startswith("armsight."):
            yield model
            yield from models(model)


def test_the_model_of_every_command_is_looked_at() -> None:
    assert len(OUTPUTS) > 40 and set(OUTPUTS.values()) <= set(models())


@pytest.mark.parametrize("model", sorted(set(models()), key=lambda model: model.__name__), ids=lambda m: m.__name__)
def test_every_key_is_described_in_one_line(model: type[Output]) -> None:
    for name, field in model.model_fields.items():
        if field.exclude:  # an object beside the figures, in Python only
            continue
        assert field.description and field.description.endswith("."), name
        assert "\n" not in field.description and len(field.description) < 170, name
        # what has a default is left out where it is None, what has none is always there
        assert field.is_required() == (field.exclude_if is None), name
        assert field.is_required() or (field.default is None and field.exclude_if is absent), name


def test_a_key_that_does_not_apply_is_left_out_and_a_figure_without_data_is_null() -> None:
    known, unknown = handeye.NoisePart(value=1e-3, std=1e-4), handeye.NoisePart(value=None, at_most=2e-3)
    assert known.to_dict() == {"value": 1e-3, "std": 1e-4}
    assert unknown.to_dict() == {"value": None, "at_most": 2e-3}


def test_a_number_that_is_not_finite_becomes_null_in_text_only(tmp_path: Path) -> None:
    error = measure.TruthError(rms=nan, max=inf, claimed=1.0)
    assert error.to_dict()["max"] == inf
    assert json.loads(error.to_json()) == {"rms": None, "max": None, "claimed": 1.0}
    error.write(tmp_path / "out" / "error.json")
    assert json.loads((tmp_path / "out" / "error.json").read_text()) == {"rms": None, "max": None, "claimed": 1.0}


def test_words_of_python_are_no_obstacle_to_keys() -> None:
    done = files.ExportOutput(source="a.mcap", out="b", n={"times.csv": 3})
    assert done.to_dict() == {"from": "a.mcap", "out": "b", "n": {"times.csv": 3}}


def test_a_result_cannot_be_changed_and_takes_no_unknown_key() -> None:
    std = PointStd(x_m=1.0, y_m=2.0, z_m=3.0)
    assert std.translation_m == (1.0, 2.0, 3.0)
    with pytest.raises(ValidationError):
        std.x_m = 0.0  # type: ignore[misc]
    with pytest.raises(ValidationError):
        PointStd(x_m=1.0, y_m=2.0, z_m=3.0, w_m=4.0)  # type: ignore[call-arg]
