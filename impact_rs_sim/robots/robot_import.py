# SPDX-License-Identifier: Apache-2.0
"""Robot facts from a URDF.

In robot facts every joint rotates about its own +z or translates along it. A URDF allows any axis a_i in the frame of
the child link. With a rotation R_i that maps z to a_i, the frame of that link is changed:

    T'_i = (R_{i-1}^T, 0) T_i (R_i, 0)          Rot(a_i, q) R_i = R_i Rot(z, q),  Trans(a_i q) R_i = R_i Trans(z q)
    c'_i = R_i^T c_i                            I'_i = R_i^T I_i R_i

so that kinematics and dynamics are exactly those of the URDF. R_i is the smallest such rotation, and the identity if
the axis is z; i-1 is the link that carries joint i. Pinocchio reads placements and inertias, and merges fixed links.

Joints beside the path from base to tip (fingers, a second arm, a head) are fixed, unless the user lets them move
(``--move``). A joint that mimics another one moves if that one moves.
"""

from __future__ import annotations

import fnmatch
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.robots.mesh_files import FILE, PACKAGE, mesh_address, mesh_path
from impact_rs_sim.robots.robot import (
    BASE,
    UNITS,
    Array,
    Flange,
    Inertial,
    JointOrigin,
    JointType,
    Limits,
    Link,
    Mesh,
    Mimic,
    RobotFacts,
)
from impact_rs_sim.robots.urdf_chain import MOVABLE_JOINT_TYPES, Chain, UrdfTree, child_of
from impact_rs_sim.robots.urdf_repairs import Limits as GivenLimits
from impact_rs_sim.robots.urdf_repairs import about_centre, given_limits, locked_joints, suspected_steiner_ratio
from impact_rs_sim.schema import parse_yaml, validate

FULL_TURN_RAD = 2.0 * math.pi  # to either side; the range of a joint without position limits
TYPE_ENTRY: dict[JointType, str] = {"revolute": "", "prismatic": "type: prismatic, "}  # in the file of robot facts
NOT_IN_URDF_NOTE = (
    "A URDF does not say whether joints measure their torque behind the gears. Most do not, so joint_torque_loop is "
    "false: torques are taken for those of the motors. Arms that do, as Franka, KUKA LBR and Kinova Gen3, need true."
)
NEGATIVE_MOMENT_TOLERANCE = 1e-6  # over the largest moment, for the rounding of a flat body in a URDF [-]
FREE_FLYER = "free flyer of the base"  # Pinocchio's own name, root_joint, may be one of the file's joints
_FoundMesh = tuple[str, pin.SE3, list[float]]  # address, placement at the joint and scale
INERTIA_ATTRIBUTES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class ImportedRobot:
    """Robot facts from a URDF, and notes on what was merged, omitted or assumed.

    Attributes:
        facts: The facts.
        joints: Names of the joints in the URDF, base to tip.
        notes: Notes for the user: merged and omitted links, assumed limits.
    """

    facts: RobotFacts
    joints: tuple[str, ...]
    notes: tuple[str, ...]


