# SPDX-License-Identifier: Apache-2.0
"""Would the tests notice a wrong line? ``./run python -m benchmarks.mutation impact_rs_sim/drive.py src/drive.cpp``.

Mutants of a Python module are made and judged by mutmut (``./run python -m pip install mutmut``), by the fast tests of
its name in the mirrored folder. ``mutation.toml`` lists wrong lines by hand: all mutants of the C++ kernel, and in
Python the gates on which a verdict turns, with the fast tests that have to notice (``--listed`` prints which one does).
It also holds the settings of mutmut. All run in ``build/mutation``, a copy of the repository; there ``mutmut browse``
shows the mutants of Python.
``--sanitise`` runs the tests of the list there, without a mutant, in a build that notices wrong accesses.
How to read the figures: ``docs/reliability.md``.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
COPY = ROOT / "build" / "mutation"
SETTINGS = tomllib.loads((HERE / "mutation.toml").read_text(encoding="utf-8"))
NOTICED = (1, 2)  # exit codes of pytest: a test failed; a test file could not be imported
STATES = ("killed", "survived", "no tests", "timeout", "not checked")
LIMIT = 600.0  # s, of the tests of a listed mutant
# Wrong accesses and undefined behaviour end the process; the libraries have to be there before Python is.
SANITISED = ("-O1", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-D_GLIBCXX_ASSERTIONS")
BINDINGS = ("-O0", "-fsanitize=address", "-D_GLIBCXX_ASSERTIONS")  # templates of pybind11 compile for minutes with more
SANITISERS = ("libasan.so", "libubsan.so", "libstdc++.so")
STOP_TIME = 20.0  # s, until mutmut has stopped


class MutationError(Exception):
    """The mutants do not fit the code, or cannot be judged; the message says why."""


@dataclass(frozen=True)
class ListedMutant:
    """One wrong line.

    Attributes:
        file: Source file, relative to the root of the repository.
        wrong: Description of the error.
        text: Content of the file with the mutation.
        tests: Test files that should notice it.
    """

    file: str
    wrong: str
    text: str
    tests: tuple[str, ...]


def listed_mutants() -> list[ListedMutant]:
    """The list in ``mutation.toml``.

    Raises:
        MutationError: An original does not stand in its file exactly once, or a test file is missing.
    """
    mutants = []
    for group in SETTINGS["lines"]:
        file, tests = group["file"], tuple(f"test/{test}.py" for test in group["tests"])
        text = (ROOT / file).read_text(encoding="utf-8")
        if missing := [test for test in tests if not (ROOT / test).is_file()]:
            raise MutationError(f"mutation.toml: {missing[0]}, which tests {file}, does not exist")
        for wrong, old, new in group["mutants"]:
            if text.count(old) != 1:
                raise MutationError(f"mutation.toml: {wrong}: {old!r} is in {file} {text.count(old)} times, not once")
            mutants.append(ListedMutant(file, wrong, text.replace(old, new), tests))
    return mutants


def tests_of(file: str) -> list[str]:
    """Tests of its name in the mirrored folder or in that of its package; without one, those that import the module.

    Raises:
        MutationError: There is none.
    """
    path = Path(file)
    folders = (ROOT / "test" / path.parent, ROOT / "test" / path.parts[0])
    patterns = (f"test_{path.stem}.py", f"test_{path.stem}_*.py", f"test_{path.parent.name}_{path.stem}.py")
    test_files = sorted({test for folder in folders for pattern in patterns for test in folder.glob(pattern)})
    if not test_files:
        module, name = re.escape(".".join(path.parent.parts)), path.stem
        importing = re.compile(rf"{module}\.{name}\b|from {module} import [^\n]*\b{name}\b")
        tests = sorted((ROOT / "test" / path.parts[0]).rglob("test_*.py"))
        test_files = [test for test in tests if importing.search(test.read_text(encoding="utf-8"))]
    if not test_files:
        raise MutationError(f"{file}: no test in test/{path.parts[0]} has its name or imports it; name one by --tests")
    return [str(test.relative_to(ROOT)) for test in test_files]


def make_copy() -> Path:
    """Copy the working tree with the compiled kernel to ``COPY``; returns the file of the kernel."""
    from impact_rs_sim import _kernel

    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout.decode().split("\0")
    shutil.rmtree(COPY, ignore_errors=True)
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (COPY / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, COPY / name)
    kernel = COPY / "impact_rs_sim" / Path(_kernel.__file__).name
    shutil.copy2(_kernel.__file__, kernel)
    return kernel


def run(
    command: list[str], tree: Path, limit: float | None = None, variables: Mapping[str, str] | None = None
) -> tuple[int | None, str]:
    """Exit code and output of a Python command in ``COPY``, whose packages are imported from ``tree``.

    ``variables`` are variables of its environment.

    Without an answer within the limit [s] the code is None, and the process and all that it has started are ended.
    """
    environment = {
        **os.environ,
        "PYTHONPATH": str(HERE / "hook"),
        "PYTHONDONTWRITEBYTECODE": "1",  # compiled code is known by size and second, which mutants may share
        "XDG_CACHE_HOME": str(COPY / "build" / "cache"),
        "IMPACT_RS_MUTANT_COPY": str(tree),
        "OMP_NUM_THREADS": "1",
        **(variables or {}),
    }
    shutil.rmtree(environment["XDG_CACHE_HOME"], ignore_errors=True)
    process = subprocess.Popen(
        [sys.executable, "-m", *command], cwd=COPY, env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=limit)
        return process.returncode, output
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)  # mutmut stops, and keeps its results
        try:
            output, _ = process.communicate(timeout=STOP_TIME)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            output, _ = process.communicate()
        return None, output


def judge_module(file: str, tests: list[str], minutes: float, jobs: int) -> tuple[Counter[str], list[str]]:
    """Mutants of a Python module by state, and the changes that survived.

    Raises:
        MutationError: mutmut is missing, or its tests fail without a mutant.
    """
    if find_spec("mutmut") is None:
        raise MutationError("mutmut is not installed: ./run python -m pip install mutmut")
    package = Path(file).parts[0]
    others = sorted(path.name for path in COPY.iterdir() if path.name not in (package, "mutants", "build"))
    settings = SETTINGS["mutmut"] | {
        "source_paths": [package],
        "only_mutate": [file],
        "pytest_add_cli_args_test_selection": tests,
        "also_copy": [package, *others],
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (COPY / "pyproject.toml").write_text("\n".join([project, "[tool.mutmut]", *lines, ""]), encoding="utf-8")
    tree = COPY / "mutants"
    shutil.rmtree(tree, ignore_errors=True)
    code, output = run(["mutmut", "run", "--max-children", str(jobs)], tree, 60.0 * minutes)
    _, listed = run(["mutmut", "results", "--all", "true"], tree)
    states = dict(re.findall(r"^ +(\S+): (.+)$", listed, re.MULTILINE))
    if not states or code not in (0, None):
        raise MutationError(f"{file}: mutmut ended with {code}:\n{output[-3000:]}")
    survivors = []
    for name in (name for name, state in states.items() if state == "survived"):
        _, diff = run(["mutmut", "show", name], tree)
        changes = [line for line in diff.splitlines() if re.match(r"[+-](?!--|\+\+)", line)]
        survivors.append("\n".join([name, *(f"    {line}" for line in changes)]))
    return Counter(state if state in STATES else "killed" for state in states.values()), survivors


def judge_listed(file: str, kernel: Path) -> tuple[Counter[str], list[str]]:
    """Listed mutants of a file by state, and those that survived.

    Raises:
        MutationError: There are none, one does not compile, or the tests fail without a mutant.
    """
    mutants = [mutant for mutant in listed_mutants() if mutant.file == file]
    if not mutants:
        raise MutationError(f"{file}: mutation.toml has no mutant of it")
    build = partial(compile_kernel, kernel) if file.endswith(".cpp") else lambda: None
    build()
    pytest = ["pytest", "-x", "-q", "-p", "no:cacheprovider"]
    code, output = run([*pytest, *dict.fromkeys(test for mutant in mutants for test in mutant.tests)], COPY)
    if code != 0:
        raise MutationError(f"{file}: tests fail without any mutant:\n{output[-3000:]}")
    states, survivors = Counter[str](), []
    source = COPY / file
    original = source.read_text(encoding="utf-8")
    for mutant in mutants:
        source.write_text(mutant.text, encoding="utf-8")
        build()
        code, output = run([*pytest, *mutant.tests], COPY, LIMIT)
        if code not in (0, None, *NOTICED):
            raise MutationError(f"{file}, {mutant.wrong}: the tests did not run:\n{output[-3000:]}")
        state = "survived" if code == 0 else "timeout" if code is None else "killed"
        states[state] += 1
        survivors += [f"{file}: {mutant.wrong}"] if code == 0 else []
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        print(f"  {state:8} {mutant.wrong}{f'  [{failed[1]}]' if failed else ''}", flush=True)
    source.write_text(original, encoding="utf-8")
    build()
    return states, survivors


def sanitise(kernel: Path) -> tuple[bool, str]:
    """Whether the tests of the kernel pass in a build that notices wrong accesses, and what was printed.

    Raises:
        MutationError: The kernel does not compile.
    """
    compile_kernel(kernel, SANITISED, BINDINGS)
    kernels = [group for group in SETTINGS["lines"] if group["file"].endswith(".cpp")]
    tests = dict.fromkeys(f"test/{test}.py" for group in kernels for test in group["tests"])
    commands = [["c++", f"-print-file-name={name}"] for name in SANITISERS]
    libraries = [
        subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() for command in commands
    ]
    # Python leaks on purpose. Without -s the report of a process that dies would be lost.
    options = {
        "ASAN_OPTIONS": "detect_leaks=0",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "LD_PRELOAD": ":".join(libraries),
    }
    code, output = run(["pytest", "-x", "-q", "-p", "no:cacheprovider", "-s", *tests], COPY, LIMIT, options)
    return code == 0, output


def compile_kernel(kernel: Path, flags: Sequence[str] = ("-O2",), of_bindings: Sequence[str] | None = None) -> None:
    """Build the kernel of the copy; what has not changed is compiled once. Bindings may have ``flags`` of their own.

    Raises:
        MutationError: It does not compile.
    """
    import pybind11

    include = [f"-I{sysconfig.get_path('include')}", f"-I{pybind11.get_include()}"]
    compiler = ["c++", "-std=c++17", "-fPIC", "-fvisibility=hidden"]
    built = COPY / "build" / "objects"
    built.mkdir(parents=True, exist_ok=True)
    commands, objects = [], []
    for source in sorted((COPY / "src").glob("*.cpp")):
        compiled_source, compiled = built / source.name, built / f"{source.stem}.o"
        objects.append(str(compiled))
        if not compiled_source.exists() or compiled_source.read_bytes() != source.read_bytes():
            source_flags = of_bindings if of_bindings is not None and source.stem.endswith("module") else flags
            commands.append([*compiler, *source_flags, *include, "-c", str(source), "-o", str(compiled)])
            shutil.copy(source, compiled_source)
    for command in [*commands, [*compiler, *flags, "-shared", *objects, "-o", str(kernel)]]:
        completed = subprocess.run(command, capture_output=True, text=True)
        if completed.returncode:
            shutil.rmtree(built)
            raise MutationError(f"{' '.join(command[-4:])}: {completed.stderr[-1000:]}")


def main() -> int:
    """Run; exit code 0: nothing survived, 1: something did, 2: mutants do not fit the code or cannot be judged."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", help="modules, or sources of the kernel, relative to the repository")
    parser.add_argument("--tests", nargs="+", help="test files in the place of those of the module's name")
    parser.add_argument("--minutes", type=float, default=10.0, help="time limit for a module; what is left is counted")
    parser.add_argument("--jobs", type=int, default=1, help="mutants of Python at a time")
    parser.add_argument("--check", action="store_true", help="only check that the list fits the code")
    parser.add_argument("--listed", action="store_true", help="judge what is listed of these files, by default of all")
    parser.add_argument(
        "--sanitise", action="store_true", help="run the kernel's tests with address and undefined-behaviour sanitizers"
    )
    options = parser.parse_args()
    rows, alive = [], 0
    try:
        listed = listed_mutants()
        if options.sanitise:
            passed, output = sanitise(make_copy())
            print(output)
            return int(not passed)
        files = options.files
        if options.listed and not files:
            files = list(dict.fromkeys(mutant.file for mutant in listed))
        if options.check or not files:
            print(f"{len(listed)} listed mutants fit the code")
            return 0
        kernel = make_copy()
        for file in files:
            began = time.monotonic()
            if options.listed or file.endswith(".cpp"):
                states, survivors = judge_listed(file, kernel)
            else:
                tests = options.tests or tests_of(file)
                print(f"{file}: {', '.join(tests)}", flush=True)
                states, survivors = judge_module(file, tests, options.minutes, options.jobs)
            alive += len(survivors)
            print("survived:" if survivors else "nothing survived", *survivors, sep="\n", flush=True)
            numbers = " | ".join(str(states[state]) for state in STATES)
            rows.append(f"| `{file}` | {numbers} | {time.monotonic() - began:.0f} s |")
    except (MutationError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"\n| File | {' | '.join(STATES)} | Time |\n|{'---|' * (len(STATES) + 2)}", *rows, sep="\n")
    return int(alive > 0)


if __name__ == "__main__":
    sys.exit(main())
