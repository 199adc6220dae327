# SPDX-License-Identifier: Apache-2.0
"""Robot facts from a URDF.

In robot facts every joint rotates about its own +z or translates along it. A URDF allows any axis a_i in the frame of
the child link. With a rotation R_i that maps z to a_i, the frame of that link is changed:

    T'_i = (R_{i-1}^T, 0) T_i (R_i, 0)          Rot(a_i, q) R_i = R_i Rot(z, q),  Trans(a_i q) R_i = R_i Trans(z q)
    c'_i = R_i^T c_i                            I'_i = R_i^T I_i R_i

so that kinematics and dynamics are exactly those of the URDF. R_i is the smallest such rotation, and the identity where
the axis is z. Pinocchio reads placements and inertias, and merges fixed links.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin

from impact_rs_sim.errors import InputError
from impact_rs_sim.robots.mesh_files import FILE, PACKAGE, mesh_address, mesh_path
from impact_rs_sim.robots.robot import UNITS, Array, Flange, JointOrigin, JointType, Limits, Link, Mesh, RobotFacts
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
# Over the largest moment [-]; rounding of a URDF puts a principal moment of a flat body below 0
NEGATIVE_MOMENT_TOLERANCE = 1e-6
INERTIA_ATTRIBUTES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class ImportedRobot:
    """Facts, and notes on the rest of the URDF.

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
) -> ImportedRobot:
    """Facts of the arm from link ``base`` to link ``tip`` of a URDF.

    Args:
        file: The URDF; its meshes need not be there, those that are not found are noted.
        base: Link that the arm is mounted with; None: the root.
        tip: Link whose frame is the flange; None: the only one there is.
        source: Where the numbers come from; None: the file's name.
        limits: Limits in place of those of the URDF (:func:`~impact_rs_sim.robots.urdf_repairs.given_limits`).
        inertia_at: Where its moments of inertia are about: the centre of mass, as the format says, or the joint.
        lock: Positions at which joints are locked (:func:`~impact_rs_sim.robots.urdf_repairs.locked_joints`).
        measured: Limits that a recording shows, for the joints of the chain, in place of those that are missing or 0.
        packages: Where packages of its meshes are (:func:`~impact_rs_sim.robots.mesh_files.mesh_address`).

    Raises:
        InputError: The file is no URDF, has no such chain, or lacks a number that is needed.
    """
    tree = UrdfTree(file)
    held = _locked(tree, lock)
    chain = tree.chain(base, tip)
    _check_inertials(tree, chain)
    notes = [*tree.notes, *held, *_recentred_inertias(tree, chain, inertia_at)]
    chain = tree.chain(base, tip)
    names = [joint.get("name", "") for joint in chain.joints]
    given, shown = given_limits(limits, names, file), measured(names)
    try:
        model = pin.buildModelFromXML(chain.urdf)
    except ValueError as error:
        raise InputError(f"Pinocchio does not read it: {error}", file=file) from None
    joints, links, rows = [], [], []
    before = np.eye(3)
    meshes = _meshes(tree, chain, model, packages, notes)
    for index, joint in enumerate(chain.joints, start=1):
        turn = frame_of_axis(np.array(_axis(tree, joint)))
        placement, body = model.jointPlacements[index], model.inertias[index]
        link = joint.find("child")
        if body.mass <= 0.0:
            raise InputError(
                "expected an <inertial> with a mass > 0 [kg], in it or in a link that is fixed to it",
                file=file,
                key=f"link {'' if link is None else link.get('link')}",
            )
        origin = _placement(before.T @ placement.translation, before.T @ placement.rotation @ turn)
        joints.append(JointOrigin.model_validate({"type": _type(joint), **origin}))
        links.append(_link(body, turn, meshes.get(index, []), child_of(joint)))
        rows.append(_limits(tree, joint, given, shown, notes))
        before = turn
    frame = model.frames[model.getFrameId(chain.tip, pin.FrameType.BODY)].placement
    flange = Flange.model_validate(_placement(before.T @ frame.translation, before.T @ frame.rotation))
    columns = [tuple(column) for column in zip(*rows, strict=True)]
    facts = RobotFacts(
        source=source or f"imported from {file.name}",
        joints=tuple(joints),
        flange=flange,
        limits=Limits(**dict(zip(Limits.model_fields, columns, strict=True))),
        links=tuple(links),
        base_meshes=tuple(_mesh(one, np.eye(3)) for one in meshes.get(0, [])),
        joint_torque_loop=False,
    )
    joint_names = tuple(joint.get("name", "") for joint in chain.joints)
    return ImportedRobot(facts, joint_names, (*_notes(chain), *notes, *_missing_meshes(facts), NOT_IN_URDF_NOTE))


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
    """The YAML file of the facts, with comments on what a URDF does not hold.

    Args:
        robot: What was imported.
        title: First comment line.
    """
    facts, limits = robot.facts, robot.facts.limits
    slides = "prismatic" in facts.joint_types
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
        "joints:   # origin of joint i in link i-1 [m], roll-pitch-yaw [rad]; every axis is +z",
    ]
    lines += [
        f"  - {{{TYPE_ENTRY[origin.type]}xyz: {_row(origin.xyz)}, rpy: {_row(origin.rpy)}}}  # {name}"
        for origin, name in zip(facts.joints, robot.joints, strict=True)
    ]
    rpy = f", rpy: {_row(facts.flange.rpy)}" if any(facts.flange.rpy) else ""
    lines += [f"flange: {{xyz: {_row(facts.flange.xyz)}{rpy}}}", "limits:"]
    lines += [f"  {name}: {_row(getattr(limits, name))}" for name in Limits.model_fields]
    lines.append("links:    # mass [kg], com [m], inertia [ixx, ixy, ixz, iyy, iyz, izz] [kg m^2]")
    lines += [
        f"  - {{name: {json.dumps(link.name, ensure_ascii=False)}, mass: {_number(link.mass)}, com: {_row(link.com)}, "
        f"inertia: {_row(link.inertia)}{_shown(link.meshes)}}}"
        for link in facts.links
    ]
    if facts.base_meshes:
        lines.append(f"base_meshes: {_mesh_rows(facts.base_meshes)}")
    return "\n".join(lines) + "\n"


