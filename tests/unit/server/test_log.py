"""The log of a server: everything is in the recording, whichever side told it first."""

import armsight
from armsight.clock import ManualClock
from armsight.ops.robot.recorder import RecordingLog


def test_what_the_loop_did_earlier_is_kept_too(tmp_path):
    path = tmp_path / "log.mcap"
    with RecordingLog(path, clock=ManualClock(5.0)) as log:
        log.event(5.0, "info", "served")
        log.event(4.9, "warning", "disabled")
        log.command(5.0, "anna", "joint_goal", {"q": [0.1]})
        log.command(4.95, "loop", "joints", {"q": [0.0]})
        log.command(5.1, "loop", "joints", {"q": [0.1]})
    assert (log.failed, log.dropped) == ("", 0)
    with armsight.open_recording(path) as recording:
        assert [event.message for event in recording.events()] == ["served", "disabled (0.100 s earlier)"]
        given = [(command.values["who"], command.values["given_s"]) for command in recording.commands()]
    assert given == [("anna", 5.0), ("loop", 4.95), ("loop", 5.1)]
