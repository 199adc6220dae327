# SPDX-License-Identifier: Apache-2.0
"""Chain from base to tip of a URDF, with its side branches: moving joints, merged fixed links, and omitted links.

A URDF is a tree of links. An arm is the path from base to tip, with these side branches:

* on links that move with the arm, and on a floating base: all;
* on a fixed base: those with a joint that mimics a joint of the arm.

Links beyond the tip are omitted: a scenario adds its own end effector. Joints are in depth-first order, the path before
side branches.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree as Xml

from impact_rs_sim.decimals import decimal
from impact_rs_sim.errors import InputError, did_you_mean, shortened
from impact_rs_sim.robots.robot import JointType

MOVABLE_JOINT_TYPES: dict[str, JointType] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
URDF_JOINT_TYPES = (*MOVABLE_JOINT_TYPES, "fixed", "planar", "floating")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
XACRO_COMMAND = "xacro {file} > robot.urdf"
WORLD = "world"  # implicit ground link of simulators, which the file may lack
KEPT_ELEMENTS = ("origin", "parent", "child", "axis", "inertial")  # needed for rigid-body dynamics; no meshes
MAX_MESSAGE_LENGTH = 1000  # characters; a large arm has many links to list
UNIQUE_ELEMENTS = {  # children that an element has at most once; parsers differ in which of two they use
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}


@dataclass(frozen=True)
class Chain:
    """The chain from base to tip, with its side branches.

    Attributes:
        file: The URDF.
        base: Base link.
        tip: Link whose frame is the flange.
        joints: Movable joints, depth first; at a fork path, side branches, and joints that mimic others.
        side_joints: Movable joints in side branches.
        merged: Links with mass that are fixed to a moving link, on the path or in a side branch.
        left_out: Links beyond the tip.
        dynamics: Joints with damping or friction in the file.
        urdf: URDF of base, path and side branches, without shapes; every moving joint is revolute or prismatic.
    """

    file: Path
    base: str
    tip: str
    joints: tuple[Xml.Element, ...]
    side_joints: tuple[Xml.Element, ...]
    merged: tuple[str, ...]
    left_out: tuple[str, ...]
    dynamics: tuple[str, ...]
    urdf: str


class UrdfTree:
    """Links and joints of a URDF file.

    Attributes:
        file: The URDF.
        links: Links by name.
        above: The joint that carries a link, by the link's name.
        below: Joints that a link carries.
        root: The link that no joint carries.
        notes: Assumptions made while reading.

    Args:
        file: The URDF.

    Raises:
        InputError: The file cannot be read, is xacro, or is no URDF of one tree.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        robot = _parse(file)
        self.links = self._named(robot, "link")
        joints = self._named(robot, "joint")
        if not self.links:
            self._fail("there is no link in it")
        self.notes: list[str] = []
        if WORLD not in self.links and any(_parent(joint) == WORLD for joint in joints.values()):
            self.links[WORLD] = Xml.Element("link", name=WORLD)
            self.notes.append(f"The URDF has no link {WORLD!r}, on which joints hang: it is taken for the ground.")
        for kind, elements in (("link", self.links), ("joint", joints)):
            for name, element in elements.items():
                self._check_once(element, f"{kind} {name}")
        self.above: dict[str, Xml.Element] = {}  # the joint that carries a link
        self.below: dict[str, list[Xml.Element]] = {name: [] for name in self.links}
        for name, joint in joints.items():
            if joint.get("type") not in URDF_JOINT_TYPES:
                self._fail(
                    f"unknown type {joint.get('type')!r}; expected one of {', '.join(URDF_JOINT_TYPES)}",
                    f"joint {name}",
                )
            parent, child = self._end(joint, "parent"), self._end(joint, "child")
            if child in self.above:
                self._fail(f"link {child!r} hangs on joint {self.above[child].get('name')!r} as well", f"joint {name}")
            self.above[child] = joint
            self.below[parent].append(joint)
        roots = [name for name in self.links if name not in self.above]
        if len(roots) != 1:
            self._fail(f"expected one tree of links; links that hang on no joint: {', '.join(roots) or 'none'}")
        (self.root,) = roots
        astray = sorted(set(self.links) - {self.root, *self._everything_below(self.root)})
        if astray:
            self._fail(f"expected one tree of links; these hang on each other in a ring: {', '.join(astray)}")

    def chain(self, base: str | None = None, tip: str | None = None, floating: bool = False) -> Chain:
        """The path from ``base`` (default: the root) to ``tip`` (default: the only one), with its side branches.

        Args:
            base: Its first link.
            tip: Its last link.
            floating: Whether the base moves freely; branches on it are then included, and no joint need move.

        Raises:
            InputError: No such path, several tips, or a joint that is neither revolute nor prismatic.
        """
        start = self.root if base is None else self._link(base, "--base")
        end = self._only_tip(start) if tip is None else self._link(tip, "--tip")
        path = self.path(start, end)
        moved_joints = (
            path if floating else path[next((i for i, joint in enumerate(path) if _moves(joint)), len(path)) :]
        )
        if not moved_joints and not floating:
            self._fail(f"no joint moves between {start!r} and {end!r}; expected at least one that turns or slides")
        carriers = [child_of(joint) for joint in moved_joints[:-1]]
        if floating:
            carriers = [start, *carriers]
        side_joints = [joint for carrier in carriers for joint in self._side_branches(carrier, path)]
        if not floating:
            still_links = [start, *(child_of(joint) for joint in path[: -len(moved_joints)])]
            side_joints += self._following_branches(
                still_links, path, {_name(joint) for joint in (*moved_joints, *side_joints)}
            )
        kept_joints = list(self._depth_first(start, [*path, *side_joints], path))
        joints = tuple(joint for joint in kept_joints if _moves(joint))
        for joint in joints:
            self._check(joint)
        fixed = (child_of(joint) for joint in (*moved_joints, *side_joints) if not _moves(joint))
        return Chain(
            file=self.file,
            base=start,
            tip=end,
            joints=joints,
            side_joints=tuple(joint for joint in joints if joint in side_joints),
            merged=tuple(link for link in fixed if self.links[link].find("inertial") is not None),
            left_out=() if floating and start == end else tuple(self._everything_below(end)),
            dynamics=tuple(_name(joint) for joint in joints if _has_losses(joint)),
            urdf=self._pruned(start, kept_joints),
        )

    def path(self, base: str, tip: str) -> list[Xml.Element]:
        """Joints from link ``base`` to link ``tip``, fixed ones as well.

        Raises:
            InputError: No chain of joints leads there.
        """
        path: list[Xml.Element] = []
        link = tip
        while link != base:
            if link not in self.above:
                self._fail(
                    f"no chain leads from {base!r} to {tip!r}; expected a tip below the base in the tree of links"
                )
            path.insert(0, self.above[link])
            link = self._end(self.above[link], "parent")
        return path

    def mimic(self, joint: Xml.Element, independent: Container[str] = ()) -> tuple[str, float, float] | None:
        """The independent joint that a joint follows, directly or not, ratio and offset; None: it is independent.

        Args:
            joint: The joint.
            independent: Names of joints that are independent even if the file makes them follow another.

        Raises:
            InputError: It follows an unknown joint, or joints follow each other.
        """
        ratio, offset, name, passed = 1.0, 0.0, _name(joint), [_name(joint)]
        joints = {_name(other_joint): other_joint for other_joint in self.above.values()}
        while name not in independent and (element := joints[name].find("mimic")) is not None:
            key = f"joint {passed[0]}: mimic"
            (factor,) = self.numbers(element, "multiplier", 1, "1", f"{key} multiplier")
            (shift,) = self.numbers(element, "offset", 1, "0", f"{key} offset")
            ratio, offset, name = ratio * factor, offset + ratio * shift, element.get("joint", "")
            if name not in joints or name in passed:
                self._fail(f"it follows {name!r}, expected another joint that moves by itself in the end", key)
            passed.append(name)
        return None if len(passed) == 1 else (name, ratio, offset)

    def numbers(
        self, element: Xml.Element | None, attribute: str, count: int, default: str | None, key: str
    ) -> list[float]:
        """Numbers in an attribute.

        Args:
            element: Element with the attribute; None: the element is absent.
            attribute: Name of the attribute.
            count: Number of numbers.
            default: Value of an absent attribute; None: it is required.
            key: Key in an error.

        Raises:
            InputError: It is absent, or does not hold ``count`` finite numbers.
        """
        text = default if element is None else element.get(attribute, default)
        if text is None:
            self._fail("this is missing in the URDF, expected a number", key)
        try:
            values = [decimal(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            self._fail(f"expected {count} finite number{'s' if count > 1 else ''}, found {text!r}", key)
        return values

    def _fail(self, message: str, key: str | None = None) -> NoReturn:
        raise InputError(shortened(message, MAX_MESSAGE_LENGTH), file=self.file, key=key)

    def _named(self, robot: Xml.Element, kind: str) -> dict[str, Xml.Element]:
        elements: dict[str, Xml.Element] = {}
        for element in robot.findall(kind):
            name = element.get("name")
            if not name:
                self._fail(f"a {kind} has no name")
            if name in elements:
                self._fail(f"there are two {kind}s of this name", f"{kind} {name}")
            elements[name] = element
        return elements

    def _check_once(self, element: Xml.Element, key: str) -> None:
        """Check that unique elements occur once."""
        for part in element:
            self._check_once(part, key)
        for tag in UNIQUE_ELEMENTS.get(element.tag, ()):
            if len(element.findall(tag)) > 1:
                self._fail(f"<{element.tag}> has {len(element.findall(tag))} <{tag}>, expected one", key)

    def _end(self, joint: Xml.Element, which: str) -> str:
        element = joint.find(which)
        link = None if element is None else element.get("link")
        if link is None or link not in self.links:
            self._fail(f"its {which} is {link!r}, expected a link of this file", f"joint {_name(joint)}")
        return link

    def _link(self, name: str, option: str) -> str:
        if name not in self.links:
            names = ", ".join(self.links)
            self._fail(f"no link {name!r} for {option}{did_you_mean(name, self.links)}; it has: {names}")
        return name

    def _only_tip(self, base: str) -> str:
        tips = list(self._tips(base, moves=False))
        if not tips:
            self._fail(f"no joint moves below {base!r}; expected at least one that turns or slides")
        if len(tips) > 1:
            self._fail(f"the tree has several tips; expected one of them with --tip: {', '.join(tips)}")
        return tips[0]

    def _tips(self, link: str, moves: bool) -> Iterator[str]:
        """Leaf links that move relative to ``link``."""
        if moves and not self.below[link]:
            yield link
        for joint in self.below[link]:
            yield from self._tips(child_of(joint), moves or joint.get("type") != "fixed")

    def _check(self, joint: Xml.Element) -> None:
        key = f"joint {_name(joint)}"
        kind = joint.get("type")
        if kind not in MOVABLE_JOINT_TYPES:
            free = f", or --base {child_of(joint)} --floating" if kind == "floating" else ""
            types = ", ".join(MOVABLE_JOINT_TYPES)
            self._fail(f"this joint of the chain is {kind}; expected one of {types}{free}", key)

    def _side_branches(self, link: str, path: list[Xml.Element]) -> Iterator[Xml.Element]:
        """Joints of the side branches of ``link``."""
        for joint in self.below[link]:
            if joint not in path:
                yield joint
                yield from self._side_branches(child_of(joint), path)

    def _following_branches(
        self, links: list[str], path: list[Xml.Element], leaders: set[str]
    ) -> Iterator[Xml.Element]:
        """Joints of those side branches of ``links`` in which a joint follows one of ``leaders``."""
        for joint in (other_joint for link in links for other_joint in self.below[link] if other_joint not in path):
            branch = [joint, *self._side_branches(child_of(joint), path)]
            if any(_moves(other_joint) and (self.mimic(other_joint) or ("",))[0] in leaders for other_joint in branch):
                yield from branch

    def _depth_first(self, link: str, kept_joints: list[Xml.Element], path: list[Xml.Element]) -> Iterator[Xml.Element]:
        """Joints below ``link`` branch by branch: first along the path, last those that follow another."""
        carried = [joint for joint in self.below[link] if joint in kept_joints]
        for joint in sorted(
            carried, key=lambda candidate: (candidate not in path, candidate.find("mimic") is not None)
        ):
            yield joint
            yield from self._depth_first(child_of(joint), kept_joints, path)

    def _everything_below(self, link: str) -> Iterator[str]:
        for joint in self.below[link]:
            yield child_of(joint)
            yield from self._everything_below(child_of(joint))

    def _pruned(self, base: str, joints: list[Xml.Element]) -> str:
        robot = Xml.Element("robot", name="arm")
        for name in (base, *(child_of(joint) for joint in joints)):
            link = Xml.SubElement(robot, "link", name=name)
            link.extend(copy.deepcopy(part) for part in self.links[name] if part.tag in KEPT_ELEMENTS)
        for joint in joints:
            kind = joint.get("type", "")
            copied = Xml.SubElement(robot, "joint", name=_name(joint), type=MOVABLE_JOINT_TYPES.get(kind, kind))
            copied.extend(copy.deepcopy(part) for part in joint if part.tag in KEPT_ELEMENTS)
            if kind != "fixed":  # the real limits are read elsewhere; without any the joint would have two coordinates
                Xml.SubElement(copied, "limit", lower="-1", upper="1", velocity="1", effort="1")
        return Xml.tostring(robot, encoding="unicode")


def _parse(file: Path) -> Xml.Element:
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=file) from None
    xacro = InputError(
        f"this is xacro, expected URDF; expand it first: {XACRO_COMMAND.format(file=file.name)}", file=file
    )
    if file.suffix == ".xacro" or "<xacro:" in COMMENT.sub("", text):
        raise xacro
    try:
        robot = Xml.fromstring(text)
    except Xml.ParseError as error:
        raise InputError(f"not valid XML: {error}", file=file) from None
    if robot.tag != "robot":
        raise InputError(f"the outermost element is <{robot.tag}>, expected <robot>", file=file)
    # Sections on controllers and transmissions are not read, and makers leave expressions in them.
    read = [element for part in robot if part.tag in ("link", "joint") for element in part.iter()]
    if any("${" in value for element in read for value in element.attrib.values()):
        raise xacro
    return robot


def _name(element: Xml.Element) -> str:
    return element.get("name", "")


def _moves(joint: Xml.Element) -> bool:
    return joint.get("type") != "fixed"


def _parent(joint: Xml.Element) -> str | None:
    parent = joint.find("parent")
    return None if parent is None else parent.get("link")


def child_of(joint: Xml.Element) -> str:
    """Link that a joint carries; empty: it says none."""
    child = joint.find("child")
    return "" if child is None else child.get("link", "")


def _has_losses(joint: Xml.Element) -> bool:
    dynamics = joint.find("dynamics")
    return dynamics is not None and any(dynamics.get(name, "0").strip("0.") for name in ("damping", "friction"))
