"""A point of a static scene picked in one view, found in the other along its epipolar line, and made 3-D."""

from armsight.measure.correspondence.find import Correspondence, PatchSettings, find_in_other_view
from armsight.measure.correspondence.refine import StereoViews

__all__ = ["Correspondence", "PatchSettings", "StereoViews", "find_in_other_view"]
