# SPDX-License-Identifier: Apache-2.0
"""Command lines that are wrong: a line and an exit code for each? ``./run python -m benchmarks.attack.commands``.

Arguments are of the shape that a command expects, with files of another kind, damaged ones, folders and numbers that
are none in their places; one line in three is at random. All lies in one folder, which must look afterwards as it did
before, but for what was written under ``out``. A line may end with 0, 1 or 2, without a traceback; with 2 it says why.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from benchmarks.attack.referee import Referee, arguments
from impact_rs_cli.main import COMMANDS, parser
from impact_rs_cli.main import main as impact_rs
from impact_rs_sim.paths import config_directory
from impact_rs_trials.campaign import make_manifest, run_campaign

SECONDS = 60.0
WORDS = (
    *("cat_food", "1", "case_9", "-1", "0", "nan", "1e400", "inf", "9" * 5000, "x" * 5000, "", "a=b", "ä", "=", "k=["),
    *("control.clamp_force=[[[[", "..", "\udcff", "\x1b[31m", "--", "-", "@file", "%s", "{}", "null", "--nonsense"),
    *("no/such/file.yaml", "s3:/", "memory://nowhere", "nope://x", "file://", "1e-320", "0.5", "2"),
)
SHIPPED = ("push", "grab", "excite", "franka_fer", "nominal", "joint_state")
LONG = {"demo", "study", "up", "make"}  # work for minutes whatever they are told, and are left out
WORK = {"campaign", "trial", "blind", "friction", "scenario"}  # would simulate with what is shipped, and never get it


def things(folder: Path) -> list[str]:
    """Files and folders of every kind, good and damaged; their paths."""
    runs = folder / "runs"
    list(run_campaign(runs, make_manifest("push", ["cat_food"], ["case_2"], [1.0], 1)))
    bag = next(path for path in runs.iterdir() if path.is_dir())
    broken = shutil.copytree(runs, folder / "broken")
    for file in (broken / bag.name).glob("*.mcap"):
        file.write_bytes(file.read_bytes()[:-100])
    chance = random.Random(5)
    contents = {
        "push.yaml": (config_directory() / "scenarios" / "push.yaml").read_bytes().replace(b"mass", b"mas", 1),
        "cut.yaml": (config_directory() / "scenarios" / "grab.yaml").read_bytes()[:900],
        "robot.yaml": (config_directory() / "robots" / "ur5e.yaml").read_bytes(),
        "model.yaml": (config_directory() / "models" / "nominal.yaml").read_bytes(),
        "list.yaml": b"[1, 2]",
        "alias.yaml": b"a: &a [1]\nb: *a\n",
        "noise.yaml": chance.randbytes(500),
        "noise.json": chance.randbytes(500),
        "deep.json": b"[" * 100_000,
        "list.json": b"[]",
        "other.json": b'{"format": 99}',
        "digits.json": b'{"format": ' + b"9" * 5000 + b"}",
        "table.csv": b"a,b\n1,2\n3\n",
        "empty.csv": b"",
        "noise.parquet": chance.randbytes(500),
        "noise.npz": chance.randbytes(500),
        "noise.h5": chance.randbytes(500),
        "noise.mcap": chance.randbytes(500),
        "noise.db3": chance.randbytes(500),
        "robot.urdf": b"<robot name='x'><link name='a'/></robot>",
        "open.urdf": b"<robot><link",
        "entities.urdf": b"<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><robot name='&b;'/>",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / "empty").mkdir()
    os.symlink("loop", folder / "loop")
    made = [runs, bag, broken, *(folder / name for name in contents), folder / "empty", folder / "loop"]
    return [
        *map(str, made),
        "/dev/null",
        "/proc/self/mem",
        str(folder / "none"),
        "memory://nowhere",
        "nope://x",
        "file://",
    ]


def shapes() -> list[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Each command, by its words, with its parser."""
    found = []
    for name, sub in _commands(parser()).items():
        if name not in LONG:
            import_module(f"impact_rs_cli.commands.{COMMANDS[name][0]}").add(sub)
            inner = _commands(sub)
            found += [((name, word), own) for word, own in inner.items() if word not in LONG] or [((name,), sub)]
    return found


