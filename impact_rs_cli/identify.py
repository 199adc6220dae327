# SPDX-License-Identifier: Apache-2.0
"""The node ``identify``: publishes the results of :mod:`impact_rs_analysis.following`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from impact_rs_analysis.application.followed_hits import (
    FollowedHits,
    diagnose_options,
    folder_of_diagnoses,
    hit_source_of,
    hits_options,
)
from impact_rs_analysis.evidence.calibration import calibration_of
from impact_rs_analysis.following.documents import HitDocument, PublishedChange, PublishedPrediction, RefusedHit
from impact_rs_analysis.following.follow import Follower
from impact_rs_cli.full_diagnosis import FullDiagnosis
from impact_rs_ros.identify_node import HitReport, Identifier, IdentifyNode
from impact_rs_ros.process import run
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model

HITS_PER_POLL = 3  # in between the node answers


class HitReports:
    """Results of followed hits, in the format of the node.

    Args:
        followed: The hits.
        diagnosis: Makes the full diagnoses that changes call for.
    """

    def __init__(self, followed: FollowedHits, diagnosis: FullDiagnosis) -> None:
        self._followed, self._diagnosis = followed, diagnosis
        self._restored = False
        self._arriving: Iterator[HitDocument] = iter(())

    def arrived(self) -> Sequence[HitReport]:
        """Results of the hits since the last call; if many wait, of the first ones.

        Raises:
            InputError: They cannot be read.
        """
        if not self._restored:
            self._followed.restore()
            self._restored = True
        documents = list(islice(self._arriving, HITS_PER_POLL))
        if not documents:
            self._arriving = self._followed.arrived()
            documents = list(islice(self._arriving, HITS_PER_POLL))
        reports = [*self._refusals(), *map(self._report, documents)]
        if not documents and (begun := self._followed.diagnose()):
            reports.append(HitReport(begun, hit=False))
        if (ended := self._diagnosis.ended()) is not None:
            reports.append(HitReport(f"full diagnosis: {ended.words}", "diagnosis", ended.model_dump(), hit=False))
        return reports

    def prediction(self) -> dict[str, Any]:
        """Fields of the prediction of the next hit, with the parameters believed; empty: not yet."""
        prediction = self._followed.follower.prediction()
        if prediction is None:
            return {}
        return PublishedPrediction(**vars(prediction), followed=self._followed.follower.followed()).model_dump()

    def close(self) -> None:
        """Stop a diagnosis that runs."""
        self._diagnosis.stop()

    def _refusals(self) -> Iterator[HitReport]:
        """Refused trials since the last call."""
        for name, reason in self._followed.follower.hit_source.newly_skipped().items():
            yield HitReport(f"{name}: {reason}", "refused", RefusedHit(hit=name, reason=reason).model_dump(), hit=False)

    def _report(self, document: HitDocument) -> HitReport:
        if document.error is None:
            return HitReport(f"{document.name}: the scatter is being learnt")
        line = f"{document.name}: prediction off by {document.error:.2g} standard deviations"
        if (change := document.change) is None:
            return HitReport(line)
        command = self._diagnosis.command(change.since)
        return HitReport(line, "change", PublishedChange(**vars(change), diagnose=command).model_dump())


class Identify(IdentifyNode):
    """The node, with the follower of hits in it."""

    def identifier(self) -> Identifier:
        """See :meth:`IdentifyNode.identifier`."""
        runs, impacts, state = (self.parameter(name) for name in ("runs", "impacts", "state"))
        if bool(runs) == bool(impacts):
            raise InputError("expected a folder of trials (runs) or a table of impacts (impacts)", key="runs")
        hits = hits_options(
            Path(runs) if runs else None,
            Path(impacts) if impacts else None,
            scenario=self.parameter("impacts_scenario") or None,
        )
        file = self.parameter("model")
        model = calibration_of(hits.data, hits.calibration).of(load_model(file))
        diagnoses = self.parameter("diagnoses")
        state = Path(state) if state else None
        folder = folder_of_diagnoses(Path(diagnoses) if diagnoses else None, state)
        diagnosis = FullDiagnosis(diagnose_options(hits, file), folder)
        follower = Follower(hit_source_of(hits, model), model)
        return HitReports(
            FollowedHits(hits, follower, state, diagnosis if self.parameter("diagnose") else None), diagnosis
        )


def main() -> None:
    """Run the node."""
    run(Identify)


if __name__ == "__main__":
    main()
