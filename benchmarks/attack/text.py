# SPDX-License-Identifier: Apache-2.0
"""Mutants of YAML that users write: is each refused in one line? ``./run python -m benchmarks.attack.text``.

Read are scenarios, robots, models, formulas, mappings, experiments and manifests, each by what commands read them with.
A mutant is read, or refused (``InputError``) in one line of at most 2500 characters that names the file.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import yaml

from benchmarks.attack.referee import Referee, arguments, memory
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

SECONDS = 20.0
LONGEST = 2500  # characters of a message; those that list every known name are long
MOST_MEMORY = 200.0  # MB beyond what the program has before

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
BOMB = "&a [x,x,x,x,x,x,x,x]"
VALUES = (
    *("null", "true", "-1", "0", "1e400", ".inf", ".nan", "1e-320", "9" * 5000, "0x" + "f" * 4000, "2026-13-45"),
    *("!!int abc", "!!bool maybe", "!!binary x", "!!python/object:os.system {}", "!!set {a}", "? [a, b]", "12:30:45"),
    *(
        "[]",
        "{}",
        "[[[[]]]]",
        "''",
        "'\\0'",
        '"\\ud800"',
        "../../x",
        ".hidden",
        "<script>x</script>",
        "~",
        "<<: {a: 1}",
    ),
    *("x" * 10_000, "[" * 3000, "{a: " * 500, BOMB, "*a"),
    *("'1 +'", f"'{'9' * 330} * vy'", f"'{'(' * 199}1{')' * 199}'", "'vy ** 9 ** 9'"),
)


def value(chance: random.Random, text: str) -> str:
    """Another value of a key."""
    lines = text.splitlines()
    place = chance.choice([number for number, line in enumerate(lines) if ":" in line] or [0])
    lines[place] = f"{lines[place].partition(':')[0]}: {chance.choice(VALUES)}"
    return "\n".join(lines) + "\n"


def number(chance: random.Random, text: str) -> str:
    """A number with another sign or size."""
    places = [place for place, sign in enumerate(text) if sign in "0123456789"] or [0]
    place = chance.choice(places)
    return text[:place] + chance.choice(("-", "9e9", "1e-9", ".", "e", ",", " ")) + text[place:]


def line(chance: random.Random, text: str) -> str:
    """A line lost, twice, or indented differently."""
    lines = text.splitlines()
    place, kind = chance.randrange(len(lines)), chance.randrange(4)
    if kind == 0:
        del lines[place]
    elif kind == 1:
        lines.insert(place, lines[place])
    elif kind == 2:
        lines[place] = " " * chance.randrange(1, 5) + lines[place]
    else:
        lines[place] = lines[place].lstrip()
    return "\n".join(lines) + "\n"


def character(chance: random.Random, text: str) -> str:
    """A character that means something to YAML, or nothing to anybody."""
    place = chance.randrange(len(text))
    return text[:place] + chance.choice("&*!|>%@`{}[]:,#?-\"'\\\t\0\ufeff\u2028ä\U0001f600\n") + text[place + 1 :]


def key(chance: random.Random, text: str) -> str:
    """Another key."""
    lines = text.splitlines()
    place = chance.choice([n for n, one in enumerate(lines) if ":" in one] or [0])
    indent = len(lines[place]) - len(lines[place].lstrip())
    rest = lines[place].partition(":")[2]
    lines[place] = (
        f"{' ' * indent}{chance.choice(('k' * 900, '? [a]', '1', '~', 'true', '../x', '<<', '2026-01-01'))}:{rest}"
    )
    return "\n".join(lines) + "\n"


def part(chance: random.Random, text: str) -> str:
    """Cut off, or a part of it once more."""
    place = chance.randrange(len(text))
    return text[:place] if chance.random() < 0.5 else text + text[place:]


def bytes_of(chance: random.Random, text: str) -> bytes:
    """A bit of it."""
    data = bytearray(text.encode())
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return bytes(data)


def twice(change: Callable[[random.Random, str], str]) -> Callable[[random.Random, str], str]:
    """The same kind of change once more."""
    return lambda chance, text: change(chance, change(chance, text))


CHANGES = (value, value, value, number, line, character, key, part, twice(value), twice(character), bytes_of)


def sources() -> list[tuple[str, str, Callable[[str], object]]]:
    """Name, text and reader of each kind of file; small ones first, which are most of what is attacked."""
    config = config_directory()
    manifest = yaml.safe_dump(make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1).model_dump(mode="json"))

    def shipped(path: str) -> str:
        return (config / path).read_text(encoding="utf-8")

    def facts(path: str) -> object:
        load_facts.cache_clear()
        return load_facts(path)

    return [
        ("model", MODEL, load_model),
        ("formulas", FORMULAS, load_formulas),
        ("experiment", EXPERIMENT, lambda path: load_experiment(Path(path))),
        ("manifest", manifest, lambda path: load(Manifest, path)),
        ("mapping", shipped("mappings/joint_state.yaml"), load_mapping),
        ("robot", shipped("robots/ur5e.yaml"), facts),
        ("scenario", shipped("scenarios/push.yaml"), load_scenario),
    ]


def main(argv: list[str] | None = None) -> int:
    """Run the campaign."""
    options = arguments(__doc__, 10_000).parse_args(argv)
    chance, referee = random.Random(options.seed), Referee(("refused", "read"))
    kinds = sources()
    with tempfile.TemporaryDirectory() as folder:
        for name, text, read in kinds:  # what is attacked is read, as it stands
            path = Path(folder) / f"{name}.yaml"
            path.write_text(text, encoding="utf-8")
            read(str(path))
        before = memory()
        for count in range(options.count):
            name, text, read = chance.choice(kinds)
            change = chance.choice(CHANGES)
            mutant = change(chance, text)
            path = Path(folder) / f"{name}_{count}.yaml"
            path.write_bytes(mutant if isinstance(mutant, bytes) else mutant.encode("utf-8", "surrogatepass"))

            def attack(path: Path = path, read: Callable[[str], object] = read) -> str:
                try:
                    read(str(path))
                except InputError as error:
                    told = str(error)
                    return (
                        "refused" if "\n" not in told and len(told) <= LONGEST and path.name in told else "badly told"
                    )
                return "read"

            referee.judge(f"{getattr(change, '__name__', 'twice')} of {name}: {str(mutant)[:3000]}", attack, SECONDS)
            path.unlink()
    code = referee.end()
    return code or int(memory() - before > MOST_MEMORY)


if __name__ == "__main__":
    sys.exit(main())