def _commands(of: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    own = [action for action in of._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(own[0].choices) if own else {}


def line(
    chance: random.Random, files: list[str], out: str, shape: tuple[tuple[str, ...], argparse.ArgumentParser]
) -> list[str]:
    """A command with arguments that look as if, and are not."""
    words, of = shape
    pool = [word for word in files if words[0] not in WORK or not word.endswith("robot.yaml")]
    known = () if words[0] in WORK else SHIPPED
    targets = [f"{out}/x", f"{out}/x.yaml", f"{out}/x.json", f"{out}/x.h5", f"{out}/x.parquet", pool[1]]

    def some(action: argparse.Action) -> str:
        if action.choices and chance.random() < 0.9:
            return str(chance.choice(list(action.choices)))
        if action.dest in ("output", "mcap", "report"):
            return chance.choice(targets)
        if action.type in (int, float) and chance.random() < 0.6:
            return chance.choice(("1", "2", "0", "-1", "nan", "inf", "1e400", "0.5", "9" * 5000))
        return chance.choice((chance.choice(pool), chance.choice(pool), chance.choice((*WORDS, *known))))

    line = list(words)
    if chance.random() < 0.33:
        options = [word for action in of._actions for word in action.option_strings] or ["-o"]
        for _ in range(chance.randrange(1, 8)):
            line.append(chance.choice((chance.choice(pool), chance.choice((*WORDS, *known)), chance.choice(options))))
        return line
    for action in of._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        if action.option_strings and not action.required and chance.random() < 0.75:
            continue
        line += action.option_strings[:1]
        if action.nargs != 0:
            line += [some(action) for _ in range(chance.choice((1, 1, 2)) if action.nargs in ("+", "*") else 1)]
    return line


def listing(folder: Path) -> list[tuple[str, int]]:
    """What lies in a folder, with sizes."""
    found = [path for path in folder.rglob("*") if "out" not in path.relative_to(folder).parts]
    return sorted((str(path), path.lstat().st_size) for path in found)


@contextlib.contextmanager
def apart(folder: Path) -> Iterator[None]:
    """Stand in an empty folder, with a cache of one's own, on one core: worker processes take seconds to start."""
    place, cache, cores = os.getcwd(), os.environ.get("XDG_CACHE_HOME"), os.sched_getaffinity(0)
    os.chdir(folder / "empty")
    os.environ["XDG_CACHE_HOME"] = str(folder / "out" / "cache")
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.chdir(place)
        os.sched_setaffinity(0, cores)
        os.environ.pop("XDG_CACHE_HOME")
        if cache is not None:
            os.environ["XDG_CACHE_HOME"] = cache


def main(argv: list[str] | None = None) -> int:
    """Run the campaign."""
    options = arguments(__doc__, 2_000).parse_args(argv)
    chance, referee = random.Random(options.seed), Referee(("done", "not done", "refused"))
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        files = things(folder)
        before, known = listing(folder), shapes()
        stack.enter_context(apart(folder))

        def attack(words: list[str]) -> str:
            told, err = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(told), contextlib.redirect_stderr(err):
                code = impact_rs(words)
            if "Traceback" in err.getvalue() and "--debug" not in words:
                return "traceback"
            if code not in (0, 1, 2) or (code == 2 and not err.getvalue().strip()):
                return "badly told"
            if any(len(one) > 3000 for one in err.getvalue().splitlines()) and "--debug" not in words:
                return "told at length"
            return ("done", "not done", "refused")[code]

        for _ in range(options.count):
            words = line(chance, files, str(folder / "out"), chance.choice(known))
            referee.judge(" ".join(word[:100] for word in words), lambda words=words: attack(words), SECONDS)
            found = listing(folder)
            for path, _ in set(found) ^ set(before):
                if path.startswith(files[1]) or not any(word and path.startswith(word) for word in words):
                    referee.judge(f"{words} wrote {path}", lambda: "written elsewhere", SECONDS)
            before = found
            shutil.rmtree(folder / "out", ignore_errors=True)
    return referee.end()


if __name__ == "__main__":
    sys.exit(main())
