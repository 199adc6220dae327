# SPDX-License-Identifier: Apache-2.0
"""What a mutant is: one wrong line of physics or statistics, and the tests that should notice it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


class StaleMutant(Exception):
    """The code has moved on; the message says which mutant no longer fits and how."""


@dataclass(frozen=True)
class Mutant:
    """One wrong line.

    Attributes:
        name: Unique name, in lower case with underscores.
        file: Source file, seen from the root of the repository.
        original: Text that stands in it exactly once.
        mutated: What stands there instead.
        wrong: What is wrong then, in one sentence.
        tests: Test files or single tests (``file::test``) that should notice, the quickest first.
        survives: Why no test can or shall notice it, where that is known; empty otherwise.
    """

    name: str
    file: str
    original: str
    mutated: str
    wrong: str
    tests: tuple[str, ...]
    survives: str = ""

    @property
    def compiled(self) -> bool:
        """Whether the file is C++."""
        return self.file.endswith(".cpp")

    @property
    def module(self) -> str:
        """Name under which Python imports the file; all of C++ is one module, and a page is that of its server."""
        if self.compiled:
            return "impact_rs_sim._kernel"
        if not self.file.endswith(".py"):
            return "impact_rs_workbench.server"
        return self.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    def text(self, root: Path) -> str:
        """Content of the file with the mutation.

        Args:
            root: Root of the repository, or of a copy.

        Raises:
            StaleMutant: The original text does not stand in the file exactly once, or a test file is missing.
        """
        path = root / self.file
        if not path.is_file():
            raise StaleMutant(f"{self.name}: {self.file} is not there")
        text = path.read_text(encoding="utf-8")
        found = text.count(self.original)
        if found != 1:
            raise StaleMutant(f"{self.name}: its original text stands {found} times in {self.file}, expected once")
        if self.original == self.mutated:
            raise StaleMutant(f"{self.name}: changes nothing")
        for test in self.tests:
            file, _, function = test.partition("::")
            if not (root / file).is_file():
                raise StaleMutant(f"{self.name}: there is no test file {file}")
            if f"def {function.partition('[')[0]}" not in (root / file).read_text(encoding="utf-8"):
                raise StaleMutant(f"{self.name}: there is no test {test}")
        return text.replace(self.original, self.mutated)
