# SPDX-License-Identifier: Apache-2.0
"""A damaged YAML file that a user writes is read, or refused in one line that names it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from damage import edited, flipped, repeatable, spliced
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_sim.effects.formula import load_formulas
from impact_rs_sim.errors import InputError
from impact_rs_sim.model import load_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.robot import load_facts
from impact_rs_sim.scenario import load_scenario
from impact_rs_sim.schema import load
from impact_rs_trials.campaign import Manifest, make_manifest
from impact_rs_trials.recordings.experiment import load_experiment
from impact_rs_trials.recordings.mapping import load_mapping

LONGEST = 2500  # characters of a message; those that list every known name are long
FORMULAS = """\
effects:
- name: cable_drag
  sentence: A cable drags behind the end effector.
  end_effector_force: {y: "-drag * vy"}
  motor_torque: {joint2: "-c * tanh(dq2 / 0.02)"}
  parameters:
    drag: {unit: N s/m, nominal: 0, lower: 0, upper: 50, scale: 1}
    c: {unit: N m, nominal: 0, lower: 0, upper: 3, scale: 0.1}
"""
MODEL = """\
name: better
parent: nominal.yaml
effects:
- name: support_friction
  parameters: {scale: {estimate: 1.6, unit: '-', ci95: [1.5, 1.7]}}
"""
EXPERIMENT = """\
scenario: push
mapping: impact_rs
runs: runs.csv
"""
VALUES = (
    *("null", "true", "-1", "0", "1e400", ".inf", ".nan", "1e-320", "9" * 5000, "0x" + "f" * 4000, "2026-13-45", "~"),
    *("!!int abc", "!!bool maybe", "!!binary x", "!!python/object:os.system {}", "!!set {a}", "? [a, b]", "12:30:45"),
    *("[]", "{}", "[[[[]]]]", "''", "'\\0'", '"\\ud800"', "../../x", ".hidden", "<script>x</script>", "<<: {a: 1}"),
    *("x" * 10_000, "[" * 3000, "{a: " * 500, "&a [x,x,x,x,x,x,x,x]", "*a", "k" * 900, "2026-01-01"),
    *("'1 +'", f"'{'9' * 330} * vy'", f"'{'(' * 199}1{')' * 199}'", "'vy ** 9 ** 9'"),
)


def shipped(path: str) -> str:
    return (config_directory() / path).read_text(encoding="utf-8")


def read_facts(path: str) -> object:
    load_facts.cache_clear()
    return load_facts(path)


FILES: dict[str, tuple[Callable[[], str], Callable[[str], object]]] = {
    "model": (lambda: MODEL, load_model),
    "formulas": (lambda: FORMULAS, load_formulas),
    "experiment": (lambda: EXPERIMENT, lambda path: load_experiment(Path(path))),
    "manifest": (
        lambda: yaml.safe_dump(make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1).model_dump(mode="json")),
        lambda path: load(Manifest, path),
    ),
    "mapping": (lambda: shipped("mappings/joint_state.yaml"), load_mapping),
    "robot": (lambda: shipped("robots/ur5e.yaml"), read_facts),
    "scenario": (lambda: shipped("scenarios/push.yaml"), load_scenario),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_damaged_file_is_read_or_refused_in_one_line(kind: str, tmp_path: Path) -> None:
    make, read = FILES[kind]
    text = make()
    file = tmp_path / f"{kind}.yaml"
    file.write_text(text, encoding="utf-8")
    read(str(file))  # what is damaged is read as it stands
    counted = iter(range(10_000))

    @repeatable(40)
    @given(
        st.one_of(
            edited(text, VALUES, ":,{"), edited(text, VALUES, ":,{"), flipped(text.encode()), spliced(text.encode())
        )
    )
    def check(content: bytes) -> None:
        damaged = tmp_path / f"{kind}_{next(counted)}.yaml"  # a name of its own: some readers remember files
        damaged.write_bytes(content)
        try:
            read(str(damaged))
        except InputError as error:
            assert "\n" not in str(error)
            assert len(str(error)) <= LONGEST
            assert damaged.name in str(error)

    check()
