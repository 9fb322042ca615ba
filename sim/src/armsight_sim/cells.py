"""Makers of simulated cells; each cell states every number that was chosen.

Reached by name through the entry points `armsight.cells`; a maker takes (seed, frames) and may take more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight_sim.backdrops import make_occluders, make_room, stand_in_room
from armsight_sim.boards import Board, random_board_pose
from armsight_sim.camera import SimCamera
from armsight_sim.cell import (
    SEED_BACKDROP,
    SEED_BOARD,
    SEED_PATH,
    BoardCell,
    Cell,
    cameras_chosen,
    light_chosen,
    pipeline_chosen,
    room_chosen,
    sensor_chosen,
)
from armsight_sim.given import given_board_cell, given_cell
from armsight_sim.lens import zoomed_pair
from armsight_sim.pipeline import Pipeline
from armsight_sim.render import LightImage
from armsight_sim.rigs import SIDES, Pair, converging_webcams, parallel_pair
from armsight_sim.scenario_keys import RoomKeys, checked_pipeline, checked_room
from armsight_sim.scene import BLUR_PX, Event, Light, SmoothTrajectory, planned_events
from armsight_sim.sensor import Sensor, ambient, with_clutter, with_hot_pixels

PLACES, EYE_M = 40, 1.1
"""Moments at which it is asked where the target is, so that no furniture stands there; height of the cameras."""

TRIANGLE_M = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
"""Isosceles: A left, B lower right, C upper right as the cameras see it (MATH 3.2), so that z points away from them."""


ROOM, PIPELINE = "workshop", "webcam"
"""What stands behind the target and what the cameras do, where the caller does not say."""


Given: TypeAlias = Mapping[str, Any]
"""A cell that is given: `rig` and `target` as their files have them, `poses` in rig axes (x, y, z, quaternion)."""


LED_LEVEL = 190.0
"""Peak of a cell's lights, in grey levels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LedCellOptions:
    """What may be chosen about led_cell.

    The view stays the same for every width (the focal length follows). level, sigma_px, diameter_m: of the lights
    as in Light; a diameter makes them flat discs. faults: whether planned_events happen. zoom: zoom lenses before both
    cameras, at this value.
    """

    name: str = "led-cell"
    width: int = 1280
    height: int = 720
    fps: float = 60.0
    exposure_s: float = 0.004
    level: float = LED_LEVEL
    sigma_px: float = BLUR_PX
    diameter_m: float | None = None
    sensor: Sensor = field(default_factory=Sensor)
    hot_pixels: int = 12
    faults: bool = True
    zoom: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What stands behind the target, what the cameras do to a picture, and the seed of both."""

    seed: int
    keys: RoomKeys
    pipeline: Pipeline

    @property
    def bgr(self) -> tuple[float, ...]:
        """Channels of white light as the cameras take it: three behind a mosaic of colour filters, else one."""
        return (1.0, 1.0, 1.0) if self.pipeline.bayer else (1.0,)


def hand_cell(seed: int, frames: int, *, room: Any = ROOM, pipeline: Any = PIPELINE, zoom: float | None = None) -> Cell:
    """Return two 1280x720 webcams at 60 frames per second that watch three LEDs 0.8 m away; zoom as LedCellOptions."""
    return led_cell(seed, frames, LedCellOptions(name="hand-cell", zoom=zoom), room=room, pipeline=pipeline)


def led_cell(
    seed: int,
    frames: int,
    options: LedCellOptions | Mapping[str, Any] | None = None,
    *,
    room: Any = ROOM,
    pipeline: Any = PIPELINE,
    given: Given | None = None,
) -> Cell:
    """Return a cell of two converging webcams and three LEDs on an isosceles triangle.

    options: a record, or by name where the cell itself is reached by name. room, pipeline: by name or as in a
    scenario's keys. given: another rig and target, at poses; before ideal cameras and no room. Raises UsageError for
    less than one frame, a negative seed or an unknown room or pipeline.
    """
    around = _surroundings(seed, frames, room, pipeline)
    options = options if isinstance(options, LedCellOptions) else LedCellOptions(**(options or {}))
    if given is not None:
        facing = (0.0, 0.0, -1.0) if given["target"].get("diameter_m") else (0.0, 0.0, 0.0)
        like = Light(name="", xyz_m=(0.0, 0.0, 0.0), level=options.level, sigma_px=options.sigma_px, facing=facing)
        return given_cell(seed, given["rig"], given["target"], given["poses"][:frames], like)
    path = _in_a_hand(seed)
    lights = tuple(
        Light(name=key, xyz_m=xyz, level=options.level, sigma_px=options.sigma_px, diameter_m=options.diameter_m)
        for key, xyz in TRIANGLE_M.items()
    )
    places = _places(path(np.linspace(0.0, frames / options.fps, PLACES)), lights)
    cameras = _in_room(_webcams(options, around), around, places)
    target: dict[str, Any] = {"kind": "spots", "spots_m": {key: list(xyz) for key, xyz in TRIANGLE_M.items()}}
    if options.diameter_m is not None:
        target["diameter_m"] = options.diameter_m
    size = (options.width, options.height)
    events = planned_events(frames, tuple(TRIANGLE_M), size, options.sigma_px) if options.faults else ()
    return Cell(
        name=options.name,
        seed=seed,
        n_frames=frames,
        fps=options.fps,
        cameras=cameras,
        lights=lights,
        path=path,
        target=target,
        events=events,
        assumptions=_led_assumptions(options, around, cameras, events),
    )


def _led_assumptions(
    options: LedCellOptions, around: Surroundings, cameras: Mapping[str, SimCamera], events: Sequence[Event]
) -> tuple[str, ...]:
    """Return what was chosen about a cell of LEDs, a line each."""
    return (
        *cameras_chosen(cameras),
        "target: isosceles triangle of lights, A (-40, 0), B (30, 32), C (30, -32) mm; sides 77, 77, 64 mm",
        light_chosen(options.level, options.sigma_px, options.diameter_m),
        "path: sines of 140, 80, 60 mm about (60, 0, 800) mm and of 15, 15, 23 deg, periods 3.3 to 6.1 s, "
        "phases from the seed",
        f"time: {options.fps:g} frames per second, both shutters open together for {1e3 * options.exposure_s:g} ms, "
        "no jitter",
        sensor_chosen(options.sensor),
        room_chosen(around.keys, "9 grey levels with a slope of 5 across and -3 down"),
        f"{options.hot_pixels} hot pixels of 20 to 120 levels",
        pipeline_chosen(around.pipeline),
        *(f"fault in frames {e.first} to {e.last - 1}: {e.note}" for e in events),
    )


HALF_WIDTH_PX, AWAY_M = 7.1, 1.5
"""Width at half of its height of the beacon's image (sigma 3 px), and how far away it is: what its diameter_m says."""


