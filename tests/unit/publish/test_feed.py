"""From what runs to the publishers' process, and back: alarms that are kept, what is acknowledged, starts that fail."""

import time
from dataclasses import replace
from pathlib import Path

from armsight.control.guard import GuardState
from armsight.errors import DeviceFailed
from armsight_plant.options import FoxgloveOptions, PlantOptions
from armsight_plant.process import PlantProcess
from armsight_plant.publishing import Feed, _FeedThread, addresses, published
from armsight_plant.state import LONGEST, Acknowledge, Note, decode, encode
from loading import module_of

states = module_of(Path(__file__).with_name("plant_states.py"))
state, robot = states.state, states.robot
STOPPED = {"robot": robot(guard=GuardState.STOPPED, why="by anna")}


class Log:
    def __init__(self):
        self.said = []

    def __call__(self, level, message):
        self.said.append((level, message))


def test_what_is_acknowledged_is_logged_with_who_and_from_where():
    log = Log()
    feed = Feed(log, 1.0)
    (alarm,) = feed.with_alarms(state(**STOPPED)).alarms
    feed.take(Acknowledge(id=alarm.id, who="plc", address="10.0.0.7"))
    (seen,) = feed.with_alarms(state(**STOPPED)).alarms
    assert (seen.active, seen.acknowledged_by) == (True, "plc")
    assert log.said[-1] == ("info", f"alarm {alarm.id} was acknowledged by plc at 10.0.0.7")
    assert feed.with_alarms(state()).alarms == ()


def test_an_alarm_that_is_not_there_is_not_acknowledged():
    log = Log()
    Feed(log, 1.0).take(Acknowledge(id="stopped-1", who="plc", address="10.0.0.7"))
    assert log.said == [("warning", "plc at 10.0.0.7: there is no alarm 'stopped-1'")]


def test_requests_come_through_as_they_were_and_not_too_long():
    for one in (Note(level="error", message="a"), Acknowledge(id="i", who="w", address="a")):
        assert decode(encode(one)) == one
    assert len(decode(encode(Note(level="info", message="\u00e9" * 10_000))).message) == LONGEST


def test_a_process_that_ended_is_started_anew(monkeypatch):
    log = Log()
    options = PlantOptions(foxglove=FoxgloveOptions(host="127.0.0.1", port=0))
    begun = []
    monkeypatch.setattr("armsight_plant.publishing.AGAIN_S", 0.0)
    monkeypatch.setattr(PlantProcess, "restart", lambda self: begun.append(True))
    with published(options, lambda: replace(state(time.monotonic()), made_unix_s=time.time()), log) as ports:
        assert addresses(options, ports) == [f"Foxglove: ws://127.0.0.1:{ports['foxglove']}"]
        import multiprocessing

        (child,) = [one for one in multiprocessing.active_children() if one.name == "armsight-plant"]
        child.kill()
        child.join()
        until_s = time.monotonic() + 30
        while not begun and time.monotonic() < until_s:
            pass
    assert begun and ("error", "nothing is published: that process has ended; it is started anew every 0 s") in log.said


def test_why_it_cannot_be_started_anew_is_told_once_and_that_it_can_again(monkeypatch):
    class Process:
        alive, came = False, DeviceFailed("OPC UA cannot listen at here, port 4840")

        def restart(self):
            self.began = True

    monkeypatch.setattr("armsight_plant.publishing.AGAIN_S", -1.0)
    log, process = Log(), Process()
    thread = _FeedThread(process, state, log, 1.0)
    for _ in range(6):
        thread._look_after()
    assert process.began
    assert [message for _, message in log.said] == [
        "nothing is published: OPC UA cannot listen at here, port 4840; it is started anew every -1 s"
    ]
    process.alive, process.came = True, {"opcua": 4840}
    for _ in range(2):
        thread._look_after()
    assert log.said[1:] == [("info", "published again, opcua: port 4840")]
