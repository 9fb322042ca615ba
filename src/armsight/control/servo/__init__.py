"""Visual servoing: the arm follows a target that cameras see (Pachidis 2005, sections 3 to 5; MATH 3.3)."""

from armsight.control.servo.law import (
    Gain,
    Mount,
    ServoError,
    ServoSettings,
    Turning,
    chosen_gain,
    delay_cycles,
    no_overshoot_gain,
    on_axis,
    servo_error,
    servo_twist,
    stability_gain,
)
from armsight.control.servo.servo_source import ServoSource
from armsight.control.servo.target_track import TargetMotion, TargetTrack, Tracked
