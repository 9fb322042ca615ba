"""Commands and states as the wire has them: nothing is lost on the way in or out."""

import pytest

from armsight.control.session.loop_host import LoopEvent
from armsight.control.setpoints import Heartbeat
from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent, UsageError
from armsight.server.messages import LONGEST_EVENT, command_of, event_message
from refusals import refuses


def message(kind: type, **fields):
    return kind(session="s", seq=7, **fields)


def test_a_heartbeat_keeps_its_number_and_a_read_is_no_command():
    assert command_of(message(say.Heartbeat, enable=True, number=4)) == Heartbeat(enable=True, number=4)
    with refuses(UsageError, "command"):
        command_of(message(say.ReadMessage))


def test_a_pose_without_a_rotation_is_refused():
    none = say.PoseMessage(xyz_m=[0.0] * 3, quat_xyzw=[0.0] * 4)
    with pytest.raises(Inconsistent):
        command_of(message(say.FlangePoseMessage, T_base_flange=none))


def test_an_event_is_cut_to_what_the_protocol_takes():
    event = LoopEvent(t_s=1.0, level="info", message="x" * 2 * LONGEST_EVENT)
    assert len(event_message(event).message) == LONGEST_EVENT