def beacon_cell(
    seed: int,
    frames: int,
    *,
    width: int = 640,
    height: int = 480,
    clutter: int = 12,
    room: Any = ROOM,
    pipeline: Any = PIPELINE,
) -> Cell:
    """Return two parallel colour cameras (baseline of Kapucu 2005) that watch one red beacon before clutter."""
    around = _surroundings(seed, frames, room, pipeline)
    lights = (Light(name="A", xyz_m=(0.0, 0.0, 0.0), level=210.0, sigma_px=3.0, bgr=(0.05, 0.08, 1.0)),)
    path = _about(seed)
    focal_px = 750.0 * width / 640.0
    pair = parallel_pair(width, height, focal_px=focal_px, baseline_m=0.126)
    places = _places(path(np.linspace(0.0, frames / 25.0, PLACES)), lights)
    cameras = _in_room(_colour_cameras(pair, clutter, around), around, places)
    return Cell(
        name="beacon-cell",
        seed=seed,
        n_frames=frames,
        fps=25.0,
        cameras=cameras,
        lights=lights,
        path=path,
        target={
            "kind": "spots",
            "spots_m": {"A": [0.0, 0.0, 0.0]},
            "diameter_m": round(HALF_WIDTH_PX * AWAY_M / focal_px, 5),
            "colour": "red",
        },
        events=(),
        assumptions=_beacon_assumptions(around, cameras, clutter),
    )


