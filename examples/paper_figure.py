# SPDX-License-Identifier: Apache-2.0
"""Draw the figure of the paper from a folder of trials: net feedback, the line through it, and three predictions.

Shows the analysis of a campaign and what a fit holds. Run the campaign first:

    ./run python examples/campaign.py
    ./run python examples/paper_figure.py [FOLDER] [PICTURE]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from impact_rs_analysis.measure.analyze import analyze_campaign


def main(folder: Path, picture: Path) -> float:
    """Draw it; returns the velocity at which the robot needs no net feedback [m/s]."""
    (measured,) = analyze_campaign(folder).sets
    axes = Figure(layout="constrained").add_subplot(xlabel="post-impact reference [m/s]", ylabel="net feedback [m/s]")
    velocity = np.array([trial.info.reference_post_velocity for trial in measured.trials])
    axes.plot(velocity, [trial.net for trial in measured.trials], "o", label="trials")
    axes.plot(velocity, measured.fit.at(velocity), label=f"zero at {measured.fit.estimate:.4f} m/s")
    for model, prediction in measured.predictions.items():
        axes.axvline(prediction.velocity, linestyle=":", label=f"{model}: {prediction.error:+.1f} %")
    axes.legend()
    axes.get_figure().savefig(picture)
    return measured.fit.estimate


if __name__ == "__main__":
    chosen = [*sys.argv[1:], *["campaigns/example", "paper_figure.png"][len(sys.argv) - 1 :]]
    print(f"zero net feedback at {main(Path(chosen[0]), Path(chosen[1])):.4f} m/s: {chosen[1]}")
