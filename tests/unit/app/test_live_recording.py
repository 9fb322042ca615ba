"""What a page is told of a recording: in the order in which it happens, and no end before the file is whole."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from armsight.clock import ManualClock
from armsight.ops.recording import recorder as recording
from armsight.ops.recording.recorder import LiveRecording, RecordingState


class Slow:
    """A recorder whose end takes as long as somebody else tells how far it is."""

    written, dropped = 3, 0

    def __init__(self) -> None:
        self.closed = threading.Event()
        self.meanwhile: Any = lambda: None

    def close(self) -> None:
        self.meanwhile()
        self.closed.set()


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[LiveRecording, Slow, list[RecordingState]]:
    """A recording under way; what it tells is kept."""
    slow, told = Slow(), []
    monkeypatch.setattr(recording, "RecordingWriter", lambda file, clock: None)
    monkeypatch.setattr(recording, "Recorder", lambda *_, **__: type("Made", (), {"__enter__": lambda _: slow})())
    live = LiveRecording(told.append, ManualClock())
    live.begin(tmp_path / "a.mcap")
    assert [state.file for state in told] == [tmp_path / "a.mcap"], "that it has begun is told at once"
    return live, slow, told


def test_a_file_that_is_being_closed_is_still_told_as_open(made: Any) -> None:
    live, slow, told = made
    slow.meanwhile = live.notify
    live.end()
    assert [state.file is not None for state in told] == [True, True, False]
    live.notify()
    live.end()
    assert len(told) == 3


def last_told(live: LiveRecording, slow: Slow, *, ordered: bool) -> RecordingState:
    """Return what is told last where the end comes while another thread is about to tell how far it is."""
    told: list[RecordingState] = []
    ending = threading.Thread(target=live.end)

    def tell(state: RecordingState) -> None:
        if state.file is not None:
            ending.start()
            slow.closed.wait()
            if not ordered:
                ending.join()
        told.append(state)

    live._notify = tell
    live.notify()
    ending.join()
    return told[-1]


def test_nothing_of_a_recording_is_told_after_its_end(made: Any) -> None:
    live, slow, _ = made
    assert last_told(live, slow, ordered=True).file is None


def test_without_the_order_the_last_word_would_be_that_it_is_open(made: Any) -> None:
    live, slow, _ = made
    live._order = nullcontext()  # a planted fault
    assert last_told(live, slow, ordered=False).file is not None
