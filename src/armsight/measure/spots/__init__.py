"""Spots of light in an image: found, told apart, and measured with true covariances."""

from armsight.measure.settings import SpotSettings
from armsight.measure.spots.find import find_spots, track_spots, warm_up
from armsight.measure.spots.grey import TOUCHING

__all__ = ["TOUCHING", "SpotSettings", "find_spots", "track_spots", "warm_up"]
