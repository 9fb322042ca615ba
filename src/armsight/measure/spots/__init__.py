"""Spots of light in an image: found, told apart, and measured with true covariances."""

from armsight.measure.settings import SpotSettings
from armsight.measure.spots.find import find_candidates, find_spots, track_spots, warm_up
from armsight.measure.spots.grey import CANDIDATE, FIT_S, SECOND_LOOK, TOUCHING, Candidates, Part

__all__ = [
    "CANDIDATE",
    "FIT_S",
    "SECOND_LOOK",
    "TOUCHING",
    "Candidates",
    "Part",
    "SpotSettings",
    "find_candidates",
    "find_spots",
    "track_spots",
    "warm_up",
]
