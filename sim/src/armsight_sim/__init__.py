"""The synthetic world: renders what cameras see, from first principles, with everything that goes wrong."""

from armsight_sim.boards import Board, board_light, corner_rays, random_board_pose
from armsight_sim.camera import SimCamera
from armsight_sim.cell import BoardCell, Cell
from armsight_sim.cells import LedCellOptions, beacon_cell, board_cell, hand_cell, led_cell
from armsight_sim.lens import Lens
from armsight_sim.render import LightSource, Patch, PointSource, RegionSource, render_sources
from armsight_sim.scene import Event, Ghost, Light, Path, Rest, SmoothTrajectory
from armsight_sim.sensor import Sensor, ambient, with_clutter, with_hot_pixels

__all__ = [
    "Board",
    "BoardCell",
    "Cell",
    "Event",
    "Ghost",
    "LedCellOptions",
    "Lens",
    "Light",
    "LightSource",
    "Patch",
    "Path",
    "PointSource",
    "RegionSource",
    "Rest",
    "Sensor",
    "SimCamera",
    "SmoothTrajectory",
    "ambient",
    "beacon_cell",
    "board_cell",
    "board_light",
    "corner_rays",
    "hand_cell",
    "led_cell",
    "random_board_pose",
    "render_sources",
    "with_clutter",
    "with_hot_pixels",
]
