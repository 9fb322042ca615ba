"""A browser that comes before the pages are there is told what is waited for."""

import contextlib
import http.client
import socket

import pytest

from armsight.errors import DeviceFailed
from armsight.server.waiting import listening, waiting_page


def asked(port: int) -> tuple[int, str]:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", "/live")
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def test_the_step_is_named_until_a_server_takes_over() -> None:
    with waiting_page("127.0.0.1", 0, "Cell", secure=False) as page:
        port = page.listener.getsockname()[1]
        for step in ("The robot is opened.", "The <cameras> are opened."):
            page.step(step)
            status, text = asked(port)
            assert status == 503 and step.replace("<", "&lt;").replace(">", "&gt;") in text
            assert 'http-equiv="refresh"' in text
        page.close()
        with socket.create_connection(("127.0.0.1", port), timeout=10) as late:  # waits for the server
            page.listener.settimeout(10)
            caller, _ = page.listener.accept()
            with caller:
                assert caller.getpeername() == late.getsockname()


def test_callers_that_say_nothing_or_speak_tls_are_not_in_the_way() -> None:
    with waiting_page("127.0.0.1", 0, "Cell", secure=False) as page:
        port = page.listener.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)):
            assert asked(port)[0] == 503
    with (
        waiting_page("127.0.0.1", 0, "Cell", secure=True) as page,
        socket.create_connection(page.listener.getsockname(), timeout=10),
    ):
        page.listener.settimeout(10)
        page.listener.accept()[0].close()
        with pytest.raises(DeviceFailed, match="--port"), listening("127.0.0.1", page.listener.getsockname()[1]):
            pass
