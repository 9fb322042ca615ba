"""What to do next, by the verdict of a measurement."""

from __future__ import annotations

from collections.abc import Mapping

MEASURE: Mapping[str, str] = {
    "Complete": "Use the poses with their standard deviations.",
    "With gaps": 'Use the full poses; mend what stands first under "What was lost" to get the others.',
    "No pose": 'Mend what stands first under "What was lost", and record again.',
    "Broken off": "Mend what ended the run, and measure the rest; the poses until then are kept.",
    "Claim doubted": "Do not rely on the claimed standard deviations: they are not the size of the errors here.",
    "Doubtful": "Do not rely on these poses before what is told is explained.",
    "Inconsistent": "Do not use these poses: mend what is told, and measure again.",
}


def after_measuring(word: str, unchecked: bool = False, advice: str = "") -> str:
    """Return the next step after a measurement. word: of its verdict; unchecked: the residuals could not be checked."""
    if word in ("Doubtful", "Inconsistent") and advice:
        return advice
    unproved = " Check a known length first: these frames did not check rig and target."
    return MEASURE[word] + (unproved if word == "Complete" and unchecked else "")
