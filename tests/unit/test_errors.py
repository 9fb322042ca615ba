"""The exception tree is the one drawn in errors.py, and every branch has its exit code."""

import inspect
import pickle
import re

from armsight import errors

CLASSES = [
    c
    for _, c in inspect.getmembers(errors, inspect.isclass)
    if c.__module__ == errors.__name__ and issubclass(c, BaseException)
]


def drawn() -> dict[str, tuple[str, int]]:
    """Parent and exit code of every class as errors.py draws them; a code stands for the branch below it."""
    parents: list[tuple[int, str, int]] = []
    found: dict[str, tuple[str, int]] = {}
    for line in (errors.__doc__ or "").splitlines():
        match = re.match(r"([│├└─ ]*)([A-Z]\w+)(?: +exit code (\d+))?", line)
        if match is None or match[2] not in {cls.__name__ for cls in CLASSES}:
            continue
        depth = len(match[1])
        parents = [row for row in parents if row[0] < depth]
        code = int(match[3]) if match[3] else parents[-1][2]
        found[match[2]] = (parents[-1][1] if parents else "Exception", code)
        parents.append((depth, match[2], code))
    return found


def test_the_drawing_is_the_tree() -> None:
    assert drawn() == {cls.__name__: (cls.__bases__[0].__name__, cls.exit_code) for cls in CLASSES}


def test_the_message_says_cause_consequence_and_cure() -> None:
    error = errors.BadFile("rig.yaml holds NaN", consequence="Nothing was measured", cure="Calibrate again.")
    assert str(error) == "rig.yaml holds NaN. Nothing was measured. Calibrate again."


def test_errors_cross_process_borders_whole() -> None:
    error = errors.Undetermined([("fx", "tz"), ("k1",)])
    twin = pickle.loads(pickle.dumps(error))
    assert type(twin) is errors.Undetermined
    assert twin.groups == (("fx", "tz"), ("k1",))
    assert str(twin) == str(error)
    blurred = pickle.loads(pickle.dumps(errors.BadImage("a.png: blurred", unseen=errors.Unseen.BLURRED)))
    assert blurred.unseen is errors.Unseen.BLURRED and errors.BadImage("dark").unseen is errors.Unseen.OTHER
