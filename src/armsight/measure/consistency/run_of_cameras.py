"""The consistency check of a rig that is no pair: a camera that is wrong is named, and the others go on without it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from armsight.errors import Unseen
from armsight.measure.consistency.cameras import AGREEING, RECALIBRATE, again
from armsight.measure.consistency.check import RunCheck, what
from armsight.measure.consistency.evidence import WINDOW
from armsight.measure.consistency.findings import Consistency, LeftOut
from armsight.measure.consistency.other_cameras import FEWEST, LIGHTS, CameraChecks, capital
from armsight.measure.poses.outcome import Measured, Track
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.tracking import MAX_GAP_S
from armsight.measure.poses.views import measure_views
from armsight.records import PoseStatus, Spots

TRIED = 8
"""Moments by which cameras that take no part are looked at."""
IDLE = 0.5
"""Share of the moments in which a camera sees lights of which no pose takes any, from which it is asked why."""

CLEARLY = 1.5
"""How many times worse moments must fit without any other camera: chi-square per degree of freedom, of a hundred."""
LONG = 4 * WINDOW
"""Moments after which a camera that no cause explains is asked where it stands."""


class CamerasCheck:
    """Sees every moment of a run in order, as RunCheck; what it leaves out the caller need not measure any more.

    All moments are kept as their spots, so that they can be solved anew without a camera that is found to be wrong.
    left_out: what was found of these cameras, of which n_told have been told. n_seen: by camera, the moments in which
    it saw lights.
    """

    def __init__(self, setup: Setup, left_out: Sequence[LeftOut] = (), *, early: bool = True) -> None:
        """left_out: what was found before the run. early: whether cameras are left out before its end, by sums that
        take a change for what was so all along."""
        self._setup = setup
        self._check = RunCheck(setup)
        self._moments: list[Measured] = []
        self._asked: set[int] = set()
        self._track: Track | None = None
        self._final: Consistency | None = None
        self._next_ask = WINDOW
        self.left_out, self._early = list(left_out), early
        self.n_told = 0
        self.n_seen: Counter[str] = Counter()

    @property
    def without(self) -> tuple[str, ...]:
        """The cameras that are left out."""
        return tuple(name for one in self.left_out for name in one.names)

    @property
    def inconsistent(self) -> bool:
        """Whether the run, by the cameras that are left, was inconsistent when it was judged last."""
        return self._check.inconsistent

    def add(self, measured: Measured) -> Measured:
        """Take one moment; return it as RunCheck does, and without the cameras that are wrong by now."""
        self._moments.append(replace(measured, track=None))
        late = False
        for name, seen in zip(self._setup.rig.names, measured.seen, strict=True):
            self.n_seen[name] += len(seen) >= LIGHTS
            late |= len(seen) > 0 and name in self.without
        if late:
            measured = self._again(measured, self._track)
        last, self._track = self._track, measured.track
        before = self._check.looks_next
        out = self._check.add(measured)
        n = len(self._moments)
        if not self._early or (self._check.looks_next == before and n < self._next_ask):
            return out
        self._next_ask = max(self._next_ask, 2 * n)
        known = self._check.known
        if known is not None and known.accused:  # which of the cameras it is, is told by when it was
            known = self._check.with_changes()
        found = self._wrong(known)
        if found is None or not self._enough_without(found):
            return out
        self._leave(found)
        measured = self._again(measured, last)
        self._track = measured.track
        return measured

    def finish(self) -> Consistency:
        """Return the verdict over the whole run, by the cameras that agree."""
        while True:
            found = self._check.finish()
            wrong = self._wrong(found, ended=True)
            if wrong is None or not self._enough_without(wrong):
                break
            self._leave(wrong)
        if wrong is not None:
            found = replace(found, verdict="inconsistent", instead=wrong.words, remedy=wrong.cure)
        self._final = replace(found.final, left_out=tuple(self.left_out))
        return self._final

    def again(self) -> Iterator[Measured]:
        """Give all moments solved anew without what is left out, as the verdict has them."""
        track: Track | None = None
        for one in self._moments:
            measured = self._again(one, track)
            track = measured.track
            yield measured if self._final is None else self._check.widened(measured, self._final)

    def _enough_without(self, found: LeftOut) -> bool:
        """Whether it is told which are wrong, and enough cameras are left to tell which are right."""
        return bool(found.names) and len(self._setup.rig.cameras) - len({*self.without, *found.names}) >= AGREEING

    def _wrong(self, known: Consistency | None, *, ended: bool = False) -> LeftOut | None:
        """Return what is wrong with a camera that still counts."""
        checks, idle = self._checks(), self._idle()
        for k in idle:
            found = checks.mistaken(k)
            if found is not None:
                return found
        if known is not None and (known.accused or (ended and known.findings)):
            told = self._accused(known, ended=ended)
            if told is not None and (not told.names or self._enough_without(told)):
                return told
        for k in idle if ended or len(self._moments) >= LONG else ():
            found = self._checks(self.without).elsewhere(k)
            if found is not None:
                return found
            self._asked.add(k)
        return None

    def _accused(self, known: Consistency, *, ended: bool) -> LeftOut | None:
        """Return what is said of the cameras that the sums accuse; of none where it is open which of some is wrong.

        Sums to first order mistake one for another where a knock is large: without the one that is wrong, moments fit.
        """
        names, since_s = known.accused, known.findings[0].since_s if known.findings else None
        if len(self._setup.rig.cameras) > AGREEING:
            if since_s is None:
                since_s = self._moments[0 if ended else -WINDOW :][0].pose.t_s
            later = [one for one in self._moments if one.pose.t_s >= since_s]
            told = all(self._seen_by_others(part, names) for part in (later, later[-WINDOW:]))
            names = self._without_which(later, names) if told else ()
            names = names if self._seen_by_others(later[-WINDOW:], names) else ()
        if not names and not (ended and known.accused):
            return None
        if not names:
            words = f"The camera {known.accused[0]} or another one has moved, and too few see the target to tell which"
            return LeftOut(names=(), words=words, cure=f"Fasten the cameras, then {RECALIBRATE}")
        of_them = [(what(f), f.cause.advice) for f in known.findings if set(names) <= set(f.cause.cameras)]
        words, cure = of_them[0] if of_them else (f"the camera {names[0]} does not fit the others", again(names[0]))
        return LeftOut(names=names, words=capital(words), cure=cure)

    def _seen_by_others(self, moments: Sequence[Measured], names: tuple[str, ...]) -> bool:
        """Whether enough other cameras see the target: of two it is open which is wrong."""
        others = [k for k, name in enumerate(self._setup.rig.names) if name not in (*self.without, *names)]
        often = [sum(len(one.seen[k]) >= LIGHTS for one in moments) > IDLE * len(moments) for k in others]
        return sum(often) >= AGREEING + (not names)

    def _without_which(self, moments: Sequence[Measured], accused: tuple[str, ...]) -> tuple[str, ...]:
        """Return the cameras without which moments fit that do not: the accused where that tells nothing, none where it
        is open."""
        unfit = [one for one in moments if one.pose.status is not PoseStatus.OK and any(map(len, one.seen))]
        if len(unfit) < FEWEST and accused:
            return accused
        unfit = (unfit if len(unfit) >= FEWEST else list(moments))[-2 * TRIED :]
        checks = CameraChecks(self._setup, unfit[:: max(len(unfit) // TRIED, 1)][:TRIED])
        tried = {accused, *((name,) for name in self._setup.rig.names if name not in self.without)}
        misfit = {names: checks.misfit_without((*self.without, *names)) for names in tried}
        best = [names for names, off in misfit.items() if off <= CLEARLY * min(misfit.values())]
        return accused if accused in best else best[0] if len(best) == 1 else ()

    def _idle(self) -> list[int]:
        """Return the cameras that see lights of which hardly any pose takes one."""
        out = []
        for k, name in enumerate(self._setup.rig.names):
            n = self.n_seen[name]
            if name not in self.without and k not in self._asked and n >= WINDOW:
                shown = sum(len(one.spots[k]) > 0 for one in self._moments if len(one.seen[k]) >= LIGHTS)
                if shown <= (1.0 - IDLE) * n:
                    out.append(k)
        return out

    def _checks(self, without: Sequence[str] = ()) -> CameraChecks:
        step = max(len(self._moments) // TRIED, 1)
        names, some = self._setup.rig.names, self._moments[::step][:TRIED]
        return CameraChecks(self._setup, [without_spots(one, names, without) for one in some])

    def _leave(self, found: LeftOut) -> None:
        """Leave cameras out, and look at all moments anew without them."""
        self.left_out.append(found)
        self._check, track = RunCheck(self._setup), None
        for one in self._moments:
            measured = self._again(one, track)
            track = measured.track
            self._check.add(measured)

    def _again(self, one: Measured, track: Track | None) -> Measured:
        """Return a moment without the cameras that are left out."""
        if not self.left_out:
            return one
        if one.cause is Unseen.HALF_HIDDEN:
            return one
        whole = one.spots if one.notes else one.seen  # what is half hidden stays left out
        named = zip(self._setup.rig.names, whole, strict=True)
        seen = tuple(Spots.none() if name in self.without else spots for name, spots in named)
        if track is not None and not 0.0 < one.pose.t_s - track.t_s <= MAX_GAP_S:
            track = None
        return measure_views(self._setup, one.pose.t_s, seen, track)


def accused_in(known: Consistency) -> LeftOut | None:
    """Return the cameras that a verdict names, to go on without them; None where it names none."""
    if not known.accused:
        return None
    first = known.findings[0]
    return LeftOut(names=known.accused, words=capital(what(first)), cure=first.cause.advice)


def without_spots(one: Measured, names: Sequence[str], without: Sequence[str]) -> Measured:
    """Return a moment without what some of its cameras saw."""
    seen = zip(names, one.seen, strict=True)
    return replace(one, seen=tuple(Spots.none() if name in without else spots for name, spots in seen))
