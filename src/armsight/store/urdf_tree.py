"""How the links of a URDF hang on each other, which of its chains is the arm, and what limits its joints have."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.store.interpret import limits_look_like_degrees, looks_like_mm
from armsight.store.urdf_elements import numbers, origin_of

MOST_TOLD = 20
"""Links named in a message; a robot's description can have hundreds."""

TOOL_LINKS = ("tool0", "flange")
"""What the tool's link is called where several hang on the last joint (ROS-Industrial; REP 199 of ROS), best first."""

SAME_PLACE = 1e-9
"""Links (m, rad) closer than this are one: a name more for the same frame."""

WORLD = "world"
"""The root link of this name is no part of the arm: what hangs on it is its base (REP 105 of ROS)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UrdfJoint:
    """One joint element: links by name, its element for the rest, and what messages call it."""

    name: str
    type: str
    parent: str
    child: str
    element: ElementTree.Element
    at: str

    @property
    def T_parent_joint(self) -> Array:
        """Its place (4, 4); BadFile where that is none. Not read before it matters: outside the chain it does not."""
        return origin_of(self.element, self.at)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tree:
    """The links, the joint above each link, the joints below it, and the links on which something moves."""

    links: frozenset[str]
    above: Mapping[str, UrdfJoint]
    below: Mapping[str, list[UrdfJoint]]
    moved: frozenset[str]
    where: str

    def to(self, link: str, start: str | None = None) -> list[UrdfJoint]:
        """Return the joints to a link, in order, from start where that is on the way, else from the root."""
        chain: list[UrdfJoint] = []
        at = link
        while at in self.above and at != start:
            chain.append(self.above[at])
            at = self.above[at].parent
            if len(chain) > len(self.above):
                raise BadFile(
                    f"{self.where}: its joints form a loop",
                    consequence="It is not a serial arm",
                    cure="Remove the joint that closes the loop",
                )
        return chain[::-1]

    def under(self, link: str) -> Iterator[str]:
        """Yield a link and all that hangs on it, parents first."""
        order = [link]
        for at in order:  # grows while it is walked
            yield at
            order += [joint.child for joint in self.below.get(at, ())]
            if len(order) > len(self.links):
                self.to(link)  # raises: only where joints form a loop does a link hang on itself

    def uphill(self, links: Iterable[str]) -> frozenset[str]:
        """Return links and all that they hang on."""
        return frozenset(_uphill(links, self.above))

    def onwards(self, link: str) -> list[UrdfJoint]:
        """Return the joints below a link that move, or have some that move behind them."""
        return [joint for joint in self.below.get(link, ()) if joint.type != "fixed" or joint.child in self.moved]


def tree_of(joints: list[UrdfJoint], links: set[str], where: str) -> Tree:
    """Return how links hang on each other; BadFile where a link is missing or hangs on two joints."""
    above: dict[str, UrdfJoint] = {}
    below: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise BadFile(
                    f"{where}: joint {joint.name} names the link {link!r}, which is not there",
                    consequence="The arm cannot be put together",
                    cure=f'Add <link name="{link}"/>, or correct the name',
                )
        if joint.child in above:
            raise BadFile(
                f"{where}: the link {joint.child} hangs on two joints, {above[joint.child].name} and {joint.name}",
                consequence="The chain is closed, not serial",
                cure="Remove the one that is not part of the arm's chain",
            )
        above[joint.child] = joint
        below.setdefault(joint.parent, []).append(joint)
    moved = frozenset(_uphill((joint.parent for joint in joints if joint.type != "fixed"), above))
    return Tree(links=frozenset(links), above=above, below=below, moved=moved, where=where)


def _uphill(links: Iterable[str], above: Mapping[str, UrdfJoint]) -> set[str]:
    found: set[str] = set()
    for link in links:
        at: str | None = link
        while at is not None and at not in found:
            found.add(at)
            at = above[at].parent if at in above else None
    return found


def chain_of(tree: Tree, base: str | None, tip: str | None) -> tuple[str, Array, list[UrdfJoint]]:
    """Return the base's link, where the chain begins in its axes (4, 4), and the joints from there to the tip.

    Without a base it is the root, of several the one that something moves on; without a tip the end of `_chain_end`.
    A base may hang beside the chain by fixed joints, as the frame of a controller does beside that of ROS.
    """
    for link in (base, tip):
        if link is not None and link not in tree.links:
            raise BadFile(
                f"{tree.where}: has no link {link!r}",
                consequence="There is no chain to it",
                cure=f"Use one of {_listed(sorted(tree.links))}",
            )
    start = base if base is not None else _root(tree, tip)
    if tip is None:
        tip = _chain_end(start, tree) if start in tree.moved else _chain_end(_standing(start, tree), tree)
    on_the_way = {tip, *(joint.parent for joint in tree.to(tip))}
    beside: list[UrdfJoint] = []
    at = start
    while at not in on_the_way:
        joint = tree.above.get(at)
        if joint is None or joint.type != "fixed":
            raise BadFile(
                f"{tree.where}: the link {tip} does not hang on the link {start}, nor on one that it is fixed to",
                consequence="There is no chain from the one to the other",
                cure="Name as base a link between the root and the tip, or one fixed to it",
            )
        beside.insert(0, joint)
        at = joint.parent
    return start, np.asarray(np.linalg.inv(_product(beside))), tree.to(tip, at)


def _standing(link: str, tree: Tree) -> str:
    """Return the first link above one, by fixed joints, on which something moves; the link itself without one."""
    at = link
    while at not in tree.moved and at in tree.above and tree.above[at].type == "fixed":
        at = tree.above[at].parent
    return at if at in tree.moved else link


def _product(joints: list[UrdfJoint]) -> Array:
    """Return (4, 4): where the last of several joints, one behind the other and all at zero, has its link."""
    T = np.eye(4)
    for joint in joints:
        T = T @ joint.T_parent_joint
    return T


def _root(tree: Tree, tip: str | None) -> str:
    """Return the root that the tip hangs on, or the only one on which something moves."""
    if tip is not None:
        chain = tree.to(tip)
        return chain[0].parent if chain else tip
    roots = sorted(tree.links - set(tree.above))
    if not roots:
        raise BadFile(
            f"{tree.where}: has no root link: its joints form a loop",
            consequence="It is not one arm",
            cure="Remove the joint that closes the loop",
        )
    arms = [root for root in roots if root in tree.moved] if len(roots) > 1 else roots
    if len(arms) != 1:
        raise BadFile(
            f"{tree.where}: has {len(roots)} root links ({_listed(roots)})",
            consequence="Which of them the arm stands on is not known",
            cure=f"Name it with --base: {_listed(arms or roots)}",
        )
    return arms[0]


def _chain_end(start: str, tree: Tree) -> str:
    """Return the last link: along the only branch that moves, then the tool's."""
    link = start
    while onwards := tree.onwards(link):
        if len(onwards) > 1:
            tips = [
                tip
                for tip in tree.under(start)
                if tip != start and (tip not in tree.below or len(tree.onwards(tip)) > 1)
            ]
            counted = [f"{tip} ({_count(tree.to(tip, start))})" for tip in tips[:MOST_TOLD]]
            raise BadFile(
                f"{tree.where}: branches at the link {link} into {', '.join(joint.name for joint in onwards)}",
                consequence="Which of them is the arm is not known",
                cure=f"Name the last link of the chain you mean with --tip, such as {', '.join(counted)}",
            )
        link = onwards[0].child
    tool = _tool(link, tree)
    _check_beside(start, link, tool, tree)
    return tool


