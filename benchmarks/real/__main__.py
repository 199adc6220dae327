# SPDX-License-Identifier: Apache-2.0
"""Real data sets, diagnosed: ``./run python -m benchmarks.real --list``, then ``./run python -m benchmarks.real SET --data DIR``.

A set is a YAML file beside this one (:class:`RealSet`): where the data are, how they are read, which commands diagnose
them, and what should come out, with the source of that, written down before the first run. The data belong to others
and are not in this repository: DIR is the folder in which the command under ``get`` was run. Every set is a row of a
table in Markdown; commands, their output and the diagnosis are in the output folder.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from impact_rs_analysis.diagnosis.document import CONFIRMED, DiagnosisDocument, read_document
from impact_rs_sim.errors import InputError
from impact_rs_sim.numbers import estimate_in_line
from impact_rs_sim.schema import Schema, load

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
HEAD = ("Set", "Expected", "Said", "Estimates, 95 % interval (published)", "Held-out error", "As expected")


class Expected(Schema):
    """What a diagnosis should say."""

    source: str = Field(description="who says so")
    effects: tuple[str, ...] = Field((), description="effects that act")
    absent: tuple[str, ...] = Field((), description="effects that do not act: to confirm one would be wrong")
    values: dict[str, float] = Field({}, description="published values by EFFECT.PARAMETER, in the parameter's unit")


class RealSet(Schema):
    """A data set of others, and what was expected of it."""

    what: str = Field(description="what was recorded")
    source: str = Field(description="address of the data")
    licence: str = Field(description="licence of the data")
    get: str = Field(description="command that gets the data into the working directory")
    collect: dict[str, str] = Field({}, description="pattern below DIR of files to copy, by folder of the output")
    files: dict[str, dict[str, Any]] = Field({}, description="YAML files to write into the output folder, by name")
    steps: tuple[str, ...] = Field((), description="commands; {data} and {out} stand for the two folders")
    expected: Expected | None = Field(None, description="what the last diagnosis should say")
    shown: tuple[str, ...] = Field((), description="further estimates for the table, by EFFECT.PARAMETER")
    not_taken: str = Field("", description="why the program cannot take the data yet; empty: it can")


@dataclass(frozen=True)
class Judgement:
    """A diagnosis beside what was expected.

    Attributes:
        missed: Effects that act and were not named.
        contradicted: Effects that do not act and were confirmed.
        inside: How many published values lie in their intervals.
        values: How many there are.
    """

    missed: tuple[str, ...]
    contradicted: tuple[str, ...]
    inside: int
    values: int

    @property
    def words(self) -> str:
        """The judgement in a cell."""
        if self.contradicted:
            return f"no: {', '.join(self.contradicted)}"
        names = f"missed: {', '.join(self.missed)}" if self.missed else "names yes"
        return names + (f"; {self.inside} of {self.values} values" if self.values else "")


def judge(document: DiagnosisDocument, expected: Expected) -> Judgement:
    """What a diagnosis got right; a value of an effect that was not named counts as missed."""
    confirmed = {name for name in document.named if _effect_verdict(document, name) == CONFIRMED}
    inside = 0
    for key, truth in expected.values.items():
        name, parameter = key.split(".")
        effect = document.effect(name)
        if effect is None or parameter not in effect.parameters:
            raise InputError(f"the diagnosis has no {key}; expected EFFECT.PARAMETER of it", key="expected.values")
        low, high = effect.parameters[parameter].interval
        inside += name in document.named and low <= truth <= high
    return Judgement(
        tuple(name for name in expected.effects if name not in document.named),
        tuple(name for name in expected.absent if name in confirmed),
        inside,
        len(expected.values),
    )


def _effect_verdict(document: DiagnosisDocument, name: str) -> str:
    effect = document.effect(name)
    return "" if effect is None else effect.verdict


def run_set(one: RealSet, data: Path, out: Path) -> DiagnosisDocument:
    """Run the commands of a set; its last one leaves ``diagnosis.json``.

    Args:
        one: The set.
        data: Folder with the clones.
        out: Folder for all that is written; an earlier one is replaced.

    Raises:
        InputError: The data are not there, or a command fails.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    for folder, pattern in one.collect.items():
        found = sorted(data.glob(pattern))
        if not found:
            raise InputError(f"no {pattern} here; get the data with: {one.get}", file=data)
        (out / folder).mkdir(parents=True)
        for path in found:
            shutil.copy(path, out / folder / "_".join(path.relative_to(data).parts[-2:]))
    for name, content in one.files.items():
        (out / name).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    for step in one.steps:
        words = [word.format(data=data, out=out, here=HERE) for word in shlex.split(step)]
        program = {"impact-rs": ["-m", "impact_rs_cli.main"], "python": []}[words[0]]
        with (out / "log.txt").open("a", encoding="utf-8") as log:
            print(f"$ {shlex.join(words)}", file=log, flush=True)
            ran = subprocess.run(
                [sys.executable, *program, *words[1:]], cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, check=False
            )
        if ran.returncode:
            last = (out / "log.txt").read_text(encoding="utf-8").strip().splitlines()[-1]
            raise InputError(f"{step}: {last}", file=out / "log.txt")
    return read_document(out / "diagnosis.json")


