# SPDX-License-Identifier: Apache-2.0
"""Compare a model with measured trials, and see where it fails.

Prints the score of the model as a multiple of repeatability, and the signals with the largest errors, in their units.
The folder is any with trials of impact_rs, or bags of a laboratory with an experiment.yaml; the default is that of
examples/campaign.py, whose plant hides no effect.

    ./run python examples/compare.py [FOLDER] [MODEL]
"""

import sys
from pathlib import Path

from impact_rs_analysis import ComparisonDocument, compare, read_measurements

FOLDER = Path("campaigns/example")


def main(folder: Path = FOLDER, model: str | Path = "nominal") -> ComparisonDocument:
    """Print how far the model is from the trials."""
    document = compare(read_measurements(folder, model))
    print(f"model {document.model.name!r} against {document.trials} trials: score {document.score:.2f}")
    for condition in document.conditions:
        print(f"  {condition.name}: {condition.score:.2f}")
    for place in document.where[:5]:
        print(f"  {place.phase}: {place.signal} {place.index} off by {place.error:+.3g} {place.unit}")
    for remark in document.remarks:
        print(f"note: {remark}")
    return document


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:3]))