def _beacon_assumptions(around: Surroundings, cameras: Mapping[str, SimCamera], clutter: int) -> tuple[str, ...]:
    """Return what was chosen about the cell of one beacon, a line each."""
    return (
        *cameras_chosen(cameras),
        "the baseline is Kapucu's, and the image size at the default width; all else is chosen",
        "beacon: red, 210 grey levels in R, 17 in G, 10 in B, Gaussian of sigma 3 px; 1.5 m away on sines of 350, "
        "250, 150 mm, periods 5 to 9 s, phases from the seed; the exposure is an instant",
        sensor_chosen(Sensor()),
        room_chosen(around.keys, f"30 grey levels, {clutter} soft coloured patches of 20 to 90 levels"),
        pipeline_chosen(around.pipeline),
    )


def _colour_cameras(pair: Pair, clutter: int, around: Surroundings) -> dict[str, SimCamera]:
    """Return colour cameras before patches of clutter, the same for both, or as yet before nothing."""
    dark, cameras = around.keys.dark, {}
    for side, (lens, pose) in pair.items():
        patches = np.random.default_rng([around.seed, SEED_BACKDROP])  # one stream: far behind, so both see the same
        level, across = (30.0, 10.0) if dark else (0.0, 0.0)
        plain = ambient(lens.width, lens.height, level, across=across, bgr=(0.9, 1.0, 0.8))
        backdrop = with_clutter(plain, clutter, (20.0, 90.0), patches) if dark else plain
        cameras[side] = SimCamera(
            lens=lens, T_world_camera=pose, sensor=Sensor(), backdrop=backdrop, pipeline=around.pipeline
        )
    return cameras


def board_cell(
    seed: int,
    frames: int,
    *,
    width: int = 1280,
    height: int = 720,
    printed: Board | Given | None = None,
    room: Any = ROOM,
    pipeline: Any = PIPELINE,
    zoom: float | None = None,
) -> BoardCell:
    """Return the cameras of hand_cell with a checkerboard before them, for calibrating them from images.

    frames: how many poses the board takes, further away the longer the lens. zoom: zoom lenses, at this value.
    printed: the board; or what is given with it: `rig`, `board` (columns, rows, square_m) and `poses`, before no room.
    Raises UsageError for less than one, or a board too large for the view.
    """
    around = _surroundings(seed, frames, room, pipeline)
    if isinstance(printed, Mapping):
        return given_board_cell(seed, printed["rig"], Board(**printed["board"]), printed["poses"][:frames])
    board = printed or Board()
    rng = np.random.default_rng([seed, SEED_BOARD])
    rig, reach = _lenses(width, height, zoom)
    lamps = ambient(width, height, 1.0, across=0.16, down=-0.10, bgr=around.bgr)
    cameras = {
        side: SimCamera(
            lens=lens, T_world_camera=pose, sensor=Sensor(), backdrop=lamps, pipeline=around.pipeline, grey=True
        )
        for side, (lens, pose) in rig.items()
    }
    poses = tuple(random_board_pose(board, rig, rng, reach) for _ in range(frames))
    return BoardCell(
        name="board-cell",
        seed=seed,
        fps=2.0,
        cameras=cameras,
        printed=board,
        poses=poses,
        behind=None if around.keys.dark else _behind(board, poses, cameras, around),
        assumptions=_board_assumptions(around, cameras, board),
    )


def _board_assumptions(around: Surroundings, cameras: Mapping[str, SimCamera], board: Board) -> tuple[str, ...]:
    """Return what was chosen about the cell of a board, a line each."""
    return (
        *cameras_chosen(cameras),
        f"board: {board.columns}x{board.rows} inner corners, squares of {1e3 * board.square_m:g} mm, flat, black "
        f"{board.black:g}, white {board.white:g} levels, lens blur sigma {board.blur_px:g} px",
        "poses: random within both views, 0.4 to 0.75 m away (times the zoom lens's magnification), tilted up to "
        "40 deg, turned up to 20 deg",
        sensor_chosen(Sensor()),
        "lamps: uneven by 16 % across and 10 % down",
        room_chosen(around.keys, f"{board.room:g} grey levels"),
        pipeline_chosen(around.pipeline),
    )


def _behind(
    board: Board, poses: Sequence[RigidTransform], cameras: Mapping[str, SimCamera], around: Surroundings
) -> dict[str, LightImage]:
    """Return what each camera sees of the room where the board at its poses does not hide it."""
    empty = {side: replace(camera, backdrop=np.zeros_like(camera.backdrop)) for side, camera in cameras.items()}
    corners = np.concatenate([pose.apply(board.corners_m()) for pose in poses])
    return {side: camera.backdrop for side, camera in _in_room(empty, around, corners).items()}