def _check_beside(start: str, last: str, tool: str, tree: Tree) -> None:
    """Refuse a chain whose last joint may be a finger's: where links are fixed beside it, the arm may end in those.

    A tool that is called so is one. A link in the very place of what it is fixed to is a name or a shape more for it.
    """
    joint = tree.above.get(last)
    if joint is None or last == start or any(_called(name, tool) for name in TOOL_LINKS):
        return
    if all(before.type == "fixed" for before in tree.to(joint.parent, start)):  # the arm's only joint
        return
    beside = [
        link
        for fixed in tree.below[joint.parent]
        if fixed is not joint
        for link in tree.under(fixed.child)
        if link not in tree.below and _away(tree, link, joint.parent)
    ]
    if beside:
        ends = ", ".join(f"{link} ({_count(tree.to(link, start))})" for link in [*beside[:MOST_TOLD], tool])
        raise BadFile(
            f"{tree.where}: at the link {joint.parent} the last joint, {joint.name}, leads to {tool}, and fixed beside "
            f"it {'hang' if len(beside) > 1 else 'hangs'} {_listed(beside)}",
            consequence="Whether that joint is the arm's or a finger's is not known, and the tool would be another",
            cure=f"Name the last link of the chain you mean with --tip: {ends}",
        )


def _away(tree: Tree, link: str, start: str) -> bool:
    """Tell whether a link is elsewhere than the one it is fixed to; also where its place cannot be read."""
    try:
        return bool(np.abs(_product(tree.to(link, start)) - np.eye(4)).max() >= SAME_PLACE)
    except BadFile:
        return True


