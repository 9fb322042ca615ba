"""A path taught while the arm with the cameras follows the target, or while cameras beside the arm see it."""

from __future__ import annotations

from scipy.spatial.transform import RigidTransform

from armsight.app.requests.motion import ServoJob, TeachJob
from armsight.app.schemas.teach import TeachOutput
from armsight.app.servo.job import ServoDevices
from armsight.app.servo.outcome import Show
from armsight.app.servo.run import run_servo
from armsight.app.servo.session import Confirm
from armsight.app.teach.job import Begun, save, saved
from armsight.clock import Clock
from armsight.control.events import QueueSink
from armsight.control.servo import Mount, ServoSource
from armsight.control.teach import CarriedRig, PathRecorder, RigPlace, StandingRig
from armsight.errors import StaleData
from armsight.kinematics import Arm
from armsight.records import Progress, TargetPose


class _Place:
    """Where the rig is, once the servo knows."""

    def __init__(self) -> None:
        self.known: RigPlace | None = None

    def __call__(self, t_s: float) -> RigidTransform:
        if self.known is None:
            raise StaleData("the servo has not begun", consequence="Where the cameras are is not known")
        return self.known(t_s)


class TaughtBeside:
    """A recorder beside a servo: is told of each frame, and tells its events to the recording."""

    def __init__(self, job: TeachJob) -> None:
        self._place = _Place()
        self._clock: Clock | None = None
        self._sink: QueueSink | None = None
        T_target_tip = job.T_target_tip()
        self.recorder = PathRecorder(self._place, T_target_tip, every=job.every, mean=job.mean, tell=self._told)

    def begin(self, source: ServoSource, arm: Arm, clock: Clock, sink: QueueSink) -> None:
        """Take the readings that the servo gathers, and what takes events."""
        settings = source.settings
        self._clock, self._sink = clock, sink
        self._place.known = (
            CarriedRig(arm=arm, history=source.history, T_flange_rig=settings.T_parent_camera)
            if settings.mount is Mount.EYE_IN_HAND
            else StandingRig(T_world_rig=arm.T_world_base * settings.T_parent_camera)
        )

    def observe(self, pose: TargetPose, exposed_s: float) -> None:
        """Take what a frame shows."""
        self.recorder.observe(pose, exposed_s)

    def _told(self, text: str) -> None:
        if self._sink is not None and self._clock is not None:
            self._sink.event(self._clock.now_s(), text, "info", "teach")


def teach_following(
    job: TeachJob,
    servo: ServoJob,
    confirm: Confirm,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    devices: ServoDevices | None = None,
    begun: Begun = lambda _: None,
) -> TeachOutput:
    """Follow the target as run_servo does, and record the path of the tip in world; write job.out.

    What was taught before a failure is in the files when the error is raised. Raises as run_servo; NotEnoughData where
    less than two poses were taught.
    """
    beside = TaughtBeside(job)
    if not job.wait:
        beside.recorder.start()
    begun(beside.recorder)
    try:
        done = run_servo(servo, confirm, show, progress, devices=devices, beside=beside)
    except BaseException:
        if len(beside.recorder) > 1:
            save(job, beside.recorder)
        raise
    return saved(job, beside.recorder, done.stopped_by, done)