def _surroundings(seed: int, frames: int, room: Any, pipeline: Any) -> Surroundings:
    """Return room and pipeline as asked for; raise UsageError for a seed or a number of frames that cannot be."""
    if frames < 1:
        raise UsageError(f"a simulation of {frames} frames shows nothing", cure="Ask for one or more")
    if seed < 0:
        raise UsageError(f"the seed {seed} is negative", cure="Give 0 or more")
    return Surroundings(seed=seed, keys=checked_room(room), pipeline=checked_pipeline(pipeline))


def _in_a_hand(seed: int) -> SmoothTrajectory:
    """Return the path of hand_cell: slow swings 0.8 m in front of and between the cameras."""
    return SmoothTrajectory(
        centre_m=np.array([0.06, 0.0, 0.80]),
        tilt=Rotation.identity(),
        swing_m=np.array([0.14, 0.08, 0.06]),
        swing_rad=np.array([0.26, 0.26, 0.40]),
        period_s=np.array([4.1, 3.3, 5.7, 3.7, 4.7, 6.1]),
        phase_rad=np.random.default_rng([seed, SEED_PATH]).uniform(0.0, 2.0 * np.pi, 6),
    )


def _about(seed: int) -> SmoothTrajectory:
    """Return the path of beacon_cell, 1.5 m away."""
    return SmoothTrajectory(
        centre_m=np.array([0.063, 0.0, 1.5]),
        tilt=Rotation.identity(),
        swing_m=np.array([0.35, 0.25, 0.15]),
        swing_rad=np.zeros(3),
        period_s=np.array([7.0, 5.0, 9.0, 1.0, 1.0, 1.0]),
        phase_rad=np.random.default_rng([seed, SEED_PATH]).uniform(0.0, 2.0 * np.pi, 6),
    )


def _lenses(width: int, height: int, zoom: float | None) -> tuple[Pair, float]:
    """Return the converging webcams, with zoom lenses where a zoom is given; and how many times longer these are."""
    plain = converging_webcams(width, height)
    if zoom is None:
        return plain, 1.0
    pair = zoomed_pair(plain, zoom)
    return pair, pair["left"][0].focal_px[0] / plain["left"][0].focal_px[0]


def _webcams(options: LedCellOptions, around: Surroundings) -> dict[str, SimCamera]:
    """Return two converging webcams with hot pixels of their own, in a dim room or as yet before nothing."""
    cameras = {}
    level, across, down = (9.0, 5.0, -3.0) if around.keys.dark else (0.0, 0.0, 0.0)
    for side, (lens, pose) in _lenses(options.width, options.height, options.zoom)[0].items():
        rng = np.random.default_rng([around.seed, SEED_BACKDROP, SIDES.index(side)])
        plain = ambient(options.width, options.height, level, across=across, down=down, bgr=around.bgr)
        cameras[side] = SimCamera(
            lens=lens,
            T_world_camera=pose,
            sensor=options.sensor,
            backdrop=with_hot_pixels(plain, options.hot_pixels, (20.0, 120.0), rng),
            exposure_s=options.exposure_s,
            pipeline=around.pipeline,
            grey=True,
        )
    return cameras


def _places(poses: RigidTransform, lights: Sequence[Light]) -> Array:
    """Return the places (n, 3) of lights on a target at many poses."""
    spots = np.array([light.xyz_m for light in lights], dtype=np.float64)
    return np.concatenate([pose.apply(spots) for pose in poses])


def _in_room(cameras: Mapping[str, SimCamera], around: Surroundings, places_m: Array) -> dict[str, SimCamera]:
    """Return cameras in a room about the places (n, 3) of the target; the world's axes are the left camera's."""
    keys, seed = around.keys, around.seed
    occluders = make_occluders(keys.occluders, keys.white_level, seed)
    if keys.dark:
        return {side: replace(camera, occluders=occluders) for side, camera in cameras.items()}
    if keys.picture is not None:
        return stand_in_room(cameras, keys, RigidTransform.identity(), occluders)
    T_world_room = keys.T_world_room.pose() if keys.T_world_room else RigidTransform.identity()
    T_room_world = T_world_room.inv()
    room = make_room(keys, T_room_world.apply(places_m), seed, least_floor_m=EYE_M)
    return stand_in_room(cameras, room, T_room_world, occluders)
