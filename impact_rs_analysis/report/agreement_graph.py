# SPDX-License-Identifier: Apache-2.0
"""Bipartite graph of consistency: readings on the left, relations between them on the right."""

from __future__ import annotations

from dataclasses import dataclass

from impact_rs_analysis.diagnosis.agreement import AgreementDocument, joints_in_words

NODE_SPACING_PX = 44  # px between nodes
TOP_MARGIN_PX = 28  # above the first node
LEFT, RIGHT, WIDTH = 150, 330, 900  # px, ends of the lines and width of the graph


@dataclass(frozen=True)
class AgreementNode:
    """A reading or a relation.

    Attributes:
        name: Its name.
        y: Its height [px].
        against: Joints and axes at which a relation fails, or at which a reading is a possible cause of a failure.
    """

    name: str
    y: float
    against: str = ""


@dataclass(frozen=True)
class AgreementLine:
    """Edge: a reading takes part in a relation.

    Attributes:
        start: Height at the reading [px].
        end: Height at the relation [px].
        holds: Whether the relation holds at all joints.
    """

    start: float
    end: float
    holds: bool


@dataclass(frozen=True)
class AgreementGraph:
    """Content of ``agreement.html.j2``.

    Attributes:
        document: The relations.
        readings: Nodes on the left.
        relations: Nodes on the right.
        lines: Edges from readings to relations.
        height: Height of the graph [px].
        in_words: The graph as text.
    """

    document: AgreementDocument
    readings: tuple[AgreementNode, ...]
    relations: tuple[AgreementNode, ...]
    lines: tuple[AgreementLine, ...]
    height: float
    in_words: str
    left: int = LEFT
    right: int = RIGHT
    width: int = WIDTH


def agreement_graph(document: AgreementDocument) -> AgreementGraph | None:
    """Graph of relations over all joints; None without relations."""
    if not document.relations:
        return None
    names = list(dict.fromkeys(name for relation in document.relations for name in relation.readings))
    rows = max(len(names), len(document.names))
    at_reading = dict(zip(names, _heights(len(names), rows), strict=True))
    at_relation = dict(zip(document.names, _heights(len(document.names), rows), strict=True))
    possible_causes: dict[str, list[str]] = {}
    for relation in document.in_common:
        for name in relation.readings:
            possible_causes.setdefault(name, []).extend(relation.place.split(", "))
    against = {name: document.against(name) for name in document.names}
    sentences = [
        f"{name} ({', '.join(document.readings_of(name))}): "
        + (f"does not hold at {', '.join(failing_joints)}" if failing_joints else "holds")
        for name, failing_joints in against.items()
    ]
    return AgreementGraph(
        document=document,
        readings=tuple(
            AgreementNode(name, y, joints_in_words(possible_causes.get(name, []))) for name, y in at_reading.items()
        ),
        relations=tuple(AgreementNode(name, y, joints_in_words(against[name])) for name, y in at_relation.items()),
        lines=tuple(
            AgreementLine(at_reading[reading], y, not against[name])
            for name, y in at_relation.items()
            for reading in document.readings_of(name)
        ),
        height=2.0 * TOP_MARGIN_PX + (rows - 1) * NODE_SPACING_PX,
        in_words="; ".join(sentences),
    )


def _heights(count: int, rows: int) -> list[float]:
    """Heights of nodes, evenly distributed over the graph [px]."""
    step = NODE_SPACING_PX * (rows - 1) / max(count - 1, 1)
    return [TOP_MARGIN_PX + (number * step if count > 1 else 0.5 * step) for number in range(count)]
