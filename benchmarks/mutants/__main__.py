# SPDX-License-Identifier: Apache-2.0
"""Would the tests notice wrong physics or statistics? ``./run python benchmarks/mutants [names] [-o docs/mutants.md]``.

Each mutant is one wrong line, written by hand because it is a mistake that people make (:mod:`areas`). It is put into
a copy of the repository, and the tests that should notice run there until the first one fails: killed. If all pass, it
has survived, and either a test or a reason is missing. Before all others comes ``crash``, a module that cannot be
imported: without it nobody would know that the copy is what is tested. And without a mutant the tests must pass.

Outcomes are kept (``--keep``) until the mutant, its file or its tests change; an interrupted run goes on where it
stopped. Outcomes do not know of changes elsewhere: ``--again`` forgets them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from pathlib import Path
from queue import SimpleQueue

import pybind11
from areas import AREAS
from mutant import Mutant, StaleMutant

from impact_rs_sim import _kernel

ROOT = Path(__file__).resolve().parents[2]
KERNEL = Path(_kernel.__file__)
HOOK = Path(__file__).resolve().parent / "hook"
KEPT = ROOT / "build" / "mutants.json"
TIMEOUT = 900.0  # s; a mutant that hangs is noticed as well
FOREIGN = 99  # exit code of hook/mutant_guard.py
NOTICED = (1, 2)  # exit codes of pytest: a test failed; a test file could not be imported

CRASH = Mutant(
    name="crash",
    file="impact_rs_sim/seeds.py",
    original="import zlib\n",
    mutated='import zlib\n\nraise RuntimeError("the mutated code runs")\n',
    wrong="nothing can be imported",
    tests=("test/impact_rs_sim/test_seeds.py",),
)


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant.

    Attributes:
        killed: Whether a test failed.
        by: That test; empty for a survivor.
        seconds: Time of its tests [s].
    """

    killed: bool
    by: str
    seconds: float


