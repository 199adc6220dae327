"""Trials as a source of evidence: clusters are conditions with their repeats, the twin in closed loop predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_rs_analysis.evidence.cluster import Added, Cluster, Source, pooled_error
from impact_rs_analysis.evidence.discrepancy import Discrepancy, measured_discrepancy
from impact_rs_analysis.evidence.rollouts import Rollout, RolloutStore, residuals
from impact_rs_analysis.evidence.runs import Condition, Runs
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import Model
from impact_rs_sim.robot import Array


def clusters_of(
    runs: Runs, residuals: Sequence[Array], discrepancy: Discrepancy | None = None
) -> tuple[tuple[Cluster, ...], list[str]]:
    """Residuals of all trials as clusters, in order of appearance.

    Where nothing of a layout was repeated, its features have no pure error: they are scaled by what nobody cares about,
    and a remark says so.

    Args:
        runs: The trials.
        residuals: Measured minus predicted features per trial, in their units.
        discrepancy: Of the twin; None: as measured.

    Returns:
        Clusters, and remarks for the user.
    """
    discrepancy = measured_discrepancy() if discrepancy is None else discrepancy
    grouped: dict[Condition, list[Array]] = {}
    for trial, residual in zip(runs.trials, residuals, strict=True):
        grouped.setdefault(trial.condition, []).append(residual)
    rows = {condition: np.array(values) for condition, values in grouped.items()}
    pure = {
        layout: pooled_error([values for condition, values in rows.items() if layout_of(condition) == layout])
        for layout in {layout_of(condition) for condition in rows}
    }
    clusters = []
    for condition, values in rows.items():
        layout = layout_of(condition)
        hit = condition.plan.expects_impact
        spread = pure[layout]
        floor = np.array([feature.floor for feature in condition.features]) / 2.0
        systematic = discrepancy.of(condition.features, hit)
        known = np.zeros_like(floor) if spread is None else spread
        sigma = np.sqrt(known**2 + floor**2 + systematic**2)
        clusters.append(
            Cluster(
                name=condition.label,
                place=(condition.scenario, condition.object, condition.case),
                layout=layout,
                unit=condition.label,
                contact=hit,
                features=condition.features,
                residuals=values / sigma,
                sigma=sigma,
                pure=known / sigma,
                discrepancy=systematic / sigma,
            )
        )
    alone = [item.name for item in clusters if pure[item.layout] is None]
    remarks = []
    if alone:
        remarks.append(
            f"not repeated, so differences are in multiples of a fixed small size and not of pure error: "
            f"{', '.join(alone)}; two trials of one condition are enough to compare with repetition"
        )
    return tuple(clusters), remarks


def layout_of(condition: Condition) -> str:
    """Name of what a condition's feature vector is made of."""
    kind = "hit" if condition.plan.expects_impact else "free"
    return f"{kind}: {', '.join(condition.plan.arms)}, {len(condition.features)} features"


class TrialSource(Source):
    """Trials against the twin of a model.

    Args:
        runs: The trials.
        model: What is believed.
        store: Runs the twin.
        clusters: Residuals of the model by condition, in the order of ``runs.conditions``.
        discrepancy: Of the twin.
        remarks: What a reader should know.

    Attributes:
        conditions: What was measured, in the order of the clusters.
    """

    repeated = True
    cheap = False

    def __init__(
        self,
        runs: Runs,
        model: Model,
        store: RolloutStore,
        clusters: tuple[Cluster, ...],
        discrepancy: Discrepancy,
        remarks: Sequence[str] = (),
    ) -> None:
        self.runs, self.model, self.store, self.clusters = runs, model, store, clusters
        self.discrepancy, self.remarks = discrepancy, tuple(remarks)
        self.conditions = runs.conditions
        self.physics = model.apply(self.conditions[0].plan.scene.physics)

    @classmethod
    def of(cls, runs: Runs, model: Model, store: RolloutStore, discrepancy: Discrepancy | None = None) -> TrialSource:
        """Run the twin of every trial, started where the trial started.

        Args:
            runs: The trials.
            model: What is believed.
            store: Runs the twin.
            discrepancy: Of the twin; None: as measured.

        Raises:
            InputError: With this model nothing is hit, or the model blows up.
        """
        discrepancy = measured_discrepancy() if discrepancy is None else discrepancy
        clusters, remarks = clusters_of(runs, residuals(runs, model, store), discrepancy)
        return cls(runs, model, store, clusters, discrepancy, remarks)

    def predict(self, wanted: Sequence[tuple[int, Added]], what: str) -> list[Array | None]:
        """See :meth:`Source.predict`; every condition starts where its plan says."""
        return self.store([Rollout(self.conditions[number], self.model, added) for number, added in wanted], what)

    def measure_again(self, added: Added, like: Sequence[Cluster]) -> list[Cluster] | None:
        """See :meth:`Source.measure_again`; every trial's twin starts where the trial started."""
        names = {item.name for item in like}
        runs = replace(self.runs, trials=tuple(t for t in self.runs.trials if t.condition.label in names))
        try:
            found = residuals(runs, self.model, self.store, added)
        except InputError:
            return None
        grouped: dict[str, list[Array]] = {item.name: [] for item in like}
        for trial, residual in zip(runs.trials, found, strict=True):
            grouped[trial.condition.label].append(residual)
        return [replace(item, residuals=np.array(grouped[item.name]) / item.sigma) for item in like]
