# SPDX-License-Identifier: Apache-2.0
"""A wrong command line ends with an exit code and, for the user's mistakes, with a line that says what is wrong."""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from damage import repeatable
from hypothesis import given
from hypothesis import strategies as st

from impact_rs_cli.main import main
from impact_rs_sim.paths import config_directory

SHAPES = (  # what a command expects; words in capitals are drawn
    *("map NAME WORD WORD", "map NAME --impacts FILE", "trial FILE WORD WORD -o OUT", "campaign FILE -o OUT"),
    *(
        "analyze FILE",
        "analyze FILE -o OUT --json",
        "show FILE -o OUT",
        "export FILE -o OUT",
        "compare FILE --model FILE",
    ),
    *("diagnose FILE -o OUT --model FILE", "add WORD --from FILE -o OUT", "history FILE --runs FILE", "effects"),
    *("blind score FILE --diagnosis FILE", "friction FILE WORD WORD -o OUT", "paper --samples WORD", "WORD FILE"),
    *("robot import FILE -o OUT", "robot check FILE", "scenario new FILE -o OUT"),
)
NAMES = ("push", "grab", "excite", "franka_fer", "nominal", "joint_state")
WORDS = (
    *("cat_food", "1", "case_9", "-1", "0", "nan", "1e400", "inf", "9" * 5000, "x" * 5000, "", "a=b", "ä", "=", "k=["),
    *("control.clamp_force=[[[[", "..", "\udcff", "\x1b[31m", "--", "-", "@file", "%s", "{}", "null", "--nonsense"),
    *("no/such/file.yaml", "s3:/", "memory://nowhere", "nope://x", "file://", "1e-320", "--json", "--jobs", "--help"),
)
LONGEST = 3000  # characters of a line


@pytest.fixture(scope="module")
def files(push_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files and folders of every kind, good and damaged."""
    folder = tmp_path_factory.mktemp("wrong") / "files"
    shutil.copytree(push_campaign, folder / "runs")
    (bag, *others) = sorted(path.parent for path in (folder / "runs").glob("*/metadata.yaml"))
    for other in others:
        shutil.rmtree(other)
    (damaged,) = shutil.copytree(bag, folder / "damaged").glob("*.mcap")
    damaged.write_bytes(damaged.read_bytes()[:-100])
    noise, config = random.Random(5), config_directory()
    contents = {
        "push.yaml": (config / "scenarios" / "push.yaml").read_bytes().replace(b"mass", b"mas", 1),
        "cut.yaml": (config / "scenarios" / "grab.yaml").read_bytes()[:900],
        "model.yaml": (config / "models" / "nominal.yaml").read_bytes(),
        "list.yaml": b"[1, 2]",
        "alias.yaml": b"a: &a [1]\nb: *a\n",
        "deep.json": b"[" * 100_000,
        "other.json": b'{"format": 99}',
        "digits.json": b'{"format": ' + b"9" * 5000 + b"}",
        "table.csv": b"a,b\n1,2\n3\n",
        "empty.csv": b"",
        "robot.urdf": b"<robot name='x'><link name='a'/></robot>",
        "open.urdf": b"<robot><link",
        "entities.urdf": b"<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><robot name='&b;'/>",
        **{f"noise.{kind}": noise.randbytes(500) for kind in ("yaml", "json", "parquet", "npz", "h5", "mcap", "db3")},
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / "empty").mkdir()
    (folder / "loop").symlink_to("loop")
    return folder


@contextlib.contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """An empty working directory with a cache of its own, on one core: worker processes take seconds to start."""
    cores = os.sched_getaffinity(0)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder / "empty")
        patch.setenv("XDG_CACHE_HOME", str(folder.parent / "out" / "cache"))
        os.sched_setaffinity(0, {min(cores)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, cores)


def listing(folder: Path) -> list[tuple[str, int]]:
    return sorted((str(path), path.lstat().st_size) for path in folder.rglob("*"))


def test_a_wrong_line_ends_with_a_code_and_a_reason(files: Path) -> None:
    out = files.parent / "out"
    known = [str(path) for path in sorted(files.iterdir())] + ["/dev/null", str(files / "none")]
    drawn = {
        "FILE": st.sampled_from([*known, *WORDS]),
        "NAME": st.sampled_from([*NAMES, *known]),
        "WORD": st.sampled_from(WORDS),
        "OUT": st.sampled_from([str(out / f"x{end}") for end in ("", ".yaml", ".json", ".h5", ".parquet")]),
    }
    lines = st.sampled_from(SHAPES).flatmap(
        lambda shape: st.tuples(*(drawn.get(word, st.just(word)) for word in shape.split()))
    )
    before = listing(files)

    @repeatable(40)
    @given(lines, st.lists(st.sampled_from((*WORDS, *known)), max_size=2))
    def check(line: tuple[str, ...], more: list[str]) -> None:
        output, error = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(error):
            code = main([*line, *more])
        said = error.getvalue()
        assert code in (0, 1, 2)
        assert code != 2 or said.strip()
        assert "Traceback" not in said
        assert all(len(one) <= LONGEST for one in said.splitlines())
        assert listing(files) == before  # all that is written is the output that the line names
        shutil.rmtree(out, ignore_errors=True)

    with elsewhere(files):
        check()
