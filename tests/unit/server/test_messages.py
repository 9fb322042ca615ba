"""Commands and states as the wire has them: nothing is lost on the way in or out."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.control.guard import GuardState
from armsight.control.session.loop_host import LoopEvent
from armsight.control.setpoints import Heartbeat, Taken, logged
from armsight.control.status import RobotStatus
from armsight.drivers import RobotState
from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent, UsageError
from armsight.records import JointReading
from armsight.server.messages import LONGEST_EVENT, accepted, command_of, event_message, state_message
from refusals import refuses

POSE = {"xyz_m": [0.4, -0.1, 0.3], "quat_xyzw": [0.0, 0.6, 0.0, 0.8]}
FIELDS = {
    "joint_goal": {"q": [0.1, -0.2]},
    "joint_velocity": {"qd": [0.3, 0.0]},
    "joint_step": {"step": [0.0, 0.01]},
    "flange_pose": {"T_base_flange": POSE},
    "tool_twist": {"velocity_m_s": [0.1, 0.2, 0.3], "angular_rad_s": [0.4, 0.5, 0.6]},
    "hold": {},
    "stop": {},
    "reset": {},
}


def message(kind: type, **fields):
    return kind(session="s", seq=7, **fields)


def status(n: int = 2, **more) -> RobotStatus:
    known = {"t_s": 5.0, "cycle": 9, "robot": RobotState.MOVING, "guard": GuardState.RUNNING}
    reading = JointReading(q=np.full(n, 0.25), t_s=4.75, sequence=3, source="fake")
    return RobotStatus(**{**known, "reading": reading, "q_sent": np.full(n, 0.5), **more})


@pytest.mark.parametrize("kind", [k for k in get_args(say.Command) if k not in (say.ReadMessage, say.Heartbeat)])
def test_each_message_asks_for_what_it_says_and_is_logged_so(kind):
    name = kind.model_fields["type"].default
    fields = {k: say.PoseMessage(**v) if k == "T_base_flange" else v for k, v in FIELDS[name].items()}
    found, values = logged(command_of(message(kind, **fields)))
    assert found == name and set(values) == set(FIELDS[name])
    for key, value in FIELDS[name].items():
        if key == "T_base_flange":
            assert all(values[key][part] == pytest.approx(value[part]) for part in POSE)
        else:
            assert values[key] == value


def test_a_heartbeat_keeps_its_number_and_a_read_is_no_command():
    assert command_of(message(say.Heartbeat, enable=True, number=4)) == Heartbeat(enable=True, number=4)
    with refuses(UsageError, "command"):
        command_of(message(say.ReadMessage))


def test_a_pose_without_a_rotation_is_refused():
    none = say.PoseMessage(xyz_m=[0.0] * 3, quat_xyzw=[0.0] * 4)
    with pytest.raises(Inconsistent):
        command_of(message(say.FlangePoseMessage, T_base_flange=none))


def test_a_state_tells_the_age_of_its_reading_and_who_drives():
    told = state_message(status(driver="anna", driver_s=2.0), "run", 7)
    assert (told.reply_to, told.instance, told.robot, told.guard) == (7, "run", "moving", "running")
    assert told.reading is not None and told.reading.age_s == 0.25 and told.reading.q == [0.25, 0.25]
    assert told.driver == say.Driver(who="anna", since_s=2.0)
    assert state_message(status(reading=None), "run").reading is None
    assert state_message(status(), "run").driver is None


def test_an_answer_tells_where_the_command_leads():
    T = RigidTransform.from_translation([0.1, 0.2, 0.3])
    told = accepted(Taken(t_s=1.0, cycle=2, q=np.array([0.5]), T_base_flange=T, limited=("speed of j1",)), 3)
    assert told.T_base_flange == say.PoseMessage(xyz_m=[0.1, 0.2, 0.3], quat_xyzw=[0.0, 0.0, 0.0, 1.0])
    assert (told.reply_to, told.q, told.limited) == (3, [0.5], ["speed of j1"])
    assert accepted(Taken(t_s=1.0, cycle=2), 3).q is None


def test_an_event_is_cut_to_what_the_protocol_takes():
    event = LoopEvent(t_s=1.0, level="info", message="x" * 2 * LONGEST_EVENT)
    assert len(event_message(event).message) == LONGEST_EVENT
