"""Who drives the robot from a page, and whether the enable is held: the browsers' side of the control authority."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from threading import RLock
from typing import Literal

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control import setpoints
from armsight.control.session.authority import EnableLost, Lease
from armsight.control.session.loop_host import flange_pose, synchronized
from armsight.control.session.service import Service
from armsight.control.status import RobotStatus
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.kinematics import Arm

LOST_S = 1.0
"""A browser that held the enable and says nothing for so long is lost: the robot is stopped until it is reset."""

SLOWEST = 0.01
"""Smallest override."""
FIRST_OVERRIDE = 0.5
"""Before anybody moves the slider: the share at which `robot jog` moves an arm, too."""

FRESH_S = 1.0
"""An enable counts that answers a state no older than this."""

ENABLE_RELEASED = "Let the enable go, and hold it anew"


@dataclass(frozen=True, slots=True, kw_only=True)
class Person:
    """Who looks at a page, and what they may do; none: what they came in by has ended."""

    who: str = "operator"
    role: Literal["none", "watch", "drive"] = "drive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """A jog key that is held: frame joints, base or tool; axis, from 0: the joint, or x y z rx ry rz; sense 1 or -1."""

    frame: str
    axis: int
    sense: float


class OperatorSession:
    """The robot as browsers drive it, one at a time. Every browser has a name of its own; any thread may call this.

    The name tells browsers apart and is no right: whoever speaks in it is asked for their role each time.

    The browser that holds the enable has the right to drive; it keeps it until another takes it after ten
    silent seconds, or until its connection ends. Nothing here moves the robot without its beats.
    """

    def __init__(self, service: Service) -> None:
        self.service = service
        self.lock: RLock = service.lock
        self._authority, self._host = service.authority, service.host
        self._browser = ""
        self._lease: Lease | None = None
        self._line_key = ""
        self._held = False
        self._again = False
        self._pressed = False
        self._beat_s = -math.inf
        self._pushed: Push | None = None
        self.pushes = 0
        """How often a jog key was followed: whoever moves the robot besides has to look anew where it stands."""
        self._lost: set[str] = set()
        self._vain: set[str] = set()
        self._override = FIRST_OVERRIDE

    @property
    def arm(self) -> Arm | None:
        """The model of the robot's arm."""
        return self._host.arm

    @property
    def browser(self) -> str:
        """The browser that drives, empty where none does."""
        return self._browser

    @property
    def override(self) -> float:
        """Share of the speed of everything that is moved from a page, SLOWEST to 1."""
        return self._override

    @override.setter
    def override(self, share: float) -> None:
        self._override = min(1.0, max(SLOWEST, share)) if math.isfinite(share) else SLOWEST

    @synchronized
    def beat(
        self,
        browser: str,
        person: Person,
        *,
        enable: bool,
        seen_s: float = math.inf,
        age_s: float = 0.0,
        push: Push | None = None,
        number: int | None = None,
        key: str = "",
    ) -> None:
        """Take a browser's sign of life; enable: whether its deadman's button is held, push: its jog key.

        number: of the beat. key: by which the line for stops knows its enable, for as long as it counts here.
        age_s: how old the beat may be, by the round trip. seen_s: t_s of the newest state that it had; an enable that
        is older than FRESH_S lay in a buffer, and does not count until it was let go of. Raises DeviceFailed with who
        drives where another does, and at every beat of an enable that does not count; UsageError for whom may only
        watch, DeviceLost.
        """
        if person.role != "drive" and not enable:
            return  # a watcher has nothing to let go of
        self._check_role(person)
        if not self._is_driver(browser, person):
            if not enable:
                self._lost.discard(browser)
                self._vain.discard(browser)
                return
            self._check_let_go(browser)
            try:
                self._take(browser, person)
            except ArmsightError:
                self._vain.add(browser)  # held on till the other leaves, it would move the arm unawares
                raise
        now_s = self._host.now_s()
        over = self._why_over(now_s, seen_s) if enable else ""
        self._again = enable and (self._again or bool(over))
        self._pressed, self._held, self._beat_s = enable, enable and not self._again, now_s - age_s
        if not self._held:
            self._let_line("")  # first, so that nothing that comes there brings it back
        self._perform(setpoints.Heartbeat(enable=self._held, number=number), age_s)
        if self._held:
            self._let_line(key)
        self._follow(push if self._held else None)
        if self._again:  # said at every beat: who holds on has to know why nothing moves
            raise DeviceFailed(over or "the enable was held on", consequence="The robot is held", cure=ENABLE_RELEASED)

    def _why_over(self, now_s: float, seen_s: float) -> str:
        """Return why an enable that is held counts no more until it was let go of; empty where it counts."""
        if now_s - seen_s > FRESH_S:
            return "the connection is slow"
        return self._authority.lapsed(self._host.status()) if self._held else ""

    @synchronized
    def look(self) -> None:
        """Notice a browser that is lost while it held the enable; to be called some times a second."""
        if self._held and self._host.now_s() - self._beat_s > LOST_S:
            self._lose("the browser of the one who drives is silent")

    @synchronized
    def leave(self, browser: str) -> None:
        """Take the end of a browser's connection: where it held the enable, the robot is stopped until it is reset."""
        self._vain.discard(browser)
        if browser != self._browser or self._lease is None:
            return
        if self._held:
            self._lose("the browser of the one who drives was lost")
        else:
            self._let_go("its page was closed")

    @synchronized
    def stop(self, person: Person) -> None:
        """Stop the robot until it is reset; legal for everyone, always; never raises."""
        self._held, self._pushed = False, None
        self._let_line("")
        self._authority.stop(person.who)

    @synchronized
    def reset(self, browser: str, person: Person) -> None:
        """Take commands again after a stop; the enable has to be held anew. Raises DeviceFailed, UsageError."""
        self._check_role(person)
        if not self._is_driver(browser, person):
            self._take(browser, person)
        self._let_line("")
        self._perform(setpoints.Reset())
        self._held, self._again = False, self._pressed
        if not self._pressed:
            # browsers are silent while nothing is held, and the authority waits to hear that it was let go of
            self._perform(setpoints.Heartbeat(enable=False))

    @synchronized
    def choose_override(self, browser: str, person: Person, share: float) -> None:
        """Take another speed from who drives, or from who may while nobody does. Raises UsageError, DeviceFailed."""
        self._check_role(person)
        driver = self._authority.driver
        if driver is not None and not self._is_driver(browser, person):
            raise DeviceFailed(f"{driver.who} drives", consequence="The speed stays as it is")
        self.override = share

    @synchronized
    def enabled(self, browser: str) -> bool:
        """Return whether this browser holds the enable now."""
        return self._held and browser == self._browser and self._host.now_s() - self._beat_s <= self._host.enable_age_s

    @synchronized
    def step(self, browser: str, step: Array) -> tuple[Array, tuple[str, ...]]:
        """Move on by step (n,) for work that this browser enables; return where that leads, and what limited it.

        Raises EnableLost where it does not hold the enable, and as ControlAuthority.perform.
        """
        if not self.enabled(browser):
            raise EnableLost("the enable is not held", consequence="Nothing was sent", cure="Hold the enable")
        taken = self._perform(setpoints.JointStep(step=step))
        return np.array(taken.q), taken.limited

    @synchronized
    def hold(self, browser: str) -> None:
        """Let the robot come to rest where this browser drives it."""
        if browser == self._browser:
            with suppress(ArmsightError):
                self._perform(setpoints.Hold())

    def status(self) -> RobotStatus:
        """Return the robot's status as it counts now. Raises DeviceLost where the loop has ended."""
        return self._authority.status()

    @synchronized
    def drives(self, browser: str) -> bool:
        """Return whether this browser has the right to drive."""
        return browser == self._browser and self._authority.driver is not None

    def _check_let_go(self, browser: str) -> None:
        """Raise DeviceFailed where an enable is held on that did not count when it was pressed."""
        if browser in self._lost:
            raise DeviceFailed("the connection was lost", consequence="The robot was stopped", cure=ENABLE_RELEASED)
        if browser in self._vain:
            driver = self._authority.driver
            cause = "another drove when you pressed the enable" if driver is None else f"{driver.who} drives"
            raise DeviceFailed(cause, consequence="The robot is not moved", cure=ENABLE_RELEASED)

    def _is_driver(self, browser: str, person: Person) -> bool:
        lease = self._lease
        return (
            lease is not None
            and browser == self._browser
            and lease is self._authority.driver
            and (lease.person == person.who)
        )

    def _check_role(self, person: Person) -> None:
        """Raise UsageError for whom may not drive now: to be asked for everything that moves the robot, or lets it."""
        if person.role != "drive":
            raise UsageError(
                f"{person.who} may {'watch, not drive' if person.role == 'watch' else 'no longer drive'}",
                cure="Ask for a token that may drive",
            )

    def _take(self, browser: str, person: Person) -> None:
        self._lease = self._authority.take(person.who)
        self._line_key = self._lease.key  # a page's enable counts only as long as it does here
        self._let_line("")
        self._browser, self._held, self._again, self._pressed, self._pushed = browser, False, False, False, None

    def _let_line(self, key: str) -> None:
        """Let the line for stops take enables by this key; an empty one: none."""
        if self._lease is not None and key != self._line_key:
            self._line_key = key
            self._host.grant(self._lease.number, key, self._lease.person)

    def _lose(self, why: str) -> None:
        """Stop the robot, and let anybody drive who releases the stop; who is lost has to let the enable go first."""
        self._authority.stop(why)
        self._lost = {self._browser}
        self._let_go(why)

    def _let_go(self, why: str) -> None:
        if self._lease is not None:
            self._authority.leave(self._lease, why)
        self._browser, self._lease, self._line_key = "", None, ""
        self._held, self._again, self._pressed, self._pushed = False, False, False, None

    def _follow(self, push: Push | None) -> None:
        if push is None:
            if self._pushed is not None:
                self._pushed = None
                self._perform(setpoints.Hold())
            return
        self._pushed = push
        self.pushes += 1
        wanted = self._velocity(push)
        if isinstance(wanted, setpoints.JointVelocity | setpoints.ToolTwist):
            self._perform(wanted)

    def _velocity(self, push: Push) -> setpoints.SetPoint:
        n = self._authority.robot.n_joints
        source = setpoints.JogSource(n, push.frame)
        axes = n if source.frame is setpoints.JogFrame.JOINTS else 6
        if not 0 <= push.axis < axes:
            raise UsageError(f"there is no axis {push.axis + 1}")
        values = np.zeros(axes)
        values[push.axis] = self._override * float(np.sign(push.sense))
        arm, now = self.arm, self._host.status()
        T_base_flange = flange_pose(arm, now.q_sent)
        # of joints it is not asked; where poses are not taken the authority refuses
        T_base_tool = RigidTransform.identity()
        if arm is not None and T_base_flange is not None:
            T_base_tool = T_base_flange * arm.T_flange_tool
        source.push(values.tolist(), now.t_s)
        return source.next(
            setpoints.CycleState(
                t_s=now.t_s,
                cycle_s=self._authority.robot.cycle_s,
                q=now.q,
                q_sent=now.q_sent,
                qd_sent=np.zeros(n),
                T_base_tool=T_base_tool,
            )
        )

    def _perform(self, command: setpoints.Command, age_s: float = 0.0) -> setpoints.Taken:
        if self._lease is None:
            raise DeviceFailed("nobody drives", consequence="Nothing was done", cure="Hold the enable")
        return self._authority.perform(self._lease, command, age_s=age_s)
