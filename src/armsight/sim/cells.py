"""Makers of simulated cells; each cell states every number that was chosen.

Reached by name through the entry points `armsight.cells`; a maker takes (seed, frames) and may take more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.sim.backdrops import make_occluders, make_room, stand_in_room
from armsight.sim.boards import Board, random_board_pose
from armsight.sim.camera import SimCamera
from armsight.sim.cell import SEED_BACKDROP, SEED_BOARD, SEED_PATH, BoardCell, Cell
from armsight.sim.faults import planned_events
from armsight.sim.pipeline import IDEAL, Pipeline
from armsight.sim.rigs import SIDES, converging_webcams, parallel_pair
from armsight.sim.room_schema import RoomKeys, checked_pipeline, checked_room
from armsight.sim.scene import Light, SmoothTrajectory
from armsight.sim.sensor import Sensor, ambient, with_clutter, with_hot_pixels

Array = NDArray[np.float64]

PLACES, EYE_M = 40, 1.1
"""Moments at which it is asked where the target is, so that no furniture stands there; height of the cameras."""

TRIANGLE_M = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
"""Isosceles: A left, B lower right, C upper right as the cameras see it (MATH 3.2), so that z points away from them."""


ROOM, PIPELINE = "workshop", "webcam"
"""What stands behind the target and what the cameras do, where the caller does not say."""


def hand_cell(seed: int, frames: int, *, room: Any = ROOM, pipeline: Any = PIPELINE) -> Cell:
    """Return two 1280x720 webcams at 60 frames per second that watch three LEDs 0.8 m away."""
    return led_cell(seed, frames, name="hand-cell", room=room, pipeline=pipeline)


def led_cell(
    seed: int,
    frames: int,
    *,
    name: str = "led-cell",
    width: int = 1280,
    height: int = 720,
    fps: float = 60.0,
    exposure_s: float = 0.004,
    level: float = 190.0,
    sigma_px: float = 2.0,
    diameter_m: float | None = None,
    sensor: Sensor | None = None,
    hot_pixels: int = 12,
    faults: bool = True,
    room: Any = ROOM,
    pipeline: Any = PIPELINE,
) -> Cell:
    """Return a cell of two converging webcams and three LEDs on an isosceles triangle.

    The view stays the same for every width (the focal length follows). level, sigma_px, diameter_m: of the lights
    as in Light; a diameter makes them flat discs. faults: whether planned_events happen. room, pipeline: by name or
    as in a scenario's keys. Raises UsageError for less than one frame, a negative seed or an unknown room or pipeline.
    """
    _check(seed, frames)
    sensor = sensor or Sensor()
    keys, camera_pipeline = checked_room(room), checked_pipeline(pipeline)
    path = _in_a_hand(seed)
    lights = tuple(
        Light(name=key, xyz_m=xyz, level=level, sigma_px=sigma_px, diameter_m=diameter_m)
        for key, xyz in TRIANGLE_M.items()
    )
    webcams = _webcams(seed, width, height, exposure_s, sensor, hot_pixels, keys, camera_pipeline)
    places = path(np.linspace(0.0, frames / fps, PLACES))
    cameras = _in_room(webcams, keys, _places(places, lights), seed)
    target: dict[str, Any] = {"kind": "spots", "spots_m": {key: list(xyz) for key, xyz in TRIANGLE_M.items()}}
    if diameter_m is not None:
        target["diameter_m"] = diameter_m
    events = planned_events(frames, tuple(TRIANGLE_M), (width, height), sigma_px) if faults else ()
    return Cell(
        name=name,
        seed=seed,
        n_frames=frames,
        fps=fps,
        cameras=cameras,
        lights=lights,
        path=path,
        target=target,
        events=events,
        assumptions=(
            *_cameras_chosen(cameras),
            "target: isosceles triangle of lights, A (-40, 0), B (30, 32), C (30, -32) mm; sides 77, 77, 64 mm",
            _light_chosen(level, sigma_px, diameter_m),
            "path: sines of 140, 80, 60 mm about (60, 0, 800) mm and of 15, 15, 23 deg, periods 3.3 to 6.1 s, "
            "phases from the seed",
            f"time: {fps:g} frames per second, both shutters open together for {1e3 * exposure_s:g} ms, no jitter",
            _sensor_chosen(sensor),
            _room_chosen(keys, "9 grey levels with a slope of 5 across and -3 down"),
            f"{hot_pixels} hot pixels of 20 to 120 levels",
            _pipeline_chosen(camera_pipeline),
            *(f"fault in frames {e.first} to {e.last - 1}: {e.note}" for e in events),
        ),
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
    _check(seed, frames)
    sensor = Sensor()
    keys, camera_pipeline = checked_room(room), checked_pipeline(pipeline)
    lights = (Light(name="A", xyz_m=(0.0, 0.0, 0.0), level=210.0, sigma_px=3.0, bgr=(0.05, 0.08, 1.0)),)
    path = _about(seed)
    dark = {}
    focal_px = 750.0 * width / 640.0
    for side, (lens, pose) in parallel_pair(width, height, focal_px=focal_px, baseline_m=0.126).items():
        patches = np.random.default_rng([seed, SEED_BACKDROP])  # one stream: far behind, so both see the same
        plain = ambient(
            width, height, 30.0 if keys.dark else 0.0, across=10.0 if keys.dark else 0.0, bgr=(0.9, 1.0, 0.8)
        )
        backdrop = with_clutter(plain, clutter, (20.0, 90.0), patches) if keys.dark else plain
        dark[side] = SimCamera(
            lens=lens, T_world_camera=pose, sensor=sensor, backdrop=backdrop, pipeline=camera_pipeline
        )
    cameras = _in_room(dark, keys, _places(path(np.linspace(0.0, frames / 25.0, PLACES)), lights), seed)
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
        assumptions=(
            *_cameras_chosen(cameras),
            "the baseline is Kapucu's, and the image size at the default width; all else is chosen",
            "beacon: red, 210 grey levels in R, 17 in G, 10 in B, Gaussian of sigma 3 px; 1.5 m away on sines of 350, "
            "250, 150 mm, periods 5 to 9 s, phases from the seed; the exposure is an instant",
            _sensor_chosen(sensor),
            _room_chosen(keys, f"30 grey levels, {clutter} soft coloured patches of 20 to 90 levels"),
            _pipeline_chosen(camera_pipeline),
        ),
    )


def board_cell(
    seed: int,
    frames: int,
    *,
    width: int = 1280,
    height: int = 720,
    printed: Board | None = None,
    room: Any = ROOM,
    pipeline: Any = PIPELINE,
) -> BoardCell:
    """Return the cameras of hand_cell with a checkerboard before them, for calibrating them from images.

    frames: how many poses the board takes. Raises UsageError for less than one, or a board too large for the view.
    """
    _check(seed, frames)
    board = printed or Board()
    rng = np.random.default_rng([seed, SEED_BOARD])
    rig = converging_webcams(width, height)
    sensor = Sensor()
    keys, camera_pipeline = checked_room(room), checked_pipeline(pipeline)
    bgr = (1.0, 1.0, 1.0) if camera_pipeline.bayer else (1.0,)
    lamps = ambient(width, height, 1.0, across=0.16, down=-0.10, bgr=bgr)
    cameras = {
        side: SimCamera(
            lens=lens, T_world_camera=pose, sensor=sensor, backdrop=lamps, pipeline=camera_pipeline, grey=True
        )
        for side, (lens, pose) in rig.items()
    }
    poses = tuple(random_board_pose(board, rig, rng) for _ in range(frames))
    behind = None
    if not keys.dark:
        empty = {side: replace(camera, backdrop=np.zeros_like(lamps)) for side, camera in cameras.items()}
        corners = np.concatenate([pose.apply(board.corners_m()) for pose in poses])
        behind = {side: camera.backdrop for side, camera in _in_room(empty, keys, corners, seed).items()}
    return BoardCell(
        name="board-cell",
        seed=seed,
        fps=2.0,
        cameras=cameras,
        printed=board,
        poses=poses,
        behind=behind,
        assumptions=(
            *_cameras_chosen(cameras),
            f"board: {board.columns}x{board.rows} inner corners, squares of {1e3 * board.square_m:g} mm, flat, black "
            f"{board.black:g}, white {board.white:g} levels, lens blur sigma {board.blur_px:g} px",
            "poses: random within both views, 0.4 to 0.75 m away, tilted up to 40 deg, turned up to 20 deg",
            _sensor_chosen(sensor),
            "lamps: uneven by 16 % across and 10 % down",
            _room_chosen(keys, f"{board.room:g} grey levels"),
            _pipeline_chosen(camera_pipeline),
        ),
    )


MAKERS: Mapping[str, Callable[..., Cell | BoardCell]] = {
    "hand-cell": hand_cell,
    "led-cell": led_cell,
    "beacon-cell": beacon_cell,
    "board-cell": board_cell,
}


def cells() -> tuple[str, ...]:
    """Return the names of the built-in cells."""
    return tuple(MAKERS)


def warm_up() -> None:
    """Compile the renderer, so that the first frame of a timed run does not wait for it."""
    led_cell(0, 1, width=32, height=18).pair(0)
    led_cell(0, 1, width=32, height=18, diameter_m=0.01).pair(0)
    next(board_cell(0, 1, width=320, height=180).frames())


def _check(seed: int, frames: int) -> None:
    """Raise UsageError for a seed or a number of frames that cannot be."""
    if frames < 1:
        raise UsageError(f"a simulation of {frames} frames shows nothing", cure="Ask for one or more")
    if seed < 0:
        raise UsageError(f"the seed {seed} is negative", cure="Give 0 or more")


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


def _webcams(
    seed: int, width: int, height: int, exposure_s: float, sensor: Sensor, hot_pixels: int, keys: RoomKeys,
    pipeline: Pipeline,
) -> dict[str, SimCamera]:  # fmt: skip
    """Return two converging webcams with hot pixels of their own, in a dim room or as yet before nothing."""
    cameras = {}
    bgr = (1.0, 1.0, 1.0) if pipeline.bayer else (1.0,)
    for side, (lens, pose) in converging_webcams(width, height).items():
        rng = np.random.default_rng([seed, SEED_BACKDROP, SIDES.index(side)])
        dim = (9.0, 5.0, -3.0) if keys.dark else (0.0, 0.0, 0.0)
        plain = ambient(width, height, dim[0], across=dim[1], down=dim[2], bgr=bgr)
        cameras[side] = SimCamera(
            lens=lens,
            T_world_camera=pose,
            sensor=sensor,
            backdrop=with_hot_pixels(plain, hot_pixels, (20.0, 120.0), rng),
            exposure_s=exposure_s,
            pipeline=pipeline,
            grey=True,
        )
    return cameras


def _places(poses: RigidTransform, lights: Sequence[Light]) -> Array:
    """Return the places (n, 3) of lights on a target at many poses."""
    spots = np.array([light.xyz_m for light in lights], dtype=np.float64)
    return np.concatenate([pose.apply(spots) for pose in poses])


def _in_room(cameras: Mapping[str, SimCamera], keys: RoomKeys, places_m: Array, seed: int) -> dict[str, SimCamera]:
    """Return cameras in a room about the places (n, 3) of the target; the world's axes are the left camera's."""
    occluders = make_occluders(keys.occluders, keys.white_level, seed)
    if keys.dark:
        return {side: replace(camera, occluders=occluders) for side, camera in cameras.items()}
    if keys.picture is not None:
        return stand_in_room(cameras, keys, RigidTransform.identity(), occluders)
    T_world_room = keys.T_world_room.pose() if keys.T_world_room else RigidTransform.identity()
    T_room_world = T_world_room.inv()
    room = make_room(keys, T_room_world.apply(places_m), seed, least_floor_m=EYE_M)
    return stand_in_room(cameras, room, T_room_world, occluders)


def _room_chosen(keys: RoomKeys, dark: str) -> str:
    """Return what was chosen about the room."""
    if keys.dark:
        return f"room: {dark}"
    if keys.picture is not None:
        return "room: pictures of one's own"
    return f"room: {keys.preset}, white at {keys.white_level:g} grey levels of light, furniture from the seed"


def _pipeline_chosen(pipeline: Pipeline) -> str:
    """Return what was chosen about lens losses and processing."""
    if pipeline == IDEAL:
        return "processing: none; no mosaic of colour filters, no glare, no vignetting"
    mosaic = "Bayer mosaic" if pipeline.bayer else "no mosaic"
    jpeg = "no JPEG" if pipeline.jpeg_quality is None else f"JPEG of quality {pipeline.jpeg_quality}"
    return (
        f"processing: vignetting {100 * pipeline.vignetting:g} %, glare {100 * pipeline.glare:g} %, {mosaic}, curve "
        f"{pipeline.curve}, sharpening {pipeline.sharpening:g}, {jpeg}"
    )


def _cameras_chosen(cameras: Mapping[str, SimCamera]) -> tuple[str, ...]:
    """Return what was chosen about a pair of cameras."""
    left, right, T = cameras["left"].lens, cameras["right"].lens, cameras["right"].T_world_camera
    turn = np.rad2deg(float(np.linalg.norm(T.rotation.as_rotvec())))
    return (
        f"cameras: {left.width}x{left.height} px, fx {left.focal_px[0]:.1f} and {right.focal_px[0]:.1f} px, "
        f"distortion {list(left.distortion)} and {list(right.distortion)}",
        f"rig: right camera at {np.round(1e3 * np.asarray(T.translation), 2).tolist()} mm, turned {turn:.2f} deg",
    )


def _light_chosen(level: float, sigma_px: float, diameter_m: float | None) -> str:
    """Return what was chosen about the lights."""
    if diameter_m is None:
        return f"lights: Gaussian of sigma {sigma_px:g} px, {level:g} grey levels high at any distance"
    return f"lights: flat discs of {1e3 * diameter_m:g} mm, {level:g} grey levels, lens blur sigma {sigma_px:g} px"


def _sensor_chosen(sensor: Sensor) -> str:
    """Return what was chosen about the sensor."""
    return (
        f"sensor: {sensor.electrons_per_level:g} electrons per grey level, read noise of "
        f"{sensor.read_noise_level:g} levels, clipping at {sensor.saturation}"
    )
