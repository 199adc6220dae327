# SPDX-License-Identifier: Apache-2.0
"""Whether two versions of the program print the same numbers: ``map``, ``analyze``, ``compare`` and ``diagnose``.

    ./run python -m tools.same_results OTHER_CHECKOUT --lab FOLDER... --trials FOLDER [-o DIR]

Each command runs in this checkout and in OTHER_CHECKOUT (installed by ``./run sync``) with ``--json``, once per folder
of another laboratory's runs (with ``experiment.yaml``) and once per folder of trials, which has a folder per scenario.
Results are kept in DIR, and made again only if missing. Numbers but measured times must agree to a relative 1e-9; words
and keys that differ are counted.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
TOLERANCE = 1e-9
MEASURED = ("elapsed_ms",)  # keys of times, which no two runs share
MAP = ["map", "push", "cat_food", "2", "--engine"]


def commands(laboratories: list[Path], trials: list[Path], experiment: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of every command; ``bullet`` and the default solver under the name that both versions know."""
    for engine in ("bullet", "pinocchio"):
        yield f"map-{engine}", [*MAP, engine]
    for folder in laboratories:
        arguments = [str(folder), "--experiment", str(experiment)]
        yield from (
            (f"{command}-{folder.name}", [command, *arguments]) for command in ("analyze", "compare", "diagnose")
        )
    for folder in trials:
        name = folder.parent.name if folder.name == "runs" else folder.name
        yield from ((f"{command}-{name}", [command, str(folder)]) for command in ("compare", "diagnose"))
        for scenario in sorted(path for path in folder.iterdir() if not (path / "metadata.yaml").exists()):
            yield f"analyze-{name}-{scenario.name}", ["analyze", str(scenario)]


def result(checkout: Path, name: str, arguments: list[str], cache: Path) -> Any:
    """The JSON document of a command in a checkout, from ``cache`` if it is there."""
    file = cache / f"{name}.json"
    if not file.exists():
        extra = ["-o", str(cache / f"{name}.diagnosis.json")] if arguments[0] == "diagnose" else []
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache / "cache")}  # nothing of the other version
        process = subprocess.run(
            [str(checkout / "run"), "impact-rs", *arguments, *extra, "--json"],
            cwd=checkout,
            env=environment,
            capture_output=True,
            text=True,
        )
        if process.returncode not in (0, 1):
            sys.exit(f"{checkout}: {' '.join(arguments)} ended with {process.returncode}: {process.stderr[-500:]}")
        failure = json.dumps({"not done": process.stderr})  # for example no set with enough trials for an estimate
        file.write_text(failure if process.returncode else process.stdout, encoding="utf-8")
    return json.loads(file.read_text(encoding="utf-8"))


def differences(a: Any, b: Any, path: str = "") -> Iterator[tuple[str, str, str]]:
    """Kind (``number``, ``text`` or ``key``), path and description of everything that differs."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in sorted((a.keys() | b.keys()).difference(MEASURED)):
            if key in a and key in b:
                yield from differences(a[key], b[key], f"{path}.{key}")
            else:
                yield "key", f"{path}.{key}", "only in this one" if key in a else "only in the other"
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for number, (item_a, item_b) in enumerate(zip(a, b, strict=True)):
            yield from differences(item_a, item_b, f"{path}[{number}]")
    elif isinstance(a, str) and isinstance(b, str):
        if a != b:
            yield "text", path, f"{a!r} / {b!r}"
    elif not _same(a, b):
        yield "number", path, f"{a!r} / {b!r}"


def _same(a: Any, b: Any) -> bool:
    numbers = isinstance(a, int | float) and isinstance(b, int | float)
    return math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=1e-15) if numbers else a == b


def main() -> int:
    """Compare, and print a line per command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="checkout of the other version")
    parser.add_argument("--lab", type=Path, nargs="*", default=[], help="folders of another laboratory's runs")
    parser.add_argument("--experiment", type=Path, default=Path("experiment.yaml"), help="their experiment file")
    parser.add_argument("--trials", type=Path, nargs="*", default=[], help="folders of trials")
    parser.add_argument("-o", type=Path, default=Path("same_results"), help="folder for the documents")
    args = parser.parse_args()
    unlike = 0
    folders = [path.resolve() for path in args.lab], [path.resolve() for path in args.trials]
    for name, arguments in commands(*folders, args.experiment.resolve()):
        documents = []
        for checkout in (HERE, args.other.resolve()):
            cache = args.o.resolve() / ("this" if checkout == HERE else "other")
            cache.mkdir(parents=True, exist_ok=True)
            documents.append(result(checkout, name, arguments, cache))
        all_differences = list(differences(*documents))
        counts = {
            kind: sum(difference[0] == kind for difference in all_differences) for kind in ("number", "text", "key")
        }
        unlike += counts["number"]
        print(f"{name}: " + ", ".join(f"{count} {kind}s differ" for kind, count in counts.items()), flush=True)
        for kind, path, description in [difference for difference in all_differences if difference[0] != "text"][:5]:
            print(f"  {kind} {path}: {description}")
    return int(unlike > 0)


if __name__ == "__main__":
    sys.exit(main())
