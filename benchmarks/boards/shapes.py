# SPDX-License-Identifier: Apache-2.0
"""Hidden effects in hits of every shape: a bottle, a ball, a cylinder between two arms, two boxes, a wall.

Each campaign, on our plant, hits as its scenario says; one arm also moves there and back (``excite``).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.harness import Row, Work, share
from benchmarks.hidden import is_visible, timed_diagnosis
from benchmarks.results import Table
from impact_rs_analysis.evidence.replays.measured_runs import read_runs
from impact_rs_trials.blind import RUNS, make

SCENARIOS: Mapping[str, tuple[str, ...]] = {
    "push_bottle": ("push_bottle", "excite"),
    "hit_ball": ("hit_ball", "excite"),
    "grab_cylinder": ("grab_cylinder",),
    "push_two_boxes": ("push_two_boxes", "excite"),
    "hit_wall": ("hit_wall", "excite"),
}
HIDDEN: Mapping[str, tuple[str, ...]] = {
    "push_bottle": ("object_mass", "support_friction"),
    "hit_ball": ("object_mass", "end_effector_payload"),
    "grab_cylinder": ("object_mass", "motor_inertia_scale"),
    "push_two_boxes": ("neighbour_mass", "support_friction"),
    "hit_wall": ("pad_compliance", "joint_coulomb_friction"),
}
MAGNITUDE = 3.0  # parameter scales, as the clear ones of the board ``blind``
FIRST_SEED = 7000


@dataclass(frozen=True)
class Shape:
    """A campaign with one shape; ``effect`` None: nothing is hidden."""

    scenario: str
    effect: str | None
    seed: int

    @property
    def name(self) -> str:
        """Folder name."""
        return f"{self.scenario}__{self.effect or 'nothing'}__seed{self.seed}"


def cases(options: argparse.Namespace) -> list[Shape]:
    """Two effects and nothing, of every shape."""
    del options
    hidden = [(scenario, effect) for scenario, effects in HIDDEN.items() for effect in (*effects, None)]
    return [Shape(*scenario_and_effect, seed) for seed, scenario_and_effect in enumerate(hidden, start=FIRST_SEED)]


def run(shape: Shape, work: Work) -> Row:
    """Record, diagnose and judge one campaign."""
    kind = "null" if shape.effect is None else "single"
    recording_options = (work.map_tasks, kind, shape.effect, "small", MAGNITUDE)
    for _ in make(work.folder, shape.seed, *recording_options, scenarios=SCENARIOS[shape.scenario]):
        pass
    document = work.folder / "diagnosis.json"
    row = timed_diagnosis(document, work.folder, lambda: read_runs(work.folder / RUNS, work.map_tasks), work.map_tasks)
    return row | {"scenario": shape.scenario}


def table(rows: list[Row], options: argparse.Namespace) -> Table:
    """A row a shape."""
    del options
    lines = []
    for scenario in SCENARIOS:
        scenario_rows = [row for row in rows if row["scenario"] == scenario]
        hidden, nulls = ([row for row in scenario_rows if row["kind"] == kind] for kind in ("single", "null"))
        visible = [row for row in hidden if is_visible(row)]
        inside, total = (sum(row["covered"][side] for row in hidden) for side in (0, 1))
        lines.append(
            (
                f"`{scenario}`",
                share(row["correct"] for row in hidden),
                share(row["correct"] for row in visible),
                f"{inside} of {total}" if total else "–",
                share(row["correct"] for row in nulls),
                share(row["also_named"] for row in scenario_rows),
            )
        )
    header = (
        "", "named, or in a tie", "of those above twice the noise", "true parameters in their 95 % intervals",
        "nothing hidden: `NOTHING-MISSING`", "a name neither there nor confusable",
    )  # fmt: skip
    return Table(header, tuple(lines))
