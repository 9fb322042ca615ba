"""How much of something a second is let through, with a burst: a token bucket."""

from __future__ import annotations


class TokenBucket:
    """Holds burst tokens at most, and gets per_s of them a second. Times in s, of one clock that does not run back."""

    def __init__(self, per_s: float, burst: float, now_s: float) -> None:
        self._per_s, self._burst = per_s, burst
        self._tokens, self._filled_s = burst, now_s

    def pay(self, now_s: float, tokens: float = 1.0) -> bool:
        """Take tokens and return True; where there are too few take none."""
        self._tokens = min(self._burst, self._tokens + max(0.0, now_s - self._filled_s) * self._per_s)
        self._filled_s = now_s
        if self._tokens < tokens:
            return False
        self._tokens -= tokens
        return True
