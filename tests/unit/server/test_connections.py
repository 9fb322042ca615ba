"""What a caller may cost: who is cut off where there is no room, before a first byte, and beyond a budget."""

import errno
import logging
import socket
from types import SimpleNamespace

import pytest
from websockets.frames import Frame, Opcode

from armsight.errors import DeviceFailed
from armsight.server import connections as limits
from armsight.server import limited, web_server
from armsight.server.connections import LINE, SERVER, Connections, ListeningSocket
from armsight.server.web_server import RECORDS_PER_MIN, BoundedLog
from refusals import refuses

FLOOD, HONEST = "192.0.2.1", "192.0.2.2"


class Line:
    """A socket, and its transport."""

    def __init__(self, address, port, load=0.0):
        self.peer, self.cut, self.aborted, self.load = (address, port), False, False, load

    def get_extra_info(self, _):
        return self.peer

    def fileno(self):
        return 3

    def shutdown(self, _):
        self.cut = True

    def abort(self):
        self.aborted = True


class Loop:
    """An event loop whose timers a test rings."""

    def __init__(self):
        self.timers = []

    def call_later(self, delay_s, act, *args):
        self.timers.append((delay_s, act, args))

    def ring(self):
        """Ring all that are due by now, and those that they set in turn."""
        while self.timers:
            _, act, args = self.timers.pop(0)
            act(*args)

    def stand_still(self):
        """All timers are due at once, before anything is read."""
        for _, act, args in [self.timers.pop() for _ in self.timers]:
            act(*args)


@pytest.fixture
def loop(monkeypatch):
    made = Loop()
    monkeypatch.setattr(limits.asyncio, "get_running_loop", lambda: made)
    return made


@pytest.fixture
def told():
    return []


@pytest.fixture
def crowd(told, loop):
    return Connections(told.append, room=10_000)


def come(crowd, address, ports, *, asks=True, who="", **line):
    lines = [Line(address, port, **line) for port in ports]
    for one in lines:
        crowd.accepted(one, one.peer)
        crowd.opened(one)
        if asks:
            crowd.asked(one)
            crowd.speaks(one, lambda one=one: one.load)
        if who:
            crowd.known(one, who)
    return lines


def test_a_handshake_that_hangs_is_ended(crowd, loop):
    slow, quick = Line(FLOOD, 1), Line(FLOOD, 2)
    crowd.accepted(slow, slow.peer)
    crowd.accepted(quick, quick.peer)
    crowd.opened(quick)
    crowd.asked(quick)
    assert {delay_s for delay_s, *_ in loop.timers} == {limits.HEAD_S - limits.LAST_TURN_S}
    loop.ring()
    assert slow.cut and not quick.cut, "the one that never spoke TLS, and no other"


def test_a_server_that_stood_still_itself_reads_before_it_ends_a_connection(crowd, loop):
    come_meanwhile, silent = Line(HONEST, 1), Line(HONEST, 2)
    for line in (come_meanwhile, silent):
        crowd.accepted(line, line.peer)
    loop.stand_still()
    crowd.opened(come_meanwhile)
    crowd.asked(come_meanwhile)
    loop.ring()
    assert silent.cut and not come_meanwhile.cut


def test_slow_ones_displace_each_other_and_nobody_elsewhere(crowd, told):
    honest = come(crowd, HONEST, range(3), asks=False)
    slow = come(crowd, FLOOD, range(300), asks=False)
    assert [one.cut for one in slow] == [True] * (300 - limits.UNKNOWN_PER_ADDRESS) + [
        False
    ] * limits.UNKNOWN_PER_ADDRESS
    assert not any(one.cut or one.aborted for one in honest)
    assert len([line for line in told if "asked nothing" in line]) == 1, "it is told once"


def test_whom_nobody_knows_makes_room_for_a_token(crowd):
    nobodys = come(crowd, FLOOD, range(limits.PER_ADDRESS - 1))
    (known,) = come(crowd, FLOOD, [900], who="anna")
    come(crowd, FLOOD, range(1000, 1010))
    assert sum(one.aborted for one in nobodys) == 10 and not known.aborted


def test_whom_nobody_knows_goes_before_a_token_that_has_more(crowd):
    (nobody,) = come(crowd, FLOOD, [900])
    known = come(crowd, FLOOD, range(limits.PER_ADDRESS), who="anna", load=900.0)
    assert nobody.aborted and not any(one.aborted for one in known)