def import_urdf(
    file: Path,
    base: str | None = None,
    tip: str | None = None,
    source: str | None = None,
    limits: Sequence[str] = (),
    inertia_at: Literal["centre", "joint"] = "centre",
    lock: Sequence[str] = (),
    measured: Callable[[Sequence[str]], GivenLimits] = lambda _: {},
    packages: Sequence[Path] = (),
    move: Sequence[str] = (),
    floating: bool = False,
    hands: Sequence[str] = (),
) -> ImportedRobot:
    """Facts of the robot that hits with link ``tip`` of a URDF and is mounted with link ``base``.

    Args:
        file: The URDF; missing meshes are listed in the notes.
        base: Link with which the arm is mounted; None: the root.
        tip: Link whose frame is the flange; None: the only leaf of the tree.
        source: Source of the numbers; None: the file's name.
        limits: Limits that replace those of the URDF (:func:`~impact_rs_sim.robots.urdf_repairs.given_limits`).
        inertia_at: Reference point of the moments of inertia: the centre of mass, as in the URDF format, or the joint.
        lock: Positions at which joints are locked (:func:`~impact_rs_sim.robots.urdf_repairs.locked_joints`).
        measured: Function from joint names to limits in a recording, which replace limits that are missing or 0.
        packages: Folders of mesh packages (:func:`~impact_rs_sim.robots.mesh_files.mesh_address`).
        move: Names of joints beside the path that move as well; ``*`` matches any text.
        floating: Whether the base floats.
        hands: Links whose frames are further flanges; a hand has the name of its link.

    Raises:
        InputError: The file is no URDF, has no such chain, or lacks a number that is needed.
    """
    tree = UrdfTree(file)
    movable = list(_movable(tree).values())
    positions = _locked_positions(tree, lock)
    notes = [*tree.notes, *_locked_notes(tree, positions)]
    _fix_joints(tree, positions)
    still = _still_joints(tree, tree.chain(base, tip, floating), move, positions)
    _fix_joints(tree, still)
    chain = tree.chain(base, tip, floating)
    _check_inertials(tree, chain)
    notes += [*_still_note(tree, still), *_recentred_inertias(tree, chain, movable, inertia_at)]
    chain = tree.chain(base, tip, floating)
    moving = [joint for joint in chain.joints if tree.mimic(joint) is None]
    names = [joint.get("name", "") for joint in moving]
    given_by_user, measured_limits = given_limits(limits, names, file), measured(names)
    model = _model(chain, floating)
    meshes = _meshes(tree, chain, model, packages, notes)
    joints, links, (flange, *hand_flanges) = _bodies(tree, chain, model, meshes, hands)
    rows = {joint.get("name", ""): _limits(tree, joint, given_by_user, measured_limits, notes) for joint in moving}
    notes += _narrow_limits(tree, chain.joints, rows, given_by_user)
    columns = [tuple(row[column] for row in rows.values()) for column in range(len(Limits.model_fields))]
    base_meshes = meshes.get(int(floating), [])
    content = {
        "source": source or f"imported from {file.name}",
        "joints": tuple(joints),
        "flange": flange,
        "hands": tuple(
            {"name": name, **dict(hand_flange)} for name, hand_flange in zip(hands, hand_flanges, strict=True)
        ),
        "limits": dict(zip(Limits.model_fields, columns, strict=True)),
        "links": tuple(links),
        "floating_base": _body(tree, model.inertias[1], np.eye(3), chain.base) if floating else None,
        "base_meshes": tuple(_mesh(mesh, np.eye(3)) for mesh in base_meshes),
        "joint_torque_loop": False,
    }
    facts = validate(RobotFacts, content, file)
    return ImportedRobot(facts, tuple(names), (*_notes(chain), *notes, *_missing_meshes(facts), NOT_IN_URDF_NOTE))


def _model(chain: Chain, floating: bool) -> pin.Model:
    """Pinocchio's model of the chain, with an independent coordinate for every joint."""
    try:
        return pin.buildModelFromXML(chain.urdf, *([pin.JointModelFreeFlyer(), FREE_FLYER] if floating else []))
    except ValueError as error:
        raise InputError(f"Pinocchio does not read it: {error}", file=chain.file) from None


def _bodies(
    tree: UrdfTree, chain: Chain, model: pin.Model, meshes: Mapping[int, list[_FoundMesh]], hands: Sequence[str]
) -> tuple[list[JointOrigin], list[Link], list[Flange]]:
    """Joints, links, and the flanges at tip and hands, in the frames of robot facts."""
    joints: list[JointOrigin] = []
    links: list[Link] = []
    names = [joint.get("name", "") for joint in chain.joints]
    joint_ids = [model.getJointId(name) for name in names]
    numbers = {joint_id: number for number, joint_id in enumerate(joint_ids, start=1)}  # others are the base
    turns = [np.eye(3), *(frame_of_axis(np.array(_axis(tree, joint))) for joint in chain.joints)]
    simple = not any(tree.mimic(joint) for joint in chain.joints) and not chain.side_joints
    flanges: list[Flange] = []
    for number, (joint, joint_id) in enumerate(zip(chain.joints, joint_ids, strict=True), start=1):
        carrier = numbers.get(model.parents[joint_id], 0)
        placement, turn, carrier_turn = model.jointPlacements[joint_id], turns[number], turns[carrier]
        origin: dict[str, object] = {"type": _type(joint)}
        origin |= _placement(carrier_turn.T @ placement.translation, carrier_turn.T @ placement.rotation @ turn)
        if not simple:
            origin["name"] = joint.get("name", "")
        if carrier != number - 1:
            origin["parent"] = links[carrier - 1].name if carrier else BASE
        if (mimic := tree.mimic(joint)) is not None:
            origin["mimic"] = dict(zip(Mimic.model_fields, mimic, strict=True))
        joints.append(JointOrigin.model_validate(origin))
        name = f"moving_{BASE}" if child_of(joint) == BASE else child_of(joint)  # robot facts call the base so
        links.append(_link(tree, model.inertias[joint_id], turn, meshes.get(joint_id, []), name))
    for name in (chain.tip, *hands):
        if not model.existFrame(name, pin.FrameType.BODY):
            raise InputError(
                f"no link {name!r} among the kept ones{did_you_mean(name, tree.links)}; expected one that --move "
                "lets move",
                file=chain.file,
                key="--hand",
            )
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        carrier = numbers.get(frame.parentJoint, 0)
        carrier_turn = turns[carrier]
        placement_in_link = _placement(
            carrier_turn.T @ frame.placement.translation, carrier_turn.T @ frame.placement.rotation
        )
        link = "" if carrier == len(links) else links[carrier - 1].name if carrier else BASE
        flanges.append(Flange.model_validate({**placement_in_link, "link": link}))
    return joints, links, flanges