def row(name: str, one: RealSet, document: DiagnosisDocument) -> tuple[str, ...]:
    """Cells of the table for a set that was run."""
    assert one.expected is not None
    expected = one.expected
    wanted = ", ".join(f"`{effect}`" for effect in expected.effects)
    if expected.absent:
        wanted += f"; not {', '.join(f'`{effect}`' for effect in expected.absent)}"
    said = ", ".join(f"`{effect}`{_doubt(document, effect)}" for effect in document.named) or f"`{document.verdict}`"
    estimates = [_estimate(document, key, expected.values.get(key)) for key in (*expected.values, *one.shown)]
    unit = document.error_unit
    error = f"{document.held_out_error_before:.3g} → {document.held_out_error_after:.3g} {unit}"
    return name, wanted, said, "; ".join(estimates), error, judge(document, expected).words


def _doubt(document: DiagnosisDocument, name: str) -> str:
    verdict = _effect_verdict(document, name)
    return "" if verdict == CONFIRMED else f" ({verdict})"


def _estimate(document: DiagnosisDocument, key: str, truth: float | None) -> str:
    name, parameter = key.split(".")
    effect = document.effect(name)
    if effect is None or parameter not in effect.parameters:
        return f"{parameter} not fitted"
    value = effect.parameters[parameter]
    published = "" if truth is None else f" ({truth:g})"
    return f"{parameter} {estimate_in_line(value.estimate, value.ci95)} {value.unit}{published}"


def table(rows: list[tuple[str, ...]]) -> str:
    """The table in Markdown."""
    lines = [HEAD, ("---",) * len(HEAD), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def sets() -> dict[str, RealSet]:
    """All sets by name."""
    return {path.stem: load(RealSet, path) for path in sorted(HERE.glob("*.yaml"))}


def main() -> int:
    """Run the sets that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET", help="names of sets; default: all that can be taken")
    parser.add_argument("--list", action="store_true", help="list the sets, and end")
    parser.add_argument("--data", type=Path, default=Path("."), help="folder with the clones; default: this one")
    parser.add_argument("-o", "--output", type=Path, default=Path("output/real"), help="folder for the results")
    args = parser.parse_args()
    known = sets()
    if args.list:
        for name, one in known.items():
            print(f"{name}: {one.what}\n    {one.get}  ({one.licence})")
            if one.not_taken:
                print(f"    not taken yet: {one.not_taken}")
        return 0
    rows = []
    for name in args.sets or [name for name, one in known.items() if not one.not_taken]:
        if name not in known:
            parser.error(f"no set {name}; there are {', '.join(known)}")
        if known[name].not_taken:
            parser.error(f"{name} is not taken yet: {known[name].not_taken}")
        try:
            document = run_set(known[name], args.data.resolve(), args.output.resolve() / name)
            rows.append(row(name, known[name], document))
        except InputError as error:
            rows.append((name, "", f"not run: {error}", "", "", ""))
        print(table(rows[-1:]).splitlines()[-1], file=sys.stderr, flush=True)
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
