# SPDX-License-Identifier: Apache-2.0
"""State file of a follower: a later run goes on where an earlier one ended.

It is a NumPy archive (``.npz``) of numeric arrays and one text, a JSON document. Hits of the window and the last hit of
every condition are stored by name and read again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from impact_rs_analysis.following.change import Calibration
from impact_rs_analysis.following.follow import Follower, HitsSince
from impact_rs_analysis.following.hit_model import HitModel, Hypothesis, Origin
from impact_rs_analysis.following.hits import Hit
from impact_rs_analysis.following.posterior import Posterior
from impact_rs_analysis.following.recent_residuals import RecentResiduals
from impact_rs_analysis.following.watch import HitWatch
from impact_rs_analysis.inference.belief import Belief
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole
from impact_rs_sim.proportion import Proportion
from impact_rs_sim.robots.robot import Array

STATE_VERSION = 4
DOCUMENT_KEY = "document"


def save_state(follower: Follower, path: Path) -> None:
    """Write the state of a follower, completely or not at all.

    Raises:
        InputError: It cannot be written.
    """
    watch, hits, arrays = follower.watch, follower.learning.hit_model, {}
    hypotheses = [] if watch is None else watch.hypotheses
    for number, hypothesis in enumerate(hypotheses):
        arrays[f"point{number}"] = hypothesis.point
        arrays |= _arrays(hypothesis.posterior.before, f"information{number}", f"vector{number}")
        if hypothesis.origin is not None:
            arrays |= _arrays(hypothesis.origin.past, f"past{number}", f"past_vector{number}")
            arrays |= {f"old{number}": hypothesis.origin.old, f"before{number}": hypothesis.origin.point}
    for number, whiten in enumerate({} if hits is None else hits.whiten.values()):
        arrays[f"whiten{number}"] = whiten
    document = {
        "version": STATE_VERSION,
        "model": follower.model.digest,
        "names": follower.names,
        "first": [hit.name for hit in follower.learning.first],
        "last": {condition: hit.name for condition, hit in follower.last.items()},
        "announced": [] if watch is None else watch.announced,
        "changed": None if follower.changed is None else [follower.changed.since, follower.changed.conditions],
        "active": () if hits is None else hits.active,
        "layouts": [] if hits is None else list(hits.whiten),
        "calibration": vars(Calibration() if hits is None else hits.calibration),
        "proportion": None if hits is None else vars(hits.proportion),
        "hypotheses": [
            _columns(h.posterior.before)
            | {
                "origin": h.origin and _columns(h.origin.past) | {"numbers": h.origin.numbers},
                "window": [[(e.hit.name, e.weight) for e in instant] for instant in h.posterior.window],
                "log_weight": h.log_weight,
                "effect": h.effect,
                "tried": None if math.isinf(h.tried_statistic) else h.tried_statistic,
                "recent": h.recent.saved(),
            }
            for h in hypotheses
        ],
    }
    with whole(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{DOCUMENT_KEY: np.array(json.dumps(document)), **arrays})


def restore_state(follower: Follower, path: Path) -> int:
    """Let a new follower go on where the state was saved.

    Args:
        follower: A follower without hits.
        path: The file.

    Returns:
        Number of hits before the restart.

    Raises:
        InputError: It is no state file, one of another model, or a hit that it needs is gone.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        document = json.loads(str(arrays.pop(DOCUMENT_KEY)))
        version = document["version"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("not a state file of impact-rs follow; name another, or remove it", file=path) from None
    if version != STATE_VERSION:
        raise InputError(
            f"a state file of version {version}, expected {STATE_VERSION}; remove it to begin anew", file=path
        )
    if document["model"] != follower.model.digest:
        raise InputError(
            f"the state of another model (digest {document['model']}, here {follower.model.digest}); name its model "
            "or remove the file to begin anew",
            file=path,
        )
    try:
        _restore(follower, document, arrays)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise InputError(f"a damaged state file ({error}); remove it to begin anew", file=path) from None
    return len(document["names"])


def _restore(follower: Follower, document: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Restore a follower from its document and arrays."""
    windows = [name for h in document["hypotheses"] for instant in h["window"] for name, _ in instant]
    needed = [*document["first"], *document["last"].values(), *windows]
    recalled = follower.hit_source.recalled(needed, document["names"])
    follower.names = list(document["names"])
    if (changed := document.get("changed")) is not None:
        follower.changed = HitsSince(changed[0], tuple(changed[1]))
    follower.learning.first = [recalled[name] for name in document["first"]]
    follower.last = {condition: recalled[name] for condition, name in document["last"].items()}
    if document["proportion"] is None:
        return
    source = follower.hit_source.source(list(recalled.values()))
    hits, _ = follower.learning.consider(source, Proportion(**document["proportion"]))
    hits.look_at(document["active"])
    hits.whiten = {layout: arrays[f"whiten{n}"] for n, layout in enumerate(document["layouts"])}
    hits.calibration = Calibration(**{**document["calibration"], "whole": tuple(document["calibration"]["whole"])})
    hypotheses = [_hypothesis(hits, recalled, entry, n, arrays) for n, entry in enumerate(document["hypotheses"])]
    follower.learning.hit_model, follower.watch = hits, HitWatch(hits, hypotheses, list(document["announced"]))


def _hypothesis(
    hits: HitModel, recalled: Mapping[str, Hit], document: Mapping[str, Any], number: int, arrays: Mapping[str, Array]
) -> Hypothesis:
    """A hypothesis of the document."""
    point, origin = arrays[f"point{number}"], None
    posterior = Posterior(_belief(document, arrays[f"information{number}"], arrays[f"vector{number}"]))
    if (origin_document := document["origin"]) is not None:
        past = _belief(origin_document, arrays[f"past{number}"], arrays[f"past_vector{number}"])
        origin = Origin(arrays[f"before{number}"], past, tuple(origin_document["numbers"]), arrays[f"old{number}"])
    for instant in document["window"]:
        evidence = [(hits.evidence(recalled[name], point), weight) for name, weight in instant]
        posterior.add([replace(e, weight=weight) for e, weight in evidence if e is not None])
    tried = -math.inf if document["tried"] is None else document["tried"]
    recent = RecentResiduals.restored(document["recent"])
    return Hypothesis(point, posterior, document["log_weight"], document["effect"], origin, tried, recent)


def _arrays(belief: Belief, information: str, vector: str) -> dict[str, Array]:
    """Numbers of a belief by name."""
    return {information: belief.information, vector: belief.vector}


def _columns(belief: Belief) -> dict[str, Any]:
    """Columns of a belief, for the document."""
    groups = {group: (part.start, part.stop) for group, part in belief.groups.items()}
    return {"followed": belief.parameters, "groups": groups}


def _belief(document: Mapping[str, Any], information: Array, vector: Array) -> Belief:
    """A belief of the document."""
    groups = {group: slice(*ends) for group, ends in document["groups"].items()}
    return Belief(tuple(document["followed"]), information, vector, groups)
