"""How a guided calibration went so far, sample by sample: what a plot beside it shows."""

from __future__ import annotations

from dataclasses import dataclass, field

from armsight.app.guided.poses import PoseSamples
from armsight.app.guided.step import Charted, Figure, Guided
from armsight.units import DEG

Curves = dict[tuple[str, str], list[tuple[int, float]]]
"""By (name, unit) the points (number of samples, value), in their order."""


def figures_of(step: Guided) -> tuple[Figure, ...]:
    """Return a step's numbers of now: its own, or of a step that takes poses how far the target was turned."""
    if isinstance(step, Charted):
        return step.figures()
    if isinstance(step, PoseSamples) and len(step.samples) > 1:
        turned = step.turns()[0] / DEG
        return tuple(
            Figure(name=f"turned about axis {i + 1}, RMS", value=float(v), unit="deg") for i, v in enumerate(turned)
        )
    return ()


@dataclass(slots=True)
class History:
    """Numbers by the number of samples they rest on; samples dropped take theirs along."""

    _by_n: dict[int, tuple[Figure, ...]] = field(default_factory=dict)

    def remember(self, n: int, figures: tuple[Figure, ...]) -> None:
        """Take the figures of n samples, in place of what was known of n and more."""
        self._by_n = {k: kept for k, kept in self._by_n.items() if k < n}
        if figures:
            self._by_n[n] = figures

    def curves(self) -> Curves:
        """Return the curves so far."""
        out: Curves = {}
        for n, figures in sorted(self._by_n.items()):
            for figure in figures:
                out.setdefault((figure.name, figure.unit), []).append((n, figure.value))
        return out
