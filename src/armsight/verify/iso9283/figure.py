"""One figure of the standard with its own standard deviation, or the reason why it is withheld; and all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from armsight.errors import UsageError

UNITS = {"m": "m", "rad": "rad", "m/s": "m_s", "s": "s", "1": "ratio"}
"""Units of figures, and how keys spell them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A figure: symbol and unit, where it holds, how many repeats it is of, and how many the standard asks for.

    value: by the standard's formula from the data as measured; None where withheld says why not. std: its standard
    deviation, from the repeats and from the measurement's covariance. corrected, corrected_std: what remains for the
    robot where the measurement's own scatter and the few repeats are taken out; None where that is not done. note: what
    else a reader should know.
    """

    symbol: str
    unit: str
    n: int
    wanted: int
    place: str = ""
    value: float | None = None
    std: float | None = None
    corrected: float | None = None
    corrected_std: float | None = None
    withheld: str | None = None
    note: str = ""

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise UsageError(f"the unit {self.unit!r} is not known", cure=f"Use one of: {', '.join(UNITS)}")
        if (self.value is None) == (self.withheld is None):
            raise UsageError(f"{self.symbol} needs either a value or the reason why it is withheld")

    @property
    def name(self) -> str:
        """Symbol and unit as one key: RP_m, AP_a_rad, AV_ratio."""
        return f"{self.symbol}_{UNITS[self.unit]}"

    @property
    def key(self) -> str:
        """The name, with the place behind it: 'RP_m P1'."""
        return f"{self.name} {self.place}".strip()

    @property
    def repeats(self) -> str:
        """How many repeats there were of how many wanted: '10 of 30'; '30' where there were enough."""
        return f"{self.n} of {self.wanted}" if self.n < self.wanted else f"{self.n}"

    def as_json(self) -> dict[str, float | int | str | None]:
        """Return value, n, wanted, withheld, std and what goes with them, as the contract spells them."""
        return {
            "value": self.value,
            "n": self.n,
            "wanted": self.wanted,
            "withheld": self.withheld,
            "std": self.std,
            "corrected": self.corrected,
            "corrected_std": self.corrected_std,
            "place": self.place,
            "note": self.note,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """All figures of a test, in the standard's order."""

    figures: tuple[Figure, ...]

    def __iter__(self) -> Iterator[Figure]:
        return iter(self.figures)

    def __len__(self) -> int:
        return len(self.figures)

    def __getitem__(self, key: str) -> Figure:
        """Return the figure of a key: 'RP_m P1', or 'RP_m' for the worst of all places; KeyError for another one."""
        for figure in self.figures:
            if figure.key == key:
                return figure
        worst = self.worst()
        if key in worst:
            return worst[key]
        raise KeyError(f"there is no figure {key!r}; there are {', '.join(figure.key for figure in self.figures)}")

    def worst(self) -> dict[str, Figure]:
        """Return by name the figure of the place at which it is largest in size.

        Where it is withheld everywhere, that of the place with the most repeats, whose reason says most.
        """
        groups: dict[str, list[Figure]] = {}
        for figure in self.figures:
            groups.setdefault(figure.name, []).append(figure)
        return {
            name: max(group, key=lambda one: (-1.0 if one.value is None else abs(one.value), one.n))
            for name, group in groups.items()
        }

    def as_json(self) -> dict[str, dict[str, float | int | str | None]]:
        """Return the worst of each figure by name and, where there are several places, each of them by key."""
        out = {name: figure.as_json() for name, figure in self.worst().items()}
        several = {name for name in out if sum(figure.name == name for figure in self.figures) > 1}
        out.update({figure.key: figure.as_json() for figure in self.figures if figure.name in several})
        return out


def withheld(figures: Iterable[tuple[str, str]], why: str, *, n: int, wanted: int, place: str = "") -> list[Figure]:
    """Return the figures of the given (symbol, unit), all withheld for one reason."""
    return [Figure(symbol=s, unit=u, n=n, wanted=wanted, place=place, withheld=why) for s, u in figures]


def too_few(what: str, n: int, needed: int, wanted: int) -> str:
    """Return the reason for withholding a figure of too few repeats."""
    return f"{n} of the {needed} {what} that are needed at least; ISO 9283 asks for {wanted}"


def noted(figure: Figure, note: str) -> Figure:
    """Return the figure with a note added."""
    return replace(figure, note="; ".join(part for part in (figure.note, note) if part))
