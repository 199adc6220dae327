# SPDX-License-Identifier: Apache-2.0
"""Hide a physical effect in the robot, and let the diagnosis find it.

Shows how trials of another plant are recorded, and the diagnosis of what the nominal model lacks. The support is 1.6
times as rough as the model says; three effects are considered. Prints the verdict on each with estimate and interval.
Takes a minute or two; trials are kept in the folder, and replays in ~/.cache/impact_rs.

    ./run python examples/diagnose.py [FOLDER]
"""

import sys
from pathlib import Path

from impact_rs_analysis import DiagnosisDocument, diagnose, read_measurements
from impact_rs_sim import Model, ModelEffect, ParameterValue, load_scenario
from impact_rs_sim.numbers import estimate_in_line
from impact_rs_trials import TrialInfo, TrialKey, TrialSpec, record_trial

HIDDEN = ModelEffect(name="support_friction", parameters={"friction": ParameterValue(estimate=0.18, unit="-")})
CONDITIONS = [("parcel", "case_1"), ("juice", "case_1"), ("juice", "case_2"), ("cat_food", "case_2")]
EFFECTS = ["support_friction", "object_mass", "restitution"]


def record(folder: Path, conditions: list[tuple[str, str]] = CONDITIONS, repeats: int = 3) -> None:
    """Record trials of the plant that hides something."""
    for name, case in conditions:
        plan = TrialSpec.of(load_scenario("push"), name, case).plan
        physics = Model(name="truth", effects=(HIDDEN,)).apply(plan.scene.physics)
        for key in (TrialKey(name, case, 1.0, repeat) for repeat in range(repeats)):
            if not (folder / key.name).exists():
                info = TrialInfo.of(plan, key, key.seed(0), "inprocess")
                print(key.name, record_trial(plan, info, folder / key.name, physics)[0].outcome)


def main(folder: Path, effects: list[str] = EFFECTS) -> DiagnosisDocument:
    """Diagnose the trials of a folder."""
    document = diagnose(read_measurements(folder), only=effects)
    print(f"{document.verdict}: {document.summary}")
    for effect in document.effects:
        for name, found in effect.parameters.items():
            estimate = estimate_in_line(found.estimate, found.ci95)
            print(f"  {effect.name}: {effect.verdict}, {name} {estimate} {found.unit}")
    return document


if __name__ == "__main__":
    chosen = Path(*sys.argv[1:2] or ["campaigns/example_hidden"])
    record(chosen)
    main(chosen)
