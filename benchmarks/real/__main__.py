# SPDX-License-Identifier: Apache-2.0
"""Public sets of real data, diagnosed: ``./run python -m benchmarks.real SET --data DIR``; ``--list`` names the sets.

A set is a YAML file beside this one (:class:`RealSet`): where the data are, how they are read, which commands diagnose
them, and what should come out, with the source of that, written down before the first run. The data belong to others
and are not in this repository: DIR is the folder in which the command under ``get`` was run. Every set is a row of a
table in Markdown; commands, their output and the diagnosis are in the output folder. ``--pictures docs/images`` draws
the pictures of docs/real_data.md, ``real_SET.png``.
"""

from __future__ import annotations

import argparse
import datetime
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from benchmarks.real.pictures import draw, tracks_of
from benchmarks.results import Results, Table
from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EstimateDocument, read_document
from impact_rs_analysis.diagnosis.verdict import CONFIRMED, DiagnosisVerdict, Kind
from impact_rs_sim.errors import InputError
from impact_rs_sim.numbers import estimate_in_line
from impact_rs_sim.schema import Schema, load

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
NOT_RUN = "not run"
HEAD = ("Set", "Expected", "Said", "Estimates, 95 % interval (expected)", "Held-out error", "Judged")


class Expected(Schema):
    """What a diagnosis should say."""

    source: str = Field(description="who says so")
    effects: tuple[str, ...] = Field((), description="effects that act")
    absent: tuple[str, ...] = Field((), description="effects that do not act: to confirm one would be wrong")
    known: dict[str, float] = Field({}, description="weighed or built in, by EFFECT.PARAMETER, in the parameter's unit")
    published: dict[str, float] = Field({}, description="estimates of others, as known")


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
    picture: str = Field("", description="table of impacts in the output folder that --pictures draws; empty: none")
    not_taken: str = Field("", description="why the program cannot take the data yet; empty: it can")


@dataclass(frozen=True)
class Judgement:
    """A diagnosis beside what was expected.

    Attributes:
        missed: Effects that act and were not named.
        contradicted: Effects that do not act and were confirmed.
        doubted: Effects that do not act and were named among others that the data cannot distinguish from them.
        known: Whether the interval contains a value that is known, for each of them.
        published: The same of estimates of others.
    """

    missed: tuple[str, ...]
    contradicted: tuple[str, ...]
    doubted: tuple[str, ...]
    known: tuple[bool, ...]
    published: tuple[bool, ...]

    @property
    def words(self) -> str:
        """The judgement in a cell."""
        parts = [
            f"{label}: {', '.join(names)}"
            for label, names in (("wrong", self.contradicted), ("missed", self.missed), ("in doubt", self.doubted))
            if names
        ]
        parts += [
            f"{sum(inside)} of {len(inside)} {label} values"
            for label, inside in (("known", self.known), ("published", self.published))
            if inside
        ]
        return "; ".join(parts if self.missed or self.contradicted else ["names yes", *parts])


def judge(document: DiagnosisDocument, expected: Expected) -> Judgement:
    """What a diagnosis got right; a value of an effect that was not named counts as outside."""
    named = set(document.named)
    confirmed = {name for name in named if _effect_verdict(document, name) == CONFIRMED}

    def inside(values: dict[str, float]) -> tuple[bool, ...]:
        contained = []
        for key, truth in values.items():
            low, high = _parameter(document, key).interval
            contained.append(key.split(".")[0] in named and low <= truth <= high)
        return tuple(contained)

    return Judgement(
        tuple(name for name in expected.effects if name not in named),
        tuple(name for name in expected.absent if name in confirmed),
        tuple(name for name in expected.absent if name in named - confirmed),
        inside(expected.known),
        inside(expected.published),
    )


def _parameter(document: DiagnosisDocument, key: str) -> EstimateDocument:
    """The estimate of EFFECT.PARAMETER."""
    name, parameter = key.split(".")
    effect = document.effect(name)
    if effect is None or parameter not in effect.parameters:
        raise InputError("the diagnosis has no such estimate; expected EFFECT.PARAMETER of it", key=key)
    return effect.parameters[parameter]


def _effect_verdict(document: DiagnosisDocument, name: str) -> DiagnosisVerdict | None:
    effect = document.effect(name)
    return None if effect is None else effect.verdict


