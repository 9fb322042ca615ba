"""A guided calibration under way: its samples, its verdict, and the charts that show them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from armsight.app.guided.poses import PoseSamples
from armsight.app.guided.step import Charted, Figure, Guided, Hint, Sample, StepResult
from armsight.app.live.station import MeasurementProcess
from armsight.app.operator.job_runner import TrackedProgress
from armsight.errors import ArmsightError
from armsight.records import Progress
from armsight.units import DEG

Curves = dict[tuple[str, str], list[tuple[int, float]]]
"""By (name, unit) the points (number of samples, value), in their order."""


def figures_of(step: Guided) -> tuple[Figure, ...]:
    """Return a step's numbers of now: its own, or of a step that takes poses how far the target was turned."""
    if isinstance(step, Charted):
        return step.figures()
    if isinstance(step, PoseSamples) and len(step.samples) > 1:
        turned = step.turns()[0] / DEG
        return tuple(
            Figure(name=f"turned about axis {i + 1}, RMS", value=float(v), unit="deg") for i, v in enumerate(turned)
        )
    return ()


@dataclass(slots=True)
class History:
    """Numbers by the number of samples they rest on; samples dropped take theirs along."""

    _by_n: dict[int, tuple[Figure, ...]] = field(default_factory=dict)

    def remember(self, n: int, figures: tuple[Figure, ...]) -> None:
        """Take the figures of n samples, in place of what was known of n and more."""
        self._by_n = {k: kept for k, kept in self._by_n.items() if k < n}
        if figures:
            self._by_n[n] = figures

    def curves(self) -> Curves:
        """Return the curves so far."""
        out: Curves = {}
        for n, figures in sorted(self._by_n.items()):
            for figure in figures:
                out.setdefault((figure.name, figure.unit), []).append((n, figure.value))
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class GuidedStepState:
    """What a page shows. busy: what is being done, empty for nothing. refused: why the last sample was not taken.

    curves: figures by the number of samples. count: of what was done so far, so that a page knows that something was.
    result: of the last calibration; not_done: why there is none. Both go with the next sample taken or dropped.
    """

    hint: Hint
    samples: tuple[Sample, ...]
    coverage: dict[str, tuple[int, ...]]
    spread: tuple[tuple[str, str], ...]
    curves: Curves = field(default_factory=dict)
    count: int = 0
    busy: str = ""
    refused: str = ""
    result: StepResult | None = None
    not_done: str = ""


class GuidedStepRunner:
    """Does what pages ask of a step, in the order in which they ask; any thread may call it."""

    def __init__(self, step: Guided) -> None:
        self.step = step
        self._lock = threading.Lock()
        self._history = History()
        self.progress = TrackedProgress()
        """Of the calibration that runs, where it was begun with run_told; else of the last one."""
        self._state = self._looked()

    @property
    def name(self) -> str:
        """The step's key."""
        return self.step.name

    @property
    def state(self) -> GuidedStepState:
        """How it stands; the same object until something changes."""
        return self._state

    def accept(self, station: Callable[[], MeasurementProcess]) -> None:
        """Take what is seen now; why it was not taken stands in the state."""
        self.do("accept", lambda: self.step.accept(station()))

    def drop(self, index: int) -> None:
        """Forget a sample."""
        self.do("drop", lambda: self.step.drop(index))

    def look(self) -> None:
        """Look how a step stands that goes on by itself, where nothing is done just now."""
        if not self._lock.acquire(blocking=False):
            return
        try:
            before, now = self._state, self._looked()
            kept = {name: getattr(before, name) for name in ("count", "refused", "result", "not_done")}
            now = replace(now, **kept)
            self._state = before if now == before else now
        finally:
            self._lock.release()

    def run(self, progress: Progress) -> None:
        """Calibrate; the verdict, or why there is none, stands in the state."""
        with self._lock:
            before = replace(self._state, busy="run", refused="", not_done="", result=None)
            self._state = before
            results: list[StepResult] = []
            why = _why(lambda: results.append(self.step.run(progress)))
            result = results[0] if results else None
            self._state = replace(before, count=before.count + 1, busy="", result=result, not_done=why)

    def run_told(self) -> None:
        """Calibrate as run does, so that every page sees how far it is and may end it; once where several ask."""
        if self._state.busy == "run":
            return
        self.progress = TrackedProgress()
        self.run(self.progress)

    def do(self, what: str, act: Callable[[], object]) -> None:
        """Do something of the step's own; why it could not be done stands in the state."""
        with self._lock:
            before = replace(self._state, busy=what, refused="")
            self._state = before
            after: list[GuidedStepState] = []

            def both() -> None:
                act()
                after.append(self._looked())

            why = _why(both)
            self._state = replace(after[0] if after else before, count=before.count + 1, busy="", refused=why)

    def _looked(self) -> GuidedStepState:
        step, history = self.step, self._history
        history.remember(len(step.samples), figures_of(step))
        return GuidedStepState(
            hint=step.hint(),
            samples=step.samples,
            coverage=step.coverage(),
            spread=step.spread(),
            curves=history.curves(),
        )


def _why(act: Callable[[], object]) -> str:
    """Do it; return in words why it could not be done, empty where it was."""
    try:
        act()
    except ArmsightError as error:
        return str(error)
    except Exception as error:  # a person waits for an answer, whatever it is
        logging.getLogger(__name__).exception("a guided calibration failed")
        return (
            f"The program failed: {type(error).__name__}: {error}. Nothing was kept. Report it, with the console's log."
        )
    return ""
