"""Printed boards: checkerboards, circle grids and ChArUco, found in an image and measured."""

from armsight.measure.boards.find import DETECTORS, find_board, find_two_boards, warm_up
from armsight.measure.boards.gridmap import same_way_up
from armsight.measure.boards.xcorner import xcorner_corners

__all__ = ["DETECTORS", "find_board", "find_two_boards", "same_way_up", "warm_up", "xcorner_corners"]
