"""The check of a run's residuals as programs get it."""

from __future__ import annotations

import math

from armsight.app.schemas.measure import ConsistencyOutput, Estimated, OtherCause
from armsight.measure.consistency.check import advice, sentence
from armsight.measure.consistency.diagnosis import Consistency, Finding

LISTED = 4
"""Causes that are told in all."""


def consistency_output(found: Consistency) -> ConsistencyOutput:
    """Return the check as measure.json holds it; figures that there is no data for are None."""
    first = found.findings[0] if found.findings else None
    return ConsistencyOutput(
        verdict=found.verdict,
        cause=first.cause.key if first else None,
        estimate=first.size if first and first.cause.unit else None,
        std=first.std if first and first.cause.unit else None,
        unit=first.unit if first else None,
        effect_m=first.effect_m if first else None,
        effect_rad=first.effect_rad if first else None,
        since_s=first.since_s if first else None,
        equally_likely=[f.cause.key for f in found.findings[1 : found.equal]],
        others=[_other(f, found.findings[0]) for f in found.findings[1:LISTED]],
        components=_components(first) if first else {},
        chi2_per_dof=_number(found.chi2_per_dof),
        noise_scale=found.noise_scale,
        refused=found.refused,
        claimed_m=_number(found.claimed_m),
        n_frames=found.frames,
        undetected_m=dict(found.undetected),
        sentence=sentence(found),
        advice=advice(found),
    )


def _other(f: Finding, best: Finding) -> OtherCause:
    return OtherCause(
        cause=f.cause.key,
        estimate=f.size if f.cause.unit else None,
        std=f.std if f.cause.unit else None,
        unit=f.unit,
        effect_m=f.effect_m,
        log_odds=f.evidence - best.evidence,
    )


def _components(f: Finding) -> dict[str, Estimated]:
    deviations = f.covariance.diagonal().clip(min=0.0) ** 0.5
    rows = zip(f.cause.labels, f.estimate.tolist(), deviations.tolist(), strict=True)
    return {label: Estimated(estimate=value, std=std) for label, value, std in rows}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
