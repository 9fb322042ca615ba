"""Alarms by the states of ISA-18.2: raised, acknowledged, gone, and what stays."""

import pytest

from armsight.errors import UsageError
from armsight_plant.state import AlarmBook, Condition

LATCHED = Condition(name="stopped", why="it is so")


def raised(condition):
    book = AlarmBook()
    book.update([condition], 1000.0)
    (alarm,) = book.alarms
    return book, alarm


def test_a_cause_raises_one_alarm_however_often_it_is_told():
    book, alarm = raised(LATCHED)
    assert book.update([LATCHED], 1001.0) == []
    assert book.alarms == (alarm,)
    assert (alarm.active, alarm.acknowledged, alarm.since_s) == (True, False, 1000.0)


def test_a_latched_alarm_stays_until_it_is_acknowledged():
    book, alarm = raised(LATCHED)
    book.update([], 1001.0)
    (kept,) = book.alarms
    assert (kept.id, kept.active, kept.acknowledged) == (alarm.id, False, False)
    book.acknowledge(alarm.id, "anna")
    assert book.alarms == ()


def test_an_acknowledged_alarm_stays_visible_until_its_cause_has_gone():
    book, alarm = raised(LATCHED)
    book.acknowledge(alarm.id, "anna")
    (kept,) = book.alarms
    assert (kept.active, kept.acknowledged_by) == (True, "anna")
    book.update([], 1001.0)
    assert book.alarms == ()


def test_a_cause_that_comes_back_before_anybody_saw_it_is_the_same_occurrence():
    book, alarm = raised(LATCHED)
    book.update([], 1001.0)
    book.update([LATCHED], 1002.0)
    (again,) = book.alarms
    assert (again.id, again.active) == (alarm.id, True)


def test_an_acknowledgement_does_not_hold_for_the_next_occurrence():
    book, alarm = raised(LATCHED)
    book.acknowledge(alarm.id, "anna")
    book.update([], 1001.0)
    book.update([LATCHED], 999.0)  # the computer's clock was set back meanwhile
    (again,) = book.alarms
    assert again.id != alarm.id and not again.acknowledged
    with pytest.raises(UsageError, match="no alarm"):
        book.acknowledge(alarm.id, "anna")


def test_an_acknowledgement_does_not_hold_for_what_the_same_alarm_says_next():
    book, alarm = raised(Condition(name="link", why="the robot is stopped"))
    book.acknowledge(alarm.id, "anna")
    told = book.update([Condition(name="link", why="the robot is lost")], 1001.0)
    (lost,) = book.alarms
    assert told == [f"alarm {lost.id}: the robot is lost"]
    assert lost.id != alarm.id and lost.active and not lost.acknowledged
