"""What a served robot is, as the plant's systems are told it."""

from contextlib import contextmanager

import pytest

from armsight.control.guard import GuardState
from armsight.server.serving import published_to_plant
from armsight.server.web_server import ServeOptions
from armsight_plant.options import FoxgloveOptions, PlantOptions
from armsight_plant.publishing import Publishing, source_of
from armsight_plant.state import conditions
from armsight_plant.values import told

FOXGLOVE = Publishing(PlantOptions(foxglove=FoxgloveOptions(host="127.0.0.1", port=8767)))


def test_state_and_joints_of_a_robot_are_told_with_their_age(service, host):
    host.guard = "running"
    state = source_of(service)()
    assert state.robot.status.guard is GuardState.RUNNING and state.robot.name == "fake"
    assert state.made_s - state.robot.at_s == pytest.approx(0.01, abs=1e-3)
    assert told(state, state.made_s, 1.0)["robot.joints"].value == [0.0, 0.0]
    assert conditions(state) == []


def test_a_loop_that_ended_is_an_alarm(service, host):
    host.ended = True
    state = source_of(service)()
    assert state.robot is None and state.why
    assert [one.name for one in conditions(state)] == ["robot"]


def test_a_server_tells_where_it_publishes_and_nothing_where_it_does_not(service, monkeypatch):
    begun, said = [], []

    @contextmanager
    def published(options, source, log):
        begun.append(source().source)
        yield {"foxglove": 8767}

    monkeypatch.setattr("armsight_plant.publishing.published", published)
    with published_to_plant(service, ServeOptions(), said.append):
        assert begun == said == []
    with published_to_plant(service, ServeOptions(plant=FOXGLOVE), said.append):
        assert begun == ["armsight serve"] and said == ["Foxglove: ws://127.0.0.1:8767"]
