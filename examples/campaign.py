# SPDX-License-Identifier: Apache-2.0
"""Run a small campaign and read off the post-impact velocity that the robot itself prefers.

Shows a manifest, how its trials are run, and the analysis: net feedback over the post-impact reference is a line, and
its zero crossing is the measured velocity. Prints every trial as it ends, then the estimate beside the predictions.

    ./run python examples/campaign.py [FOLDER]       (the same folder again: finished trials are not repeated)
"""

import sys
from pathlib import Path

from impact_rs_analysis import ExperimentSet, analyze_campaign
from impact_rs_trials import make_manifest, run_campaign

FOLDER = Path("campaigns/example")
SCALES = [0.8, 0.9, 1.0, 1.1, 1.2]  # post-impact reference over predicted velocity


def main(folder: Path = FOLDER, scales: list[float] = SCALES) -> ExperimentSet:
    """Run what is missing, and analyse it."""
    manifest = make_manifest("push", objects=["cat_food"], cases=["case_2"], scales=scales, trials=1, seed=0)
    for report in run_campaign(folder, manifest):
        print(f"{report.key.name}: {report.outcome} {report.message}")
    (measured,) = analyze_campaign(folder).sets
    low, high = measured.interval or (float("nan"), float("nan"))
    print(f"{measured.label}: measured {measured.estimate:.4f} m/s, 95 % interval {low:.4f} to {high:.4f} m/s")
    for model, prediction in measured.predictions.items():
        print(f"  predicted with motor inertia {model:>7}: {prediction.error:+.2f} % off")
    return measured


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
