# SPDX-License-Identifier: Apache-2.0
"""Draw the robot of a bag at one moment, from its URDFs and /tf alone, as a viewer does.

Shows what /robot_description and /object/robot_description hold, and how /tf places it: every shape hangs on a link,
every link on the one before it. Writes a picture of the moment just before the impact, in the axes of the world. The
bag is any trial of ours; the default is one of those that examples/campaign.py makes.

    ./run python examples/draw_robot.py [BAG [PNG]]
"""

import sys
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from rosbags.highlevel import AnyReader

from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag
from impact_rs_trials.bags.types import typestore

BAG = Path("campaigns/example/cat_food__case_2__s1.000__r0")
PICTURE = Path("robot.png")
SIDES = 16  # of a cylinder or a sphere


def main(path: Path = BAG, picture: Path = PICTURE) -> int:
    """Draw the bag's robot and object; returns the number of shapes."""
    bag = TrialBag.open(path)
    moment = min(bag.impact_time(arm) for arm in bag.info.robots)
    frames: dict[str, tuple[str, pin.SE3]] = {}
    urdfs = []
    with AnyReader([path], default_typestore=typestore()) as reader:
        for connection, time, data in reader.messages():
            if connection.topic in (topics.ROBOT_DESCRIPTION, topics.OBJECT_DESCRIPTION):
                urdfs.append(Xml.fromstring(reader.deserialize(data, connection.msgtype).data))
            if connection.topic in (topics.TF, topics.TF_STATIC) and time - bag.origin_ns < 1e9 * moment:
                for item in reader.deserialize(data, connection.msgtype).transforms:
                    translation, quaternion = item.transform.translation, item.transform.rotation
                    rotation = pin.Quaternion(quaternion.w, quaternion.x, quaternion.y, quaternion.z).matrix()
                    placement = pin.SE3(rotation, np.array([translation.x, translation.y, translation.z]))
                    frames[item.child_frame_id] = item.header.frame_id, placement

    axes = Figure(figsize=(7.0, 6.0)).add_subplot(projection="3d", computed_zorder=False)
    axes.autoscale(False)
    axes.set(xlim=(-0.3, 0.9), ylim=(-0.6, 0.6), zlim=(0.0, 1.2), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    shapes = [(link.get("name"), item) for urdf in urdfs for link in urdf.iter("link") for item in link.iter("visual")]
    faces, colours = [], []
    for name, shape in shapes:
        placement = in_world(frames, name) * origin(shape)
        colour = numbers(shape.find("material/color").get("rgba"))
        if name == "support":
            colour[3] = 0.15  # the arm is seen through it
        for face in faces_of(shape.find("geometry")[0]):
            faces.append(face @ placement.rotation.T + placement.translation)
            colours.append(colour)
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, edgecolors="#00000030", linewidths=0.3))
    axes.set_title(f"{path.name}, {moment:.3f} s")
    axes.set_box_aspect((1.0, 1.0, 1.0))
    axes.view_init(elev=20.0, azim=50.0)
    axes.figure.savefig(picture, dpi=130, bbox_inches="tight")
    print(f"{picture}: {len(shapes)} shapes on {len(frames)} frames, just before the impact at {moment:.3f} s")
    return len(shapes)


def in_world(frames: dict[str, tuple[str, pin.SE3]], name: str) -> pin.SE3:
    """Placement of a frame in the world, up the chain of its parents."""
    if name == "world":
        return pin.SE3.Identity()
    parent, placement = frames[name]
    return in_world(frames, parent) * placement


def numbers(text: str) -> np.ndarray:
    """Numbers with blanks between them."""
    return np.array(text.split(), dtype=float)


def origin(visual: Xml.Element) -> pin.SE3:
    """Placement of a shape in its link."""
    element = visual.find("origin")
    return pin.SE3(pin.rpy.rpyToMatrix(*numbers(element.get("rpy"))), numbers(element.get("xyz")))


def faces_of(shape: Xml.Element) -> list[np.ndarray]:
    """Corners of the faces of a box, a cylinder or a sphere, ``(k, 3)`` each [m]."""
    if shape.tag == "sphere":
        radius, height = float(shape.get("radius")), np.linspace(-np.pi / 2.0, np.pi / 2.0, SIDES // 2 + 1)
        rings = [_ring(SIDES, 0.0, np.full(2, radius * np.cos(h)), radius * np.sin(h)) for h in height]
        return [face for low, high in pairwise(rings) for face in _sides(low, high)]
    if shape.tag == "box":
        half = numbers(shape.get("size")) / 2.0
        bottom, top = (_ring(4, np.pi / 4.0, np.sqrt(2.0) * half[:2], z) for z in (-half[2], half[2]))
    else:
        radius, half_length = float(shape.get("radius")), float(shape.get("length")) / 2.0
        bottom, top = (_ring(SIDES, 0.0, np.full(2, radius), z) for z in (-half_length, half_length))
    return [top, bottom, *_sides(bottom, top)]


def _ring(count: int, start: float, radii: np.ndarray, z: float) -> np.ndarray:
    """Points on an ellipse at a height, ``(count, 3)`` [m]."""
    angles = start + 2.0 * np.pi * np.arange(count) / count
    return np.column_stack((radii * np.column_stack((np.cos(angles), np.sin(angles))), np.full(count, z)))


def _sides(low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """Faces between two rings, ``(4, 3)`` each [m]."""
    return [np.array([low[i - 1], low[i], high[i], high[i - 1]]) for i in range(len(low))]


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:3]))
