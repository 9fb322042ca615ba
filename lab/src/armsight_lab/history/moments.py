"""Moments as people give them, and as the history holds them: UTC."""

from __future__ import annotations

from datetime import UTC, datetime

from armsight.errors import UsageError

DAY_S = 86_400.0


def utc(moment: datetime) -> str:
    """Return a moment as the history holds it, so that texts sort as moments do."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def moment(given: str) -> datetime:
    """Return a moment in ISO 8601, UTC where it tells no zone. Raises UsageError."""
    try:
        found = datetime.fromisoformat(given)
    except ValueError:
        raise UsageError(
            f"{given[:40]!r} is no day or moment",
            consequence="Nothing was done",
            cure="Write 2026-11-26 or 2026-11-26T14:00, in UTC; of another zone 2026-11-26T14:00+01:00",
        ) from None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)


def whole_moment(given: str) -> str:
    """Return a moment as the history holds it. Raises UsageError."""
    return utc(moment(given))


def optional_moment(given: str | None) -> str | None:
    """Return a moment as the history holds it, None for none. Raises UsageError."""
    return None if given is None else whole_moment(given)


def day_of(held: str) -> float:
    """Return a moment of the history in days since 1970."""
    return datetime.fromisoformat(held).timestamp() / DAY_S