def _tool(last: str, tree: Tree) -> str:
    """Return the tool's link of those fixed to the last one that moves: the end where they are one chain, else the one
    that is called so. Raises BadFile where several might be."""
    ends = [link for link in tree.under(last) if link not in tree.below]
    if len(ends) == 1:
        return ends[0]
    for name in TOOL_LINKS:
        called = [link for link in tree.under(last) if _called(name, link)]
        if len(called) == 1:
            return called[0]
    try:
        T = np.array([_product(tree.to(link, last)) for link in ends[:MOST_TOLD]])
    except BadFile:  # of one that may be none of the arm's; which, --tip says
        T = None
    if T is not None and len(ends) == len(T):
        if np.abs(T - T[0]).max() < SAME_PLACE:
            return ends[0]
        # a link in the very place of the last one is a name or a shape more for it, and no tool
        away = [link for link, one in zip(ends, T, strict=True) if np.abs(one - np.eye(4)).max() >= SAME_PLACE]
        if len(away) == 1:
            return away[0]
    raise BadFile(
        f"{tree.where}: {len(ends)} links hang on the last joint's link {last}, in different places: {_listed(ends)}",
        consequence="Which of them is the tool is not known, and poses of the one are wrong for the other",
        cure=f"Name it with --tip, such as --tip {ends[0]}",
    )


def _called(name: str, link: str) -> bool:
    return re.search(rf"(^|[^a-z0-9]){name}$", link, re.IGNORECASE) is not None


def _count(chain: list[UrdfJoint]) -> str:
    count = sum(joint.type != "fixed" for joint in chain)
    return f"{count} joint{'s' * (count != 1)}"


def _listed(names: list[str]) -> str:
    """Return names as text, the first of them where they are many."""
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return ", ".join(names[:MOST_TOLD]) + more


NO_LIMIT = 1e9
"""What a limit without end is written as: URDF has no word for it on one side."""

ENDLESS = 800.0
"""rad: beyond 127 turns (and, were it degrees, more than two) a limit is none; 1e3 to 1e16 are written."""

ENDLESS_SLIDE_M = 1e4
"""m: ten kilometres are no slide, nor ten metres in thousandths of a mm."""

Limits = tuple[float, float]


def limits_of(joints: Sequence[UrdfJoint]) -> tuple[list[Limits], list[str]]:
    """Return lower and upper of moving joints, infinite for none, and what was taken otherwise than it is written.

    0 to 0, which exporters write where nothing was filled in, is no limit. Raises BadFile for limits swapped or equal,
    in degrees, or in mm.
    """
    found: list[Limits] = []
    unset: list[str] = []
    for joint in joints:
        if joint.type == "continuous":
            found.append((-math.inf, math.inf))
            continue
        lower, upper = (_limit(joint, key) for key in ("lower", "upper"))
        if lower == upper == 0.0:
            unset.append(joint.name)
            lower, upper = -math.inf, math.inf
        if not lower < upper:
            what = "swapped" if lower > upper else "equal"
            raise BadFile(
                f"{joint.at}: its limits are {what}: lower {lower:g}, upper {upper:g}",
                consequence="The joint could not move",
                cure="Give the smaller one as lower; of a joint that stands still write type fixed",
            )
        _check_unit(joint, lower, upper)
        found.append((lower, upper))
    notes = [f"no limits of {', '.join(unset)}: written are 0 to 0"] if unset else []
    return found, notes


def _limit(joint: UrdfJoint, key: str) -> float:
    """Return one limit in rad or m; infinite beyond what is one."""
    limit = joint.element.find("limit")
    text = None if limit is None else limit.get(key)
    value = float(numbers(text, "0", 1, f"{joint.at}: {key} limit", endless=True)[0])
    return (
        math.copysign(math.inf, value)
        if abs(value) >= (ENDLESS_SLIDE_M if joint.type == "prismatic" else ENDLESS)
        else value
    )


def _check_unit(joint: UrdfJoint, lower: float, upper: float) -> None:
    """Raise BadFile for a turning joint's limits in degrees, a sliding one's in mm."""
    ends = [value for value in (lower, upper) if math.isfinite(value)]
    if joint.type == "prismatic":
        if looks_like_mm(ends):
            raise BadFile(
                f"{joint.at}: its limits {lower:g} to {upper:g} look like millimetres",
                consequence="Taken as URDF means it the joint would slide a thousand times as far",
                cure=f'Write metres: lower="{1e-3 * lower:.9g}" upper="{1e-3 * upper:.9g}"',
            )
        return
    if limits_look_like_degrees(ends):
        raise BadFile(
            f"{joint.at}: its limits {lower:g} to {upper:g} look like degrees",
            consequence="Taken as URDF means it the joint would turn many times round",
            cure=f'Write radians: lower="{math.radians(lower):.9g}" upper="{math.radians(upper):.9g}"; of a joint that '
            "turns without end write type continuous",
        )