class Copies:
    """Copies of the working tree in a temporary folder, one per worker.

    Args:
        folder: Where they lie.
        count: How many.
    """

    def __init__(self, folder: Path, count: int) -> None:
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listed, cwd=ROOT, capture_output=True, check=True).stdout.decode().split("\0")
        self._folder = folder
        self._free: SimpleQueue[Path] = SimpleQueue()
        for number in range(count):
            copy = folder / f"copy{number}"
            for name in filter(None, names):
                if (ROOT / name).is_file():
                    (copy / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(ROOT / name, copy / name)
            shutil.copy2(KERNEL, copy / "impact_rs_sim")
            self._free.put(copy)

    def run(self, mutant: Mutant | None, tests: tuple[str, ...]) -> Outcome:
        """Run tests with a mutant, or without one.

        Raises:
            StaleMutant: The mutant does not fit the code.
            RuntimeError: The tests did not run, or ran on other code than the copy's.
        """
        copy = self._free.get()
        changed = None if mutant is None else copy / mutant.file
        kept = None if changed is None else changed.read_text(encoding="utf-8")
        try:
            if mutant is not None and changed is not None:
                changed.write_text(mutant.text(copy), encoding="utf-8")
                if mutant.compiled:
                    compile_kernel(copy)
            return self._test(copy, mutant, tests)
        finally:
            if changed is not None and kept is not None:
                changed.write_text(kept, encoding="utf-8")
                if mutant is not None and mutant.compiled:
                    shutil.copy2(KERNEL, copy / "impact_rs_sim")
            self._free.put(copy)

    def _test(self, copy: Path, mutant: Mutant | None, tests: tuple[str, ...]) -> Outcome:
        environment = {
            **os.environ,
            "PYTHONPATH": str(HOOK),
            "PYTHONDONTWRITEBYTECODE": "1",  # compiled code is told apart by size and second, which mutants may share
            "XDG_CACHE_HOME": str(self._folder / "cache" / ("" if mutant is None else mutant.name)),  # nothing kept
            "IMPACT_RS_MUTANT_COPY": str(copy),
            "IMPACT_RS_MUTANT_MODULE": "" if mutant is None else mutant.module,
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-p", "mutant_guard", *tests]
        began = time.monotonic()
        try:
            done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            return Outcome(True, f"no answer within {TIMEOUT:g} s", TIMEOUT)
        seconds = time.monotonic() - began
        if done.returncode == 0:
            return Outcome(False, "", seconds)
        if done.returncode not in NOTICED:
            told = "ran on other code than the copy's" if done.returncode == FOREIGN else "did not run"
            raise RuntimeError(f"the tests {told}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
        return Outcome(True, failed[1] if failed else "pytest", seconds)


def compile_kernel(copy: Path) -> None:
    """Build the compiled part of a copy, where Python finds it."""
    sources = sorted(map(str, (copy / "src").glob("*.cpp")))
    include = [f"-I{sysconfig.get_path('include')}", f"-I{pybind11.get_include()}"]
    built = copy / "impact_rs_sim" / KERNEL.name
    command = ["c++", "-std=c++17", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", *include, *sources]
    subprocess.run([*command, "-o", str(built)], check=True)


def digest(mutant: Mutant) -> str:
    """Digest of the mutant, its file and its tests."""
    content = hashlib.sha256(json.dumps(asdict(mutant)).encode())
    for name in sorted({mutant.file, *(test.partition("::")[0] for test in mutant.tests)}):
        content.update((ROOT / name).read_bytes())
    return content.hexdigest()[:16]


def chosen(patterns: list[str]) -> dict[str, list[Mutant]]:
    """Mutants by area whose name or area matches one of the patterns; all without patterns."""
    found = {
        area: [
            mutant
            for mutant in mutants
            if not patterns or any(fnmatch(mutant.name, each) or area == each for each in patterns)
        ]
        for area, mutants in AREAS.items()
    }
    return {area: mutants for area, mutants in found.items() if mutants}


def check(mutants: list[Mutant]) -> None:
    """Every mutant fits the code, and has a name of its own.

    Raises:
        StaleMutant: One does not.
    """
    names = [mutant.name for mutant in mutants]
    for mutant in mutants:
        if names.count(mutant.name) > 1:
            raise StaleMutant(f"{mutant.name}: another mutant has this name")
        mutant.text(ROOT)


def outcomes(mutants: dict[str, Mutant], jobs: int, kept: dict[str, Outcome]) -> Iterator[tuple[str, Mutant, Outcome]]:
    """Every mutant with its digest and outcome, kept ones first.

    Raises:
        RuntimeError: The tests fail without a mutant, or do not run on the copy.
    """
    for key, mutant in mutants.items():
        if key in kept:
            yield key, mutant, kept[key]
    keys = [key for key in mutants if key not in kept]
    todo = [mutants[key] for key in keys]
    if not todo:
        return
    with tempfile.TemporaryDirectory(prefix="impact_rs_mutants_") as folder:
        copies = Copies(Path(folder), jobs)
        if not copies.run(CRASH, CRASH.tests).killed:
            raise RuntimeError("a module that raises an error at its import was not noticed: the copy is not tested")
        sound = copies.run(None, tuple(sorted({test for mutant in todo for test in mutant.tests})))
        if sound.killed:
            raise RuntimeError(f"{sound.by} fails without any mutant")
        print(f"all tests pass without a mutant ({sound.seconds:.0f} s); {len(todo)} mutants", flush=True)
        with ThreadPoolExecutor(jobs) as pool:
            yield from zip(keys, todo, pool.map(lambda mutant: copies.run(mutant, mutant.tests), todo), strict=True)


def page(areas: dict[str, list[Mutant]], found: dict[str, Outcome]) -> str:
    """The table as Markdown."""
    total, killed = len(found), sum(outcome.killed for outcome in found.values())
    lines = [
        "# Mutants",
        "",
        "Would the tests notice wrong physics or statistics? Each row is one line of the sources made wrong on",
        "purpose, and the first test that failed then. Made by `./run python benchmarks/mutants -o docs/mutants.md`;",
        "the wrong lines are in [benchmarks/mutants](../benchmarks/mutants).",
        "",
        f"**{killed} of {total} mutants are killed ({100.0 * killed / total:.1f} %).** Time of a mutant's tests: "
        f"{sum(outcome.seconds for outcome in found.values()) / total:.0f} s on average.",
        "",
    ]
    survivors = [mutant for mutants in areas.values() for mutant in mutants if not found[mutant.name].killed]
    if survivors:
        lines += ["Survivors:", ""]
        lines += [f"* `{each.name}` ({each.wrong}): {each.survives or 'no test notices it'}" for each in survivors]
        lines.append("")
    for area, mutants in areas.items():
        alive = sum(not found[mutant.name].killed for mutant in mutants)
        lines += [
            f"## {area} ({len(mutants) - alive} of {len(mutants)})",
            "",
            "| Mutant | What is wrong | Killed by |",
            "|---|---|---|",
        ]
        for mutant in mutants:
            outcome = found[mutant.name]
            by = f"`{outcome.by.removeprefix('test/')}`" if outcome.killed else "**survived**"
            lines.append(f"| `{mutant.name}` | {mutant.wrong} | {by} |".replace("||", "\\|\\|"))
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Run; exit code 0: every mutant is killed or has a reason to survive, 1: one has none, 2: the list is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="names or areas of mutants, with * and ?; absent: all")
    parser.add_argument("--check", action="store_true", help="only check that every mutant fits the code")
    parser.add_argument("--list", action="store_true", help="only list them")
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument("--keep", type=Path, default=KEPT, help="file of outcomes (default: build/mutants.json)")
    parser.add_argument("--again", action="store_true", help="forget the outcomes that were kept")
    parser.add_argument("-o", "--output", type=Path, help="Markdown page with the table")
    options = parser.parse_args()
    areas = chosen(options.names)
    mutants = [mutant for group in areas.values() for mutant in group]
    try:
        check([mutant for group in AREAS.values() for mutant in group])
    except StaleMutant as error:
        print(error, file=sys.stderr)
        return 2
    if not mutants:
        print(f"no such mutant; areas: {', '.join(AREAS)}", file=sys.stderr)
        return 2
    if options.list:
        for area, group in areas.items():
            print(f"{area}:", *(f"  {mutant.name}: {mutant.wrong}" for mutant in group), sep="\n")
    if options.check or options.list:
        print(f"{len(mutants)} mutants fit the code")
        return 0
    kept: dict[str, Outcome] = {}
    if options.keep.is_file() and not options.again:
        kept = {name: Outcome(**entry) for name, entry in json.loads(options.keep.read_text()).items()}
    options.keep.parent.mkdir(parents=True, exist_ok=True)
    found = {}
    # Digests are taken here, before the copies are made: the working tree may change while the tests run.
    for key, mutant, outcome in outcomes({digest(mutant): mutant for mutant in mutants}, options.jobs, kept):
        found[mutant.name] = kept[key] = outcome
        told = f"killed by {outcome.by}" if outcome.killed else f"SURVIVED {mutant.survives}"
        print(f"{mutant.name:45s} {outcome.seconds:5.0f} s  {told}", flush=True)
        options.keep.write_text(json.dumps({name: asdict(entry) for name, entry in kept.items()}, indent=1))
    killed = sum(outcome.killed for outcome in found.values())
    print(f"{killed} of {len(found)} killed ({100.0 * killed / len(found):.1f} %)")
    if options.output is not None:
        options.output.write_text(page(areas, found), encoding="utf-8")
    return 0 if all(found[mutant.name].killed or mutant.survives for mutant in mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