def _shown(meshes: Sequence[Mesh]) -> str:
    return f", meshes: {_mesh_rows(meshes)}" if meshes else ""


def _mesh_rows(meshes: Sequence[Mesh]) -> str:
    rows = (
        f"{{file: {json.dumps(one.file)}, xyz: {_row(one.xyz)}, rpy: {_row(one.rpy)}, scale: {_row(one.scale)}}}"
        for one in meshes
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
    except FileExistsError:
        raise InputError("this file exists already; robot facts are never overwritten", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None
    finally:
        unfinished.unlink(missing_ok=True)


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
    found = [f"i{axis}{axis} = {moment:.3g} kg m^2" for axis, moment in diagonal.items() if moment < 0.0]
    upper = np.zeros((3, 3))
    upper[np.triu_indices(3)] = entries
    moments, axes = np.linalg.eigh(upper + np.triu(upper, 1).T)
    if not found and moments[0] < -NEGATIVE_MOMENT_TOLERANCE * moments[2]:
        axis = ", ".join(f"{value:.2f}" for value in axes[:, 0])
        found.append(f"a principal moment of {moments[0]:.3g} kg m^2 about ({axis})")
    return found


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
    tree: UrdfTree, joint: Xml.Element, given: GivenLimits, shown: GivenLimits, notes: list[str]
) -> tuple[float, float, float, float]:
    """Lowest and highest position, velocity and effort, in the units of the joint; what was given or shown is noted."""
    units, name = UNITS[_type(joint)], joint.get("name", "")
    limit, key = joint.find("limit"), f"joint {name}: limit"
    remedy = f"--limits {name}."
    if (name, "position") in given:
        lower, upper = given[name, "position"]
        notes.append(f"Limits of joint {name} as given: {lower:g} to {upper:g} {units.position}.")
    elif joint.get("type") == "continuous":
        lower, upper = -FULL_TURN_RAD, FULL_TURN_RAD
    else:
        (lower,), (upper,) = (tree.numbers(limit, end, 1, "0", f"{key} {end}") for end in ("lower", "upper"))
        if lower == upper == 0.0 and (name, "position") in shown:
            lower, upper = shown[name, "position"]
            notes.append(f"Limits of joint {name} as measured: {lower:g} to {upper:g} {units.position}.")
    if lower >= upper:
        message = f"expected lower < upper [{units.position}], found {lower:g} and {upper:g}; {remedy}position=LOW:HIGH"
        raise InputError(f"{message} gives it, or --measured RECORDING", file=tree.file, key=key)
    most = []
    for quantity, unit in (("velocity", units.velocity), ("effort", units.effort)):
        missing = limit is None or limit.get(quantity) is None
        value = 0.0 if missing else tree.numbers(limit, quantity, 1, None, f"{key} {quantity}")[0]
        if (name, quantity) in given:
            (value,) = given[name, quantity]
            notes.append(f"{quantity.capitalize()} limit of joint {name} as given: {value:g} {unit}.")
        elif value == 0.0 and (name, quantity) in shown:
            (value,) = shown[name, quantity]
            notes.append(f"{quantity.capitalize()} limit of joint {name} as measured: {value:g} {unit}.")
        if value <= 0.0:
            found = (
                "this is missing in the URDF, expected a number"
                if missing
                else f"expected > 0 [{unit}], found {value:g}"
            )
            said = f"{found}; {remedy}{quantity}=MOST gives it, or --measured RECORDING"
            raise InputError(said, file=tree.file, key=f"{key} {quantity}")
        most.append(value)
    return lower, upper, most[0], most[1]


def _locked(tree: UrdfTree, texts: Sequence[str]) -> list[str]:
    """Joints locked at positions given by the user; notes on them."""
    moving = {joint.get("name", ""): joint for joint in tree.above.values() if joint.get("type") in MOVABLE_JOINT_TYPES}
    notes = []
    for name, position in locked_joints(texts, list(moving), tree.file).items():
        joint, origin = moving[name], moving[name].find("origin")
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
        notes.append(f"Joint {name} is held at {position:g} {UNITS[_type(joint)].position}, as given.")
        joint.set("type", "fixed")
    return notes


def _recentred_inertias(tree: UrdfTree, chain: Chain, inertia_at: str) -> list[str]:
    """Notes on moments that look as if they were about joints, which are moved to the centres of mass if asked for."""
    notes, suspects = [], []
    length = sum(float(np.linalg.norm(_origin(tree, joint))) for joint in chain.joints)
    for joint in chain.joints:
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
) -> dict[int, list[tuple[str, pin.SE3, list[float]]]]:
    """Address, placement at the joint and scale of every mesh, by number of the joint; 0: base; others are noted."""
    found: dict[int, list[tuple[str, pin.SE3, list[float]]]] = {}
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
            found.setdefault(frame.parentJoint, []).append((address, placement, scale))
    return found


