# SPDX-License-Identifier: Apache-2.0
"""Compare the nominal model with measured trials, and name the physical effect that it lacks (some minutes).

./run python examples/laboratory.py output/heavy --hide object_mass 1.15     (records trials of heavier boxes)
./run python examples/diagnose.py [FOLDER]
"""

import sys

from impact_rs_analysis import DiagnosisDocument, compare, diagnose, read_measurements
from impact_rs_sim.numbers import estimate_in_line


def main(folder: str = "output/heavy", effects: list[str] | None = None) -> DiagnosisDocument:
    """Print where the model fails, and the effects that it lacks with estimates and 95 % intervals."""
    measured = read_measurements(folder)
    comparison = compare(measured)
    print(f"score {comparison.score:.2f} (repeatability: 1)")
    for residual in comparison.where[:3]:
        print(f"  {residual.phase}: {residual.signal} {residual.index} off by {residual.error:+.3g} {residual.unit}")
    diagnosis = diagnose(measured, only=effects)
    print(diagnosis.summary)
    for name in diagnosis.named:
        for key, value in diagnosis.effect(name).parameters.items():
            print(f"  {name}: {key} {estimate_in_line(value.estimate, value.ci95)} {value.unit}")
    return diagnosis


if __name__ == "__main__":
    main(*sys.argv[1:2])