def test_the_busiest_of_the_token_with_most_makes_room_and_never_who_drives(crowd):
    flood = come(crowd, FLOOD, range(limits.PER_ADDRESS - 2), who="anna", load=400.0)
    (driver,) = come(crowd, FLOOD, [900], who="anna", load=500.0)
    crowd.known(driver, "anna", keep=True)
    (quiet,) = come(crowd, FLOOD, [901], who="anna")
    (other,) = come(crowd, FLOOD, [902], who="bert", load=900.0)
    assert [one.aborted for one in flood].count(True) == 1
    assert not (driver.aborted or quiet.aborted or other.aborted)


def test_all_addresses_together_leave_room(crowd):
    many = [line for k in range(9) for line in come(crowd, f"192.0.2.{k + 10}", range(60))]
    assert sum(one.aborted for one in many) == len(many) - limits.IN_ALL > 0
    assert not come(crowd, HONEST, [1])[0].aborted


def test_what_ended_is_forgotten(crowd):
    for port in range(1000):
        (one,) = come(crowd, FLOOD, [port])
        crowd.closed(one)
        assert not one.aborted
    assert not crowd._open and not crowd._unknown


def test_connections_are_taken_a_few_at_a_time(crowd):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        waiting = [socket.create_connection(listener.getsockname()) for _ in range(limits.PER_TURN + 2)]
        taken = []
        with ListeningSocket(listener, crowd) as door:
            door.setblocking(False)
            for count in (limits.PER_TURN, limits.PER_TURN + 2):  # between them those that are there have their turn
                with pytest.raises(BlockingIOError):
                    while True:
                        taken.append(door.accept()[0])
                assert len(taken) == count
        for one in (*taken, *waiting):
            one.close()


def test_silent_ones_of_all_addresses_leave_room(crowd, told):
    honest = come(crowd, HONEST, [1], asks=False)
    many = [line for k in range(30) for line in come(crowd, f"192.0.2.{k + 10}", range(10), asks=False)]
    assert sum(one.cut for one in many) == len(many) + 1 - limits.UNKNOWN_IN_ALL and not honest[0].cut


def test_no_more_is_taken_than_there_are_descriptors_for(told, loop):
    crowd = Connections(told.append, room=100)
    many = come(crowd, FLOOD, range(110))
    assert sum(not one.aborted for one in many) == 75, "a quarter is for those that have asked nothing"
    with refuses(DeviceFailed, "files", "ulimit"):
        Connections(told.append, room=limits.FEWEST - 1)


def test_a_connection_without_a_descriptor_is_turned_away_and_another_makes_room(crowd, told, monkeypatch):
    """Left in the queue it would be asked for again and again, with a traceback each time."""
    accept, left, flood = socket.socket.accept, [0], come(crowd, FLOOD, range(3))

    def short(self):
        if left[0] == 0:
            left[0] = 1  # the reserve is free by now
            raise OSError(errno.EMFILE, "too many open files")
        return accept(self)

    monkeypatch.setattr(socket.socket, "accept", short)
    with socket.create_server(("127.0.0.1", 0)) as listener, ListeningSocket(listener, crowd) as door:
        with socket.create_connection(listener.getsockname(), timeout=10.0) as waiting:
            with pytest.raises(BlockingIOError):
                door.accept()
            assert waiting.recv(1) == b"", "it sees its end"
        assert sum(one.aborted for one in flood) == 1 and sum("descriptors" in line for line in told) == 1
        with socket.create_connection(listener.getsockname()):
            taken, _ = door.accept()
            taken.close()


def test_the_log_of_what_callers_provoke_is_bounded(monkeypatch):
    now, kept = [0.0], BoundedLog()
    monkeypatch.setattr(web_server.time, "monotonic", lambda: now[0])

    def passed(count):
        records = [logging.LogRecord("asyncio", logging.ERROR, "", 0, "accept %s", ("x",), None) for _ in range(count)]
        return [record.getMessage() for record in records if kept.filter(record)]

    assert len(passed(10_000)) == RECORDS_PER_MIN
    now[0] = 61.0
    first, *others = passed(10)
    assert "(9980 before" in first and len(others) == 9


def test_a_line_for_stops_lets_less_through_than_a_server():
    assert LINE.messages_per_s < SERVER.messages_per_s and LINE.bytes_per_s < SERVER.bytes_per_s
    beats_and_pongs = 5.0 / 0.15 + 1.0 / limited.PING_S
    assert LINE.messages_burst >= 3.0 * beats_and_pongs, "what a line held back for 3 s is no flood"


class Turns:
    """An event loop whose turns a test takes."""

    def __init__(self):
        self.soon = []

    def call_soon(self, act):
        self.soon.append(act)


