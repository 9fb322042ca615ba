"""What this machine can do; simulated cells, and the papers' experiments on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from armsight.defaults import SPOT_STD_PX
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import action
from armsight.ops.flags import AN_ARM, KNOWN_ARM, OutFolder
from armsight.ops.kinds import AsFile, Readings
from armsight.ops.simulation import MOST_FRAMES
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.ops.doctor import DoctorOutput
    from armsight.ops.simulation.reproduced import ReproduceOutput
    from armsight.ops.simulation.run import SimulateOutput
    from armsight.records import Progress

__all__ = ["doctor", "reproduce", "write_simulation"]

Room: TypeAlias = Annotated[
    str | None, Doc("Behind the target: dark, workshop, office, plain or a picture. [default: its own]")
]
Seed: TypeAlias = Annotated[int | None, Doc("The same seed gives the same run. [default: the file's]"), Bounds(least=0)]
Frames: TypeAlias = Annotated[
    int | None, Doc("How many frames, or rows. [default: the file's]"), Bounds(least=1, most=MOST_FRAMES)
]
Zoom: TypeAlias = Annotated[
    float | None, Doc("Zoom lenses before the cameras, at this setting, 100 to 500 where not said.")
]


@action(
    "simulate",
    working="simulating",
    writes=True,
    examples=("webcam-cell -o cell", "webcam-cell --room workshop -o cell", "handeye -o photos"),
)
def write_simulation(
    scenario: Annotated[str, Doc("A scenario's name or file; or the name of a cell or set."), Flag(positional=True)],
    out: OutFolder,
    *,
    seed: Seed = None,
    frames: Frames = None,
    room: Room = None,
    zoom: Zoom = None,
    arm: Annotated[
        str | None,
        Doc(f"{KNOWN_ARM}: before the cameras in place of the scenario's arm, exactly as it is there."),
        AN_ARM,
    ] = None,
    home: Annotated[
        Readings, Doc("With --arm: readings at which the cameras see it, as 0,-1.2,0.4. [default: a twin's first]")
    ] = None,
    progress: Progress | None = None,
) -> SimulateOutput:
    """Write the frames of a simulated cell, its files and the truth into a folder; or a set for one calibration.

    Parameters
    ----------
    frames, seed, room, zoom
        As `simulate` takes them.
    arm, home
        Another arm before the scenario's cameras, and joint readings at which they see it.

    Raises
    ------
    DeviceNotFound, BadFile, UsageError
        As `simulate`.
    DeviceFailed
        The disk refuses.

    Examples
    --------
    >>> armsight.write_simulation("hand-cell", folder / "cell", frames=2).n_frames
    2
    """
    from armsight.ops.simulation.run import simulate

    return simulate(
        scenario, out, seed=seed, frames=frames, room=room, zoom=zoom, arm=arm, home=home, progress=progress
    )


@action("reproduce", working="reproducing {paper}", writes=True, examples=("kapucu2005 -o kapucu",))
def reproduce(
    paper: Annotated[
        Literal["korayem2018", "pachidis2005", "kapucu2005"],
        Doc("korayem2018, pachidis2005 or kapucu2005."),
        Flag(positional=True, read=str),
    ],
    out: OutFolder,
    *,
    seed: Annotated[int, Doc("Of the simulated frames' noise."), Bounds(least=0)] = 1,
    frames: Annotated[
        int | None, Doc("Fewer frames than the paper took, to try it. [default: the paper's]"), Bounds(least=1)
    ] = None,
    progress: Progress | None = None,
) -> ReproduceOutput:
    """Run a paper's experiment on emulated hardware; put print, the paper's method and armsight side by side.

    Raises
    ------
    UsageError
        Another paper; the message names those that there are.
    DeviceFailed
        The disk refuses.
    """
    from armsight.drivers import PAPERS, load

    return load(PAPERS, "reproduce")(paper, out, seed=seed, frames=frames, progress=progress)  # type: ignore[no-any-return]  # of an entry point


@action("doctor", working="doctor", examples=("", "--rig rig.yaml --depth 1.5"))
def doctor(
    rig: Annotated[AsFile, Doc("Tell what this rig can tell apart at distances.")] = None,
    *,
    depths_m: Annotated[
        list[float] | None,
        Doc("Distance for the rig's table; may be repeated."),
        Bounds(least=1e-6),
        Flag("--depth", quantity="m"),
    ] = None,
    sigma_px: Annotated[
        float, Doc("Standard deviation of a spot's centre in px."), Bounds(least=1e-6), Flag("--sigma")
    ] = SPOT_STD_PX,
    accuracy_m: Annotated[
        float | None,
        Doc("With --rig and --depth: what reaches this standard deviation of a point."),
        Bounds(least=1e-6 * MM),
        Flag("--accuracy", metavar="MM", unit=MM),
    ] = None,
    compile_ahead: Annotated[
        bool, Doc("First compile all that is not compiled yet: no command then waits for it."), Flag("--compile")
    ] = False,
    progress: Progress | None = None,
) -> DoctorOutput:
    """Tell what this machine can do: versions, cameras, drivers, compiled kernels; and a rig's resolution.

    Raises
    ------
    UsageError, BadFile, Cancelled
        An accuracy without a rig or a distance, or a distance without a rig.

    Examples
    --------
    >>> "rtde" in armsight.doctor().drivers["robots"]
    True
    """
    from armsight.ops.doctor import compiled_now, looked_at, rig_resolution
    from armsight.records import checked_array
    from armsight.store import read_zoom_rig

    depths = [] if depths_m is None else checked_array("depths_m", depths_m, (None,)).tolist()
    if depths and rig is None:
        raise UsageError("--depth is of a rig", cure="Give --rig with it")
    if accuracy_m is not None and (rig is None or not depths):
        raise UsageError(
            "--accuracy is of a rig at a distance",
            cure="Give --rig and --depth (in m; again for the far end of a volume)",
        )
    failed = compiled_now(progress) if compile_ahead else []
    seen = None if rig is None else read_zoom_rig(rig)
    return looked_at(None if seen is None else rig_resolution(seen, depths, sigma_px, accuracy_m), failed)
