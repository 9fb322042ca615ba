"""How a test states which refusal it expects: by its class, its fields, and the names that a person has to find in it.

A name is what the data or the call bring along (a file, a flag, a joint, a row, a figure) or, where refusals of one
class are near each other, the word that tells them apart. It is never the sentence: tests/cures holds those.
"""

import re
from typing import TypeVar

import pytest

E = TypeVar("E", bound=Exception)


def refuses(kind: type[E] | tuple[type[E], ...], *names: object, **fields: object) -> pytest.RaisesExc[E]:
    """Return a context in which an error of exactly this class is raised, with these fields and names.

    A tuple stands for all names in it: a row of a table of refusals may hold one name or several.
    """
    kinds = kind if isinstance(kind, tuple) else (kind,)

    def check(error: E) -> bool:
        wrong = [] if type(error) in kinds else [f"it is {type(error).__name__}"]
        wrong += [f"it does not name {name}" for name in flat(names) if not names_it(error, name)]
        wrong += [f"its {key} is not {value}" for key, value in fields.items() if getattr(error, key) != value]
        if wrong:
            raise AssertionError(f"{error}\n{', '.join(wrong)}") from error
        return True

    return pytest.raises(kind, check=check)


def names_it(text: object, *names: object) -> bool:
    """Return whether a text holds all names as whole words: `5` is not in `15`, `5.2` or `x5`."""
    return all(
        re.search(rf"(?<!\w)(?<!\d\.){re.escape(str(name))}(?!\w|\.\d)", str(text)) is not None for name in flat(names)
    )


def flat(names: tuple[object, ...]) -> list[object]:
    """Return names, with those of tuples in their place."""
    return [one for name in names for one in (name if isinstance(name, tuple) else (name,))]
