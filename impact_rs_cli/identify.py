# SPDX-License-Identifier: Apache-2.0
"""The node ``identify``: what follows hits (:mod:`impact_rs_analysis.following`) in the node that publishes it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from impact_rs_analysis.following.follow import Follower
from impact_rs_analysis.following.lessons import HitDocument
from impact_rs_analysis.following.state import restore_state, save_state
from impact_rs_cli.following import HitsArguments, diagnose_command, door_of
from impact_rs_ros.identify_node import Identifier, IdentifyNode, Lesson
from impact_rs_ros.process import run
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model


class FollowedHits:
    """A follower of hits with its state file, as the node takes it.

    Args:
        hits: Where hits come from.
        state: State file; None: none.
    """

    def __init__(self, hits: HitsArguments, state: Path | None = None) -> None:
        model = load_model(hits.model)
        self._hits, self._state = hits, state
        self._follower = Follower(door_of(hits, model), model)
        self._restored = state is None or not state.exists()

    def arrived(self) -> Sequence[Lesson]:
        """What the hits since the last call taught.

        Raises:
            InputError: They cannot be read.
        """
        if not self._restored and self._state is not None:
            restore_state(self._follower, self._state)
            self._restored = True
        documents = list(self._follower.arrived())
        if documents and self._state is not None:
            save_state(self._follower, self._state)
        return [self._lesson(document) for document in documents]

    def prediction(self) -> str:
        """Prediction of the next hit and the parameters believed, as a JSON document; empty: not yet."""
        found = self._follower.prediction()
        if found is None:
            return ""
        followed = [one.model_dump(mode="json") for one in self._follower.followed()]
        return json.dumps({**found.model_dump(mode="json"), "followed": followed})

    def _lesson(self, document: HitDocument) -> Lesson:
        if document.error is None:
            return Lesson(f"{document.name}: the scatter is being learnt")
        line = f"{document.name}: prediction off by {document.error:.2g} standard deviations"
        if (change := document.change) is None:
            return Lesson(line)
        text = json.dumps({**change.model_dump(mode="json"), "diagnose": diagnose_command(self._hits)})
        return Lesson(line, text, change.words)


class Identify(IdentifyNode):
    """The node, with what follows hits in it."""

    def identifier(self) -> Identifier:
        """See :meth:`IdentifyNode.identifier`."""
        runs, impacts, state = (self.parameter(name) for name in ("runs", "impacts", "state"))
        if bool(runs) == bool(impacts):
            raise InputError("expected a folder of trials (runs) or a table of impacts (impacts)", key="runs")
        hits = HitsArguments(
            Path(runs) if runs else None,
            Path(impacts) if impacts else None,
            self.parameter("impacts_scenario") or None,
            self.parameter("model"),
        )
        return FollowedHits(hits, Path(state) if state else None)


def main() -> None:
    """Run the node."""
    run(Identify)


if __name__ == "__main__":
    main()