def frame_of_axis(axis: Array) -> Array:
    """Smallest rotation that maps z to the unit vector ``axis`` ``(3,)``; pi about x for -z, ``(3, 3)``."""
    half_turn = np.diag([1.0, -1.0, -1.0])
    if axis[2] < 0.0:  # from -z, because from z the formula ends there
        return _smallest_rotation(np.array([0.0, 0.0, -1.0]), axis) @ half_turn
    return _smallest_rotation(np.array([0.0, 0.0, 1.0]), axis)


def _smallest_rotation(start: Array, end: Array) -> Array:
    """Rodrigues: I + [v] + [v]^2 / (1 + c) with v = start x end and c = start . end."""
    cross = pin.skew(np.cross(start, end))
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + start @ end))


def facts_text(robot: ImportedRobot, title: str) -> str:
    """The YAML file of the facts, with comments on data that a URDF lacks.

    Args:
        robot: The imported robot.
        title: First comment line.
    """
    facts, limits = robot.facts, robot.facts.limits
    slides, empty = "prismatic" in facts.joint_types, "" if facts.joints else " []"
    lines = [f"# {title}"]
    lines += [f"# {note}" for note in robot.notes]
    lines += [
        "# A URDF does not say how the joints are driven. A scenario does, with one entry per joint:",
        "#   robots.NAME.drive.motor_inertia_rotor    B_rho, rotor inertia times gear ratio squared [kg m^2]",
        "#   robots.NAME.drive.motor_inertia_reduced  B_theta that a torque loop leaves; not for drive.type rigid",
        "#   robots.NAME.drive.stiffness, .damping    of the joints [N m/rad, N m s/rad]",
        *(["# Of prismatic joints all of them, and the limits below, are in kg, N, m and s."] if slides else []),
        "#   robots.NAME.drive.friction               none, or identified with a section friction: in this file",
        f"source: {json.dumps(facts.source, ensure_ascii=False)}",
        "joint_torque_loop: false   # ASSUMED, a URDF does not say; true where joints have torque sensors",
        f"joints:{empty}   # origin of joint i in link i-1 [m], roll-pitch-yaw [rad]; every axis is +z",
    ]
    names = iter(robot.joints)
    lines += [
        f"  - {{{TYPE_ENTRY[origin.type]}xyz: {_row(origin.xyz)}, rpy: {_row(origin.rpy)}{_place_in_tree(origin)}}}"
        f"  # {origin.name if origin.mimic else next(names)}"
        for origin in facts.joints
    ]
    lines.append(f"flange: {{{_flange_text(facts.flange)}}}")
    if facts.hands:
        lines.append("hands:    # further flanges with pads, which may hit at once")
        lines += [f"  - {{name: {_text(hand.name)}, {_flange_text(hand)}}}" for hand in facts.hands]
    lines.append("limits:")
    lines += [f"  {name}: {_row(getattr(limits, name))}" for name in Limits.model_fields]
    lines.append(f"links:{empty}    # mass [kg], com [m], inertia [ixx, ixy, ixz, iyy, iyz, izz] [kg m^2]")
    lines += [f"  - {_link_row(link)}" for link in facts.links]
    if facts.floating_base is not None:
        lines.append(f"floating_base: {{{_body_text(facts.floating_base)}}}")
    if facts.base_meshes:
        lines.append(f"base_meshes: {_mesh_rows(facts.base_meshes)}")
    return "\n".join(lines) + "\n"