def _missing_meshes(facts: RobotFacts) -> Iterable[str]:
    """Notes on missing meshes, with remedies."""
    meshes = [*facts.base_meshes, *(mesh for link in facts.links for mesh in link.meshes)]
    missing = [one for one in dict.fromkeys(mesh.file for mesh in meshes) if mesh_path(one) is None]
    for kind, remedy in (
        (PACKAGE, "say where their packages are: --package-path DIR, or AMENT_PREFIX_PATH"),
        (FILE, "put them there, or correct the URDF"),
    ):
        if found := [one for one in missing if one.startswith(kind)]:
            yield f"Meshes that are not there, in whose place viewers draw simple shapes: {', '.join(found)}; {remedy}."


def _mesh(found: tuple[str, pin.SE3, list[float]], turn: Array) -> Mesh:
    file, placement, scale = found
    placed = _placement(turn.T @ placement.translation, turn.T @ placement.rotation)
    return Mesh.model_validate({"file": file, "scale": scale, **placed})


def _link(body: pin.Inertia, turn: Array, meshes: Iterable[tuple[str, pin.SE3, list[float]]], name: str) -> Link:
    inertia = turn.T @ body.inertia @ turn
    entries = _clean(inertia[np.triu_indices(3)])
    shown = tuple(_mesh(one, turn) for one in meshes)
    return Link(mass=float(body.mass), com=_clean(turn.T @ body.lever), inertia=entries, meshes=shown, name=name)


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
        left = ", ".join(chain.left_out)
        yield f"Links beyond the flange are left out; a scenario's end_effector says what is there: {left}."
    if chain.dynamics:
        yield f"Damping and friction of the URDF are left out (a simulator's, as a rule): {', '.join(chain.dynamics)}."
