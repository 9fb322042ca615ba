"""The exception tree is the one drawn in errors.py, and every branch has its exit code."""

from __future__ import annotations

import inspect
import pickle

import pytest

from armsight import errors

CLASSES = [c for _, c in inspect.getmembers(errors, inspect.isclass) if c.__module__ == errors.__name__]


def test_the_drawing_names_every_class() -> None:
    drawn = {line.split()[-1] if line.strip().endswith("Error") else line for line in errors.__doc__.splitlines()}
    text = "\n".join(drawn)
    assert all(cls.__name__ in text for cls in CLASSES)
    assert all(issubclass(cls, errors.ArmsightError) for cls in CLASSES)


@pytest.mark.parametrize(
    ("cls", "code"),
    [
        (errors.UsageError, 2),
        (errors.BadFile, 3),
        (errors.Ambiguous, 3),
        (errors.Degenerate, 3),
        (errors.DeviceLost, 4),
        (errors.Cancelled, 130),
    ],
)
def test_exit_codes_follow_the_branch(cls: type[errors.ArmsightError], code: int) -> None:
    assert cls.exit_code == code


def test_the_message_says_cause_consequence_and_cure() -> None:
    error = errors.BadFile("rig.yaml holds NaN", consequence="Nothing was measured", cure="Calibrate again.")
    assert str(error) == "rig.yaml holds NaN. Nothing was measured. Calibrate again."


def test_errors_cross_process_borders_whole() -> None:
    error = errors.Undetermined([("fx", "tz"), ("k1",)])
    twin = pickle.loads(pickle.dumps(error))
    assert type(twin) is errors.Undetermined
    assert twin.groups == (("fx", "tz"), ("k1",))
    assert str(twin) == str(error)