def _flange_text(flange: Flange) -> str:
    """Keys of a flange."""
    rpy = f", rpy: {_row(flange.rpy)}" if any(flange.rpy) else ""
    return f"xyz: {_row(flange.xyz)}{rpy}" + (f", link: {_text(flange.link)}" if flange.link else "")


def _place_in_tree(joint: JointOrigin) -> str:
    """Keys of a joint of a tree."""
    entries = [f"{key}: {_text(getattr(joint, key))}" for key in ("name", "parent") if getattr(joint, key)]
    if (mimic := joint.mimic) is not None:
        numbers = f"ratio: {_number(mimic.ratio)}, offset: {_number(mimic.offset)}"
        entries.append(f"mimic: {{joint: {_text(mimic.joint)}, {numbers}}}")
    return "".join(f", {entry}" for entry in entries)


def _link_row(link: Link) -> str:
    return f"{{name: {_text(link.name)}, {_body_text(link)}{_shown(link.meshes)}}}"


def _body_text(body: Inertial) -> str:
    return f"mass: {_number(body.mass)}, com: {_row(body.com)}, inertia: {_row(body.inertia)}"


def _text(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _shown(meshes: Sequence[Mesh]) -> str:
    return f", meshes: {_mesh_rows(meshes)}" if meshes else ""


def _mesh_rows(meshes: Sequence[Mesh]) -> str:
    rows = (
        f"{{file: {json.dumps(mesh.file)}, xyz: {_row(mesh.xyz)}, rpy: {_row(mesh.rpy)}, scale: {_row(mesh.scale)}}}"
        for mesh in meshes
    )
    return f"[{', '.join(rows)}]"


def save_facts(robot: ImportedRobot, title: str, path: Path) -> None:
    """Write the facts into a new file that :func:`impact_rs_sim.robots.robot.load_facts` reads back.

    Raises:
        InputError: The file exists, cannot be written, or is not called ``.yaml``.
    """
    if path.suffix != ".yaml":
        raise InputError("expected a name that ends in .yaml, as scenarios name it", file=path)
    text = facts_text(robot, title)
    validate(RobotFacts, parse_yaml(text, path), path)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(text, encoding="utf-8")
        os.link(unfinished, path)  # whole or not at all, and never over another file
    except OSError as error:
        if path.exists():
            raise InputError("this file exists already; robot facts are never overwritten", file=path) from None
        reason = error.strerror if path.parent.is_dir() else f"{path.parent} is no folder ({error.strerror})"
        raise InputError(f"cannot be written: {reason}", file=path) from None
    finally:
        with suppress(OSError):  # it may not be there
            unfinished.unlink()


def _check_inertials(tree: UrdfTree, chain: Chain) -> None:
    """Refuse an <inertial> that Pinocchio would misread: incomplete, invalid numbers, negative moments."""
    robot = Xml.fromstring(chain.urdf)
    wrong = []
    for link in robot.findall("link"):
        key = f"link {link.get('name')}"
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass = tree.numbers(inertial.find("mass"), "value", 1, None, f"{key}: inertial mass")
        if mass[0] < 0.0:
            raise InputError(f"expected >= 0 [kg], found {mass[0]:g}", file=tree.file, key=f"{key}: inertial mass")
        tensor = inertial.find("inertia")
        entries = [tree.numbers(tensor, entry, 1, None, f"{key}: inertia {entry}")[0] for entry in INERTIA_ATTRIBUTES]
        wrong += [f"{key} has {moment}" for moment in _negative_moments(entries)]
    if wrong:
        raise InputError(f"moments of inertia of bodies are positive, but {'; '.join(wrong)}", file=tree.file)
    for element in robot:
        for origin in element.iter("origin"):
            for attribute in ("xyz", "rpy"):
                key = f"{element.tag} {element.get('name')}: origin {attribute}"
                tree.numbers(origin, attribute, 3, "0 0 0", key)


def _negative_moments(entries: Sequence[float]) -> list[str]:
    """Moments below 0 of a tensor ixx, ixy, ixz, iyy, iyz, izz [kg m^2], each with its axis."""
    diagonal = dict(zip("xyz", (entries[0], entries[3], entries[5]), strict=True))
    texts = [f"i{axis}{axis} = {moment:.3g} kg m^2" for axis, moment in diagonal.items() if moment < 0.0]
    upper = np.zeros((3, 3))
    upper[np.triu_indices(3)] = entries
    moments, axes = np.linalg.eigh(upper + np.triu(upper, 1).T)
    if not texts and moments[0] < -NEGATIVE_MOMENT_TOLERANCE * moments[2]:
        axis = ", ".join(f"{value:.2f}" for value in axes[:, 0])
        texts.append(f"a principal moment of {moments[0]:.3g} kg m^2 about ({axis})")
    return texts


def _axis(tree: UrdfTree, joint: Xml.Element) -> Array:
    key = f"joint {joint.get('name')}: axis"
    axis = np.array(tree.numbers(joint.find("axis"), "xyz", 3, "1 0 0", key))  # the default of the URDF format
    largest = float(np.max(np.abs(axis)))
    if largest < 1e-6:
        raise InputError("expected a direction, found a vector of length 0", file=tree.file, key=key)
    axis = axis / largest  # squares of huge numbers have no room
    return np.asarray(axis / np.linalg.norm(axis))


def _origin(tree: UrdfTree, joint: Xml.Element) -> list[float]:
    return tree.numbers(joint.find("origin"), "xyz", 3, "0 0 0", f"joint {joint.get('name')}: origin xyz")


def _type(joint: Xml.Element) -> JointType:
    return MOVABLE_JOINT_TYPES[joint.get("type", "")]


def _limits(
    tree: UrdfTree, joint: Xml.Element, user_limits: GivenLimits, measured_limits: GivenLimits, notes: list[str]
) -> tuple[float, float, float, float]:
    """Position limits, velocity and effort of a joint, in its units; adds notes on limits that are not of the URDF."""
    units, name = UNITS[_type(joint)], joint.get("name", "")
    limit, key = joint.find("limit"), f"joint {name}: limit"
    remedy = f"--limits {name}."
    if (name, "position") in user_limits:
        lower, upper = user_limits[name, "position"]
        notes.append(f"Limits of joint {name} as given: {lower:g} to {upper:g} {units.position}.")
    elif joint.get("type") == "continuous":
        lower, upper = -FULL_TURN_RAD, FULL_TURN_RAD
    else:
        (lower,), (upper,) = (tree.numbers(limit, end, 1, "0", f"{key} {end}") for end in ("lower", "upper"))
        if lower == upper == 0.0 and (name, "position") in measured_limits:
            lower, upper = measured_limits[name, "position"]
            notes.append(f"Limits of joint {name} as measured: {lower:g} to {upper:g} {units.position}.")
    if lower >= upper:
        message = f"expected lower < upper [{units.position}], found {lower:g} and {upper:g}; {remedy}position=LOW:HIGH"
        raise InputError(f"{message} gives it, or --measured RECORDING", file=tree.file, key=key)
    maxima = []
    for quantity, unit in (("velocity", units.velocity), ("effort", units.effort)):
        missing = limit is None or limit.get(quantity) is None
        value = 0.0 if missing else tree.numbers(limit, quantity, 1, None, f"{key} {quantity}")[0]
        if (name, quantity) in user_limits:
            (value,) = user_limits[name, quantity]
            notes.append(f"{quantity.capitalize()} limit of joint {name} as given: {value:g} {unit}.")
        elif value == 0.0 and (name, quantity) in measured_limits:
            (value,) = measured_limits[name, quantity]
            notes.append(f"{quantity.capitalize()} limit of joint {name} as measured: {value:g} {unit}.")
        if value <= 0.0:
            problem = (
                "this is missing in the URDF, expected a number"
                if missing
                else f"expected > 0 [{unit}], found {value:g}"
            )
            message = f"{problem}; {remedy}{quantity}=MOST gives it, or --measured RECORDING"
            raise InputError(message, file=tree.file, key=f"{key} {quantity}")
        maxima.append(value)
    return lower, upper, maxima[0], maxima[1]


def _narrow_limits(
    tree: UrdfTree,
    joints: Iterable[Xml.Element],
    rows: dict[str, tuple[float, float, float, float]],
    user_limits: GivenLimits,
) -> Iterable[str]:
    """Narrow limits in ``rows`` so that following joints keep theirs, and yield notes; limits of the user stay."""
    for joint in joints:
        limit, mimic, name = joint.find("limit"), tree.mimic(joint), joint.get("name", "")
        if limit is None or mimic is None or mimic[1] == 0.0:
            continue
        leader, ratio, offset = mimic
        lower, upper, fastest, effort = rows[leader]
        limits = [
            tree.numbers(limit, key, 1, "0", f"joint {name}: limit {key}")[0] for key in ("lower", "upper", "velocity")
        ]
        leader_low, leader_high = sorted((end - offset) / ratio for end in limits[:2])
        if limits[0] < limits[1] and joint.get("type") != "continuous" and (leader, "position") not in user_limits:
            if max(lower, leader_low) < min(upper, leader_high):
                lower, upper = max(lower, leader_low), min(upper, leader_high)
            else:
                yield f"Position limits of joint {name} are left out: {leader}, which it follows, is never in them."
        if limits[2] > 0.0 and (leader, "velocity") not in user_limits:
            fastest = min(fastest, limits[2] / abs(ratio))
        if (lower, upper, fastest, effort) != rows[leader]:
            yield f"Limits of joint {leader} are narrowed by the limits of {name}, which follows it."
        rows[leader] = lower, upper, fastest, effort


def _movable(tree: UrdfTree) -> dict[str, Xml.Element]:
    """Joints that turn or slide, by name."""
    return {joint.get("name", ""): joint for joint in tree.above.values() if joint.get("type") in MOVABLE_JOINT_TYPES}


def _locked_positions(tree: UrdfTree, lock: Sequence[str]) -> dict[str, float]:
    """Positions of joints that the user locks, and of joints that follow them [rad, m]."""
    movable = _movable(tree)
    positions = locked_joints(lock, list(movable), tree.file)
    for name, position in positions.items():
        low, high = _range(tree, movable[name])
        if not low <= position <= high:
            unit = UNITS[_type(movable[name])].position
            raise InputError(
                f"joint {name} is held at {position:g} {unit}, expected {low:g} to {high:g} {unit}, its limits",
                file=tree.file,
                key="--lock",
            )
    for name, joint in movable.items():
        if (mimic := tree.mimic(joint, positions)) is not None and mimic[0] in positions:
            positions[name] = mimic[1] * positions[mimic[0]] + mimic[2]
    return positions


def _still_joints(tree: UrdfTree, chain: Chain, move: Sequence[str], locked: Mapping[str, float]) -> dict[str, float]:
    """Positions of the joints beside the path that do not move [rad, m].

    They are at 0, or at the limit nearest to it; joints that follow them are where these positions put them.
    """
    chain_joints = {joint.get("name", ""): joint for joint in chain.joints}
    side_joints = [joint.get("name", "") for joint in chain.side_joints]
    moving = set()
    for pattern in move:
        matching = fnmatch.filter(side_joints, pattern)
        if not matching:
            near = did_you_mean(pattern, side_joints)
            message = f"no joint {pattern!r} moves beside the path to the tip and with the robot{near}; those that do: "
            raise InputError(f"{message}{', '.join(side_joints) or 'none'}", file=tree.file, key="--move")
        moving |= {name for name in matching if tree.mimic(chain_joints[name]) is None}
    moving_joints = {
        name for name in chain_joints if name not in side_joints and tree.mimic(chain_joints[name]) is None
    } | moving
    still = {}
    for name, joint in chain_joints.items():
        leader, ratio, offset = tree.mimic(joint) or (name, 1.0, 0.0)
        if leader not in moving_joints:
            still[name] = ratio * locked.get(leader, _position_nearest_zero(tree, leader)) + offset
    return still


def _position_nearest_zero(tree: UrdfTree, name: str) -> float:
    """Position of a joint nearest to 0 within its limits [rad, m]."""
    joint = _movable(tree).get(name)
    low, high = (0.0, 0.0) if joint is None else _range(tree, joint)
    return min(max(0.0, low), high)


def _range(tree: UrdfTree, joint: Xml.Element) -> tuple[float, float]:
    """Position limits of a joint [rad, m]; infinite without any."""
    limit, key = joint.find("limit"), f"joint {joint.get('name')}: limit"
    if joint.get("type") == "continuous":
        limit = None
    (low,), (high,) = (tree.numbers(limit, end, 1, "0", f"{key} {end}") for end in ("lower", "upper"))
    return (low, high) if low < high else (-math.inf, math.inf)


def _fix_joints(tree: UrdfTree, positions: Mapping[str, float]) -> None:
    """Fix joints at positions [rad, m]."""
    movable = _movable(tree)
    for name, position in positions.items():
        joint, origin = movable[name], movable[name].find("origin")
        turn = pin.rpy.rpyToMatrix(*tree.numbers(origin, "rpy", 3, "0 0 0", f"joint {name}: origin rpy"))
        axis, shift = _axis(tree, joint), np.zeros(3)
        if _type(joint) == "prismatic":
            shift = turn @ axis * position
        else:
            turn = turn @ pin.exp3(axis * position)
        placed = _placement(np.array(_origin(tree, joint)) + shift, turn)
        origin = Xml.SubElement(joint, "origin") if origin is None else origin
        for attribute, values in placed.items():
            origin.set(attribute, " ".join(repr(value) for value in values))
        joint.set("type", "fixed")


def _locked_notes(tree: UrdfTree, positions: Mapping[str, float]) -> Iterable[str]:
    movable = _movable(tree)
    for name, at in positions.items():
        yield f"Joint {name} is held at {at:g} {UNITS[_type(movable[name])].position}, as given."


def _still_note(tree: UrdfTree, still: Mapping[str, float]) -> Iterable[str]:
    if still:
        places = ", ".join(f"{name} at {at:g}" for name, at in still.items())
        yield (
            f"Joints beside the path to the tip, which stand still while the robot hits [rad, m]: {places}. "
            "--lock JOINT=PLACE holds one elsewhere, --move JOINT lets it move."
        )


def _recentred_inertias(tree: UrdfTree, chain: Chain, movable: Iterable[Xml.Element], inertia_at: str) -> list[str]:
    """Notes on moments of inertia that seem to be about joints; ``inertia_at='joint'`` moves them to centres of mass.

    ``movable`` are all joints of the file that turn or slide, including those that are fixed here.
    """
    notes, suspects = [], []
    kept_links = {link.get("name") for link in Xml.fromstring(chain.urdf).findall("link")} - {chain.base}
    joints = [joint for joint in movable if child_of(joint) in kept_links]
    path = tree.path(chain.base, chain.tip)
    length = sum(float(np.linalg.norm(_origin(tree, joint))) for joint in path if joint in joints)
    for joint in joints:
        name = child_of(joint)
        inertial = tree.links[name].find("inertial")
        if inertial is None:
            continue
        key, origin = f"link {name}", inertial.find("origin")
        (mass,) = tree.numbers(inertial.find("mass"), "value", 1, None, f"{key}: inertial mass")
        centre = np.array(tree.numbers(origin, "xyz", 3, "0 0 0", f"{key}: origin xyz"))
        turn = pin.rpy.rpyToMatrix(*tree.numbers(origin, "rpy", 3, "0 0 0", f"{key}: origin rpy"))
        tensor = inertial.find("inertia")
        assert tensor is not None  # it was checked
        numbers = [tree.numbers(tensor, entry, 1, None, f"{key}: inertia {entry}")[0] for entry in INERTIA_ATTRIBUTES]
        upper = np.zeros((3, 3))
        upper[np.triu_indices(3)] = numbers
        stated = turn @ (upper + np.triu(upper, 1).T) @ turn.T
        axis = _axis(tree, joint)
        if inertia_at == "centre":
            ratio = suspected_steiner_ratio(mass, centre, stated, axis, length)
            suspects += [] if ratio is None else [f"{name} ({ratio:.2f} m r^2)"]
            continue
        moved = about_centre(mass, centre, stated, axis)
        if moved is None:
            raise InputError(
                "no body has these moments about its joint: less than m r^2 are left about the centre of mass; leave "
                "--inertia-at joint out", file=tree.file, key=f"{key}: inertia",
            )  # fmt: skip
        for entry, value in zip(INERTIA_ATTRIBUTES, (turn.T @ moved @ turn)[np.triu_indices(3)], strict=True):
            tensor.set(entry, repr(float(value)))
        notes.append(f"Moments of inertia of {name} were moved from the joint to the centre of mass (Steiner).")
    if suspects:
        notes.append(
            "Moments of inertia look as if they were about the joints, not about the centres of mass: "
            f"{', '.join(suspects)} across, with r the distance of the centre from the joint; slender links have a "
            "third. "
            "If so: --inertia-at joint."
        )
    return notes


def _placement(translation: Array, rotation: Array) -> dict[str, tuple[float, ...]]:
    return {"xyz": _clean(translation), "rpy": _clean(pin.rpy.matrixToRpy(rotation))}


def _meshes(
    tree: UrdfTree, chain: Chain, model: pin.Model, packages: Sequence[Path], notes: list[str]
) -> dict[int, list[_FoundMesh]]:
    """Address, placement at the joint and scale of every mesh, by number of the joint; 0: base; others are noted."""
    meshes: dict[int, list[_FoundMesh]] = {}
    for link in Xml.fromstring(chain.urdf).findall("link"):
        name = link.get("name", "")
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        for visual in tree.links[name].findall("visual"):
            mesh, origin, key = visual.find("geometry/mesh"), visual.find("origin"), f"link {name}: visual"
            if mesh is None or not mesh.get("filename"):
                continue
            address = mesh_address(mesh.get("filename", ""), tree.file, packages)
            if address is None:
                notes.append(
                    f"Mesh {mesh.get('filename')} of link {name} is left out: expected a path, package:// or file://."
                )
                continue
            rotation = pin.rpy.rpyToMatrix(*tree.numbers(origin, "rpy", 3, "0 0 0", f"{key} rpy"))
            shift = np.array(tree.numbers(origin, "xyz", 3, "0 0 0", f"{key} xyz"))
            scale = tree.numbers(mesh, "scale", 3, "1 1 1", f"{key} scale")
            placement = frame.placement * pin.SE3(rotation, shift)
            meshes.setdefault(frame.parentJoint, []).append((address, placement, scale))
    return meshes


def _missing_meshes(facts: RobotFacts) -> Iterable[str]:
    """Notes on missing meshes, with remedies."""
    meshes = [*facts.base_meshes, *(mesh for link in facts.links for mesh in link.meshes)]
    missing = [file for file in dict.fromkeys(mesh.file for mesh in meshes) if mesh_path(file) is None]
    for kind, remedy in (
        (PACKAGE, "say where their packages are: --package-path DIR, or AMENT_PREFIX_PATH"),
        (FILE, "put them there, or correct the URDF"),
    ):
        if files := [file for file in missing if file.startswith(kind)]:
            missing_files = ", ".join(files)
            yield f"Meshes that are not there, in whose place viewers draw simple shapes: {missing_files}; {remedy}."


def _mesh(mesh: _FoundMesh, turn: Array) -> Mesh:
    file, placement, scale = mesh
    origin = _placement(turn.T @ placement.translation, turn.T @ placement.rotation)
    return Mesh.model_validate({"file": file, "scale": scale, **origin})


def _body(tree: UrdfTree, body: pin.Inertia, turn: Array, name: str) -> Inertial:
    """A body of Pinocchio in a frame turned by ``turn``."""
    if body.mass <= 0.0:
        message = "expected an <inertial> with a mass > 0 [kg], in it or in a link that is fixed to it"
        raise InputError(message, file=tree.file, key=f"link {name}")
    entries = _clean((turn.T @ body.inertia @ turn)[np.triu_indices(3)])
    return Inertial(mass=float(body.mass), com=_clean(turn.T @ body.lever), inertia=entries)


def _link(tree: UrdfTree, body: pin.Inertia, turn: Array, meshes: Iterable[_FoundMesh], name: str) -> Link:
    """A link with its meshes; arguments as :func:`_body`."""
    visible = tuple(_mesh(mesh, turn) for mesh in meshes)
    return Link(**dict(_body(tree, body, turn, name)), meshes=visible, name=name)


def _clean(values: Iterable[float]) -> tuple[float, ...]:
    """Numbers without floating-point noise: 0.3 for 0.30000000000000004, 0 for -0."""
    short = [(float(value), round(float(value), 12) + 0.0) for value in values]
    return tuple(brief if abs(brief - value) <= 1e-15 * max(1.0, abs(value)) else value for value, brief in short)


def _number(value: float) -> str:
    text = repr(int(value)) if value == int(value) else repr(value)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")  # YAML reads 1e-05 as a string


def _row(values: Sequence[float]) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"


def _notes(chain: Chain) -> Iterable[str]:
    yield f"Links {chain.base} (base) to {chain.tip} (flange) of {chain.file.name}."
    endless = [joint.get("name", "") for joint in chain.joints if joint.get("type") == "continuous"]
    if endless:
        yield f"Continuous, without position limits in the URDF; here a full turn to either side: {', '.join(endless)}."
    if chain.merged:
        yield f"Links that are fixed to the chain and part of its links here: {', '.join(chain.merged)}."
    if chain.left_out:
        links = ", ".join(chain.left_out)
        yield f"Links beyond the flange are left out; describe them as end_effector of a scenario: {links}."
    if chain.dynamics:
        yield f"Damping and friction of the URDF are left out (a simulator's, as a rule): {', '.join(chain.dynamics)}."
