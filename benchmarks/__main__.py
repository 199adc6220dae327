# SPDX-License-Identifier: Apache-2.0
"""Run a benchmark: ``./run python -m benchmarks NAME [options]``.

    ./run python -m benchmarks                list them
    ./run python -m benchmarks NAME --help    what it measures, and its options
    ./run python -m benchmarks --docs         write the tables of docs/ from benchmarks/results

``-o DIR`` keeps every case and resumes; ``--save``, the last option, keeps the table in benchmarks/results.
"""

from __future__ import annotations

import importlib
import sys

from benchmarks.harness import names, run
from benchmarks.results import write_pages


def main() -> int:
    """Run, list or write."""
    match sys.argv[1:]:
        case ["--docs"]:
            print("\n".join(write_pages()) or "all pages are as they should be")
        case [name, *words] if name in names():
            run(name, words)
        case [] | ["-h" | "--help"]:
            print(__doc__)
            for name, module in names().items():
                first = (importlib.import_module(module).__doc__ or "").splitlines()[0]
                print(f"{module.split('.')[1]:8s}  {name:22s}  {first}")
        case [name, *_]:
            print(f"no benchmark {name!r}; there are {', '.join(names())}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
