"""Whether two results are of one arm."""

from __future__ import annotations


def other_arm(a: str, b: str) -> bool:
    """Tell whether joints (R, P, ? each) are of two arms; '' is of none."""
    if not a or not b:
        return False
    return len(a) != len(b) or any("?" not in pair and pair[0] != pair[1] for pair in zip(a, b, strict=True))