def run_set(real_set: RealSet, data: Path, out: Path) -> DiagnosisDocument:
    """Run the commands of a set; its last one leaves ``diagnosis.json``.

    Args:
        real_set: The set.
        data: Folder with the clones.
        out: Folder for all that is written; an earlier one is replaced.

    Raises:
        InputError: The data are not there, or a command fails.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    for folder, pattern in real_set.collect.items():
        paths = sorted(data.glob(pattern))
        if not paths:
            raise InputError(f"no {pattern} here; get the data with: {real_set.get}", file=data)
        (out / folder).mkdir(parents=True)
        for path in paths:
            shutil.copy(path, out / folder / "_".join(path.relative_to(data).parts[-2:]))
    for name, content in real_set.files.items():
        (out / name).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    for step in real_set.steps:
        words = [word.format(data=data, out=out, here=HERE) for word in shlex.split(step)]
        program = {"impact-rs": ["-m", "impact_rs_cli.main"], "python": []}[words[0]]
        with (out / "log.txt").open("a", encoding="utf-8") as log:
            print(f"$ {shlex.join(words)}", file=log, flush=True)
            completed = subprocess.run(
                [sys.executable, *program, *words[1:]], cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, check=False
            )
        if completed.returncode:
            last_line = (out / "log.txt").read_text(encoding="utf-8").strip().splitlines()[-1]
            raise InputError(f"{step}: {last_line}", file=out / "log.txt")
    return read_document(out / "diagnosis.json")


def row(name: str, expected: Expected, shown: Sequence[str], document: DiagnosisDocument) -> tuple[str, ...]:
    """Cells of the table for a set that was run."""
    expected_names = ", ".join(f"`{effect}`" for effect in expected.effects)
    if expected.absent:
        expected_names += f"; not {', '.join(f'`{effect}`' for effect in expected.absent)}"
    named = ", ".join(f"`{effect}`{_doubt(document, effect)}" for effect in document.named) or f"`{document.verdict}`"
    truths = expected.known | expected.published
    estimates = [_estimate(document, key, truths.get(key)) for key in (*truths, *shown)]
    before, after = document.held_out_error_before, document.held_out_error_after
    error = f"{before:.3g} → {after:.3g} {document.error_unit}"
    return name, expected_names, named, "; ".join(estimates), error, judge(document, expected).words


def _doubt(document: DiagnosisDocument, name: str) -> str:
    verdict = _effect_verdict(document, name)
    if verdict is None or verdict == CONFIRMED:
        return ""
    return (
        f" (not distinguished from {', '.join(verdict.names)})" if verdict.kind is Kind.CONFUSABLE else f" ({verdict})"
    )


def _estimate(document: DiagnosisDocument, key: str, truth: float | None) -> str:
    value = _parameter(document, key)
    unit = "" if value.unit == "-" else f" {value.unit}"
    expected = "" if truth is None else f" ({truth:g})"
    return f"{key.split('.')[1]} {estimate_in_line(value.estimate, value.ci95)}{unit}{expected}"


def table(rows: list[tuple[str, ...]]) -> str:
    """The table in Markdown."""
    return Table(HEAD, tuple(tuple(cell.replace("|", "/") for cell in line) for line in rows)).markdown


def save(rows: Sequence[tuple[str, ...]]) -> None:
    """Put rows of sets that were run into the results, each with its day."""
    day = datetime.date.today().isoformat()
    new = {line[0]: (*line, day) for line in rows if line[-1] != NOT_RUN}
    all_rows = {line[0]: line for line in Results.read("real").rows} | new
    Results.measured("./run python -m benchmarks.real", Table((*HEAD, "Measured"), tuple(all_rows.values()))).save(
        "real"
    )


def sets() -> dict[str, RealSet]:
    """All sets by name."""
    return {path.stem: load(RealSet, path) for path in sorted(HERE.glob("*.yaml"))}


def total(judgements: Sequence[Judgement]) -> str:
    """All sets in one line."""
    right = sum(not (judgement.missed or judgement.contradicted) for judgement in judgements)
    known, published = (
        [v for judgement in judgements for v in getattr(judgement, name)] for name in ("known", "published")
    )
    wrong = sum(bool(judgement.contradicted) for judgement in judgements)
    return (
        f"{len(judgements)} sets: names as expected in {right}, wrong names in {wrong}; inside their intervals are "
        f"{sum(known)} of {len(known)} known values and {sum(published)} of {len(published)} published estimates"
    )


def main() -> int:
    """Run the sets that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET", help="names of sets; default: all that can be taken")
    parser.add_argument("--list", action="store_true", help="list the sets, and end")
    parser.add_argument("--data", type=Path, default=Path("."), help="folder with the clones; default: this one")
    parser.add_argument("-o", "--output", type=Path, default=Path("output/real"), help="folder for the results")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="also draw sets of impacts: DIR/real_SET.png")
    parser.add_argument("--save", action="store_true", help="keep the rows in benchmarks/results/real.json")
    args = parser.parse_args()
    real_sets = sets()
    if args.list:
        for name, real_set in real_sets.items():
            print(f"{name}: {real_set.what}\n    {real_set.get}  ({real_set.licence})")
            if real_set.not_taken:
                print(f"    not taken yet: {real_set.not_taken}")
        return 0
    if unknown := set(args.sets) - set(real_sets):
        parser.error(f"no set {', '.join(unknown)}; there are {', '.join(real_sets)}")
    rows, judgements = [], []
    for name in args.sets or real_sets:
        real_set = real_sets[name]
        try:
            if real_set.expected is None:
                raise InputError(f"not taken yet: {real_set.not_taken}")
            document = run_set(real_set, args.data.resolve(), args.output.resolve() / name)
            rows.append(row(name, real_set.expected, real_set.shown, document))
            judgements.append(judge(document, real_set.expected))
            if real_set.picture and args.pictures is not None:
                args.pictures.mkdir(parents=True, exist_ok=True)
                tracks = tracks_of(args.output.resolve() / name / real_set.picture, document)
                draw(tracks, args.pictures / f"real_{name}.png")
        except InputError as error:
            rows.append((name, "", str(error), "", "", NOT_RUN))
        print(table(rows[-1:]).splitlines()[-1], file=sys.stderr, flush=True)
    print(f"{table(rows)}\n\n{total(judgements)}")
    if args.save:
        save(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