@pytest.fixture
def flooder(crowd, monkeypatch):
    """A WebSocket of which only the limits are there; parsed: the lengths that reached the parser."""
    monkeypatch.setattr(
        limited.WebSocketsSansIOProtocol, "data_received", lambda self, data: self.parsed.append(len(data))
    )
    made = limited.LimitedWebSocket.__new__(limited.LimitedWebSocket)
    made.guarded, made.loop, made.parsed = crowd, Turns(), []
    made.transport = SimpleNamespace(is_closing=lambda: False, abort=lambda: None, get_extra_info=lambda _: None)
    made.close_sent = made.handshake_complete = False
    made.turned_out = []
    made.turn_out = made.turned_out.append
    made._sent, made._sent_s = 0.0, 0.0
    made._backlog, made._timer = b"", None
    made._bytes = limited.TokenBucket(SERVER.bytes_per_s, SERVER.bytes_burst, 0.0)
    made._parsing = limited.TokenBucket(limited.PARSING, limited.PARSING_BURST_S, 0.0)
    monkeypatch.setattr(limited.time, "monotonic", lambda: 0.0)
    return made


def test_a_flood_is_parsed_a_slice_a_turn(flooder):
    flooder.data_received(b"x" * (2 * limited.SLICE))
    flooder.data_received(b"x" * 10)
    assert flooder.parsed == [limited.SLICE], "others have their turn"
    while flooder.loop.soon:
        flooder.loop.soon.pop(0)()
    assert flooder.parsed == [limited.SLICE, limited.SLICE, 10]


def test_the_answer_to_a_close_of_ours_is_read_and_a_flood_in_its_place_cut(flooder):
    flooder.close_sent, aborted = True, []
    flooder.data_received(b"\x88\x80")
    assert flooder.parsed == [2], "else the connection stays until uvicorn gives up waiting"
    flooder.transport.abort = lambda: aborted.append(True)
    limited.LimitedWebSocket.turn_out(flooder, "it may")
    assert aborted == [True]


def test_what_is_over_the_budget_of_bytes_is_not_parsed(flooder):
    flooder.data_received(b"x" * (int(SERVER.bytes_burst) + 1))
    assert flooder.turned_out and flooder.parsed == []


def test_what_is_over_the_budget_of_messages_is_not_passed_on(flooder, monkeypatch):
    passed = []
    monkeypatch.setattr(limited.WebSocketsSansIOProtocol, "handle_events", lambda self: passed.append(self.conn.events))
    flooder._messages = limited.TokenBucket(SERVER.messages_per_s, SERVER.messages_burst, 0.0)
    stop = Frame(Opcode.TEXT, b'{"do": "stop"}')
    huge = Frame(Opcode.TEXT, b'{"do": "stop"}' + b" " * limited.LONGEST_STOP)
    for events, heard in (
        ([Frame(Opcode.TEXT, b"x")] * int(SERVER.messages_burst), int(SERVER.messages_burst)),
        ([Frame(Opcode.TEXT, b"x")], 0),
        ([Frame(Opcode.TEXT, b"x"), stop, huge], 1),  # a stop passes
    ):
        flooder.conn = SimpleNamespace(events=events)
        flooder.handle_events()
        assert len(passed.pop()) == heard
    assert flooder.turned_out == [f"{SERVER.messages_per_s:g} messages a second"] * 2


def test_parsing_that_takes_long_ends_the_connection(flooder, monkeypatch):
    clock = iter([0.0, 2.0 * limited.PARSING_BURST_S])
    monkeypatch.setattr(limited.time, "thread_time", lambda: next(clock))
    flooder.data_received(b"x" * (3 * limited.SLICE))
    assert flooder.turned_out and flooder.parsed == [limited.SLICE] and not flooder.loop.soon


def test_what_was_said_last_counts_though_the_connection_ends(flooder, monkeypatch):
    monkeypatch.setattr(limited.WebSocketsSansIOProtocol, "connection_lost", lambda self, exc: None)
    flooder.data_received(b"x" * (limited.SLICE + 7))
    flooder.connection_lost(None)
    assert flooder.parsed == [limited.SLICE, 7]


def test_who_sends_much_is_busy_for_a_while_and_who_polls_is_not(flooder, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(limited.time, "monotonic", lambda: now[0])
    flooder._sent = limited.QUIET
    assert flooder.load() == 0.0
    flooder._sent = 10.0 * limited.QUIET
    assert flooder.load() == 10.0 * limited.QUIET
    now[0] = limited.LOAD_S
    assert limited.QUIET < flooder.load() < 5.0 * limited.QUIET
    now[0] = 10.0 * limited.LOAD_S
    assert flooder.load() == 0.0
