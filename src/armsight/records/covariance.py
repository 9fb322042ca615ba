"""A covariance matrix whose rows have names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.records.checks import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedCovariance:
    """Covariance (n, n) of the named parameters, in the parameters' own units squared."""

    names: tuple[str, ...]
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "matrix", frozen_array("covariance", self.matrix, (n, n)))

    def std(self) -> dict[str, float]:
        """Return the standard deviation by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.matrix)).tolist(), strict=True))

    def block(self, names: tuple[str, ...]) -> NDArray[np.float64]:
        """Return the covariance of the given names in their order; KeyError for an unknown one."""
        index = [self._position(name) for name in names]
        return np.asarray(self.matrix[np.ix_(index, index)])

    def _position(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no covariance for {name!r}; there is one for {', '.join(self.names)}") from None
