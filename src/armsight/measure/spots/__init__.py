"""Spots of light in an image: found, told apart, and measured with true covariances."""

from armsight.measure.settings import SpotSettings
from armsight.measure.spots.find import find_spots, track_spots, warm_up

__all__ = ["SpotSettings", "find_spots", "track_spots", "warm_up"]
