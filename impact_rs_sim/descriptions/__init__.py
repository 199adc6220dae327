# SPDX-License-Identifier: Apache-2.0
"""Export of a scene with its model to other simulators; every format is one module that writes one file.

A module has ``SUPPORTED_QUANTITIES``, the quantities that its format can hold, and ``write(scene)``, which returns the
file and notes on how its numbers follow from the scene. Comments at the head of the file hold these notes and the list
of omitted quantities.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from impact_rs_sim.descriptions import drake, mjcf, urdf_scene, usd_physics
from impact_rs_sim.descriptions.exported_scene import PADS, ExportedQuantity, ExportedScene

__all__ = ["FORMATS", "PADS", "DescriptionFormat", "ExportedScene", "ExportedQuantity", "ExportedFile"]


@dataclass(frozen=True)
class ExportedFile:
    """A written file.

    Attributes:
        text: Text of the file, including comments.
        remarks: Notes on how its numbers follow from the scene.
        left_out: Physics of the scene that the format cannot represent.
    """

    text: str
    remarks: tuple[str, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class DescriptionFormat:
    """A file format.

    Attributes:
        label: Name for the user.
        suffixes: File suffixes.
        supported: Quantities that it can represent.
        body: Function that returns the file without comments, and notes on its numbers.
        xml: Whether it is XML; else its comments begin with ``#``.
    """

    label: str
    suffixes: tuple[str, ...]
    supported: frozenset[ExportedQuantity]
    body: Callable[[ExportedScene], tuple[str, list[str]]]
    xml: bool = True

    def write(self, scene: ExportedScene) -> ExportedFile:
        """A scene in this format."""
        body, remarks = self.body(scene)
        left_out = scene.left_out(self.supported)
        comments = [
            scene.title,
            *scene.source,
            "",
            "How the numbers follow from those of the scene:",
            *(f"* {remark}" for remark in remarks),
            "",
            "Not in this file:" if left_out else "Nothing is left out.",
            *(f"* {quantity}" for quantity in left_out),
        ]
        if self.xml:
            # XML allows no double hyphen in a comment: options lose theirs, others are separated by a space.
            comment = re.sub(r"(?<![\w-])--(?=\w)", "", "\n".join(comments)).replace("--", "- -")
            text = f'<?xml version="1.0"?>\n<!--\n{comment}\n-->\n{body}\n'
        else:
            text = "#usda 1.0\n" + "".join(f"# {line}".rstrip() + "\n" for line in comments) + body
        return ExportedFile(text, tuple(remarks), tuple(left_out))


FORMATS: dict[str, DescriptionFormat] = {
    "mjcf": DescriptionFormat("MuJoCo model", (".xml", ".mjcf"), mjcf.SUPPORTED_QUANTITIES, mjcf.write),
    "drake": DescriptionFormat("SDFormat world for Drake", (".sdf",), drake.SUPPORTED_QUANTITIES, drake.write),
    "urdf": DescriptionFormat("URDF", (".urdf",), urdf_scene.SUPPORTED_QUANTITIES, urdf_scene.write),
    "usd_params": DescriptionFormat(
        "USD layer", (".usda",), usd_physics.SUPPORTED_QUANTITIES, usd_physics.write, xml=False
    ),
}
