# SPDX-License-Identifier: Apache-2.0
"""Evidence package: the diagnosis of one laboratory on one data set, for others to verify and merge.

One JSON file holds the model that was diagnosed, the diagnosis, the digest of every file of the measurements, versions,
and who measured what. Measurements stay where they are. A seal, the digest of everything else, reveals accidental
changes; it is no signature.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from pydantic import Field

from impact_rs_analysis.diagnosis.document import MAX_JSON_BYTES, DiagnosisDocument
from impact_rs_analysis.evidence.replays.measured_runs import runs_digest
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_sim.model import Model, check_model
from impact_rs_sim.schema import Schema, read_json, validate
from impact_rs_sim.version import git_revision, package_version
from impact_rs_trials.file_names import experiment_file_in
from impact_rs_trials.store import folders_below

LIBRARIES = ("numpy", "scipy", "pin")


class FileDigest(Schema):
    """One file of the measurements."""

    path: str = Field(description="path in the folder of the measurements, with /")
    size: int = Field(ge=0, description="bytes")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="SHA-256 of its content")


class EvidencePackage(Schema):
    """``*.evidence.json``."""

    format: int = Field(1, ge=1, le=1, description="version of this format")
    laboratory: str = Field(min_length=1, description="who measured")
    robot: str = Field(min_length=1, description="which robot: kind and serial number or name")
    object: str = Field(min_length=1, description="which object was hit; 'none' in free motion")
    note: str = Field("", description="remarks of the laboratory")
    versions: dict[str, str] = Field(description="versions of program and libraries")
    model: Model = Field(description="model that was diagnosed")
    diagnosis: DiagnosisDocument = Field(description="the diagnosis")
    data: tuple[FileDigest, ...] = Field(description="files of the measurements")
    seal: str = Field("", description="SHA-256 of all of the above")

    @property
    def name(self) -> str:
        """Laboratory, robot and object."""
        return f"{self.laboratory}: {self.robot}, {self.object}"

    def sealed(self) -> EvidencePackage:
        """The package with the seal of its present content."""
        return self.model_copy(update={"seal": self._digest()})

    def repeats(self, other: EvidencePackage) -> float:
        """Share of the measurements in both packages, relative to the bytes of the smaller one [-].

        Files are compared by their digests, not by their names; measurements that were written anew are not found.
        """
        sizes, other_sizes = self._bytes(), other._bytes()
        common = sum(sizes[digest] for digest in sizes.keys() & other_sizes.keys())
        return common / max(min(sum(sizes.values()), sum(other_sizes.values())), 1)

    def _bytes(self) -> dict[str, int]:
        """Size of every file by its digest [byte]; at least 1, also for an empty file."""
        return {file.sha256: max(file.size, 1) for file in self.data}

    @property
    def intact(self) -> bool:
        """Whether the seal matches the content."""
        return self.seal == self._digest()

    def _digest(self) -> str:
        content = self.model_dump(mode="json", exclude={"seal"})
        return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@dataclass(frozen=True)
class PackageCheck:
    """Result of one check of a package.

    Attributes:
        what: The checked property.
        passed: Whether it holds.
        found: Result in words.
    """

    what: str
    passed: bool
    found: str


def make_package(
    diagnosis: DiagnosisDocument,
    model: Model,
    data: Path,
    laboratory: str,
    robot: str,
    object_name: str,
    note: str = "",
    progress: Callable[[int, int], None] = lambda *_: None,
) -> EvidencePackage:
    """A sealed package.

    Args:
        diagnosis: The diagnosis.
        model: The model that was diagnosed.
        data: Folder or file of the measurements.
        laboratory: Who measured.
        robot: Which robot.
        object_name: Which object.
        note: Remarks.
        progress: Called with the number of files read and the number of all files.

    Raises:
        InputError: The diagnosis belongs to another model or to other trials, or there are no measurements.
    """
    _check_model(diagnosis, model)
    _check_trials(diagnosis, data)
    return EvidencePackage(
        laboratory=laboratory,
        robot=robot,
        object=object_name,
        note=note,
        versions={
            "impact_rs": package_version(),
            "git_revision": git_revision(),
            "python": platform.python_version(),
            **{name: version(name) for name in LIBRARIES},
        },
        model=model,
        diagnosis=diagnosis.model_copy(update={"options": {}}),  # paths of this machine
        data=digests_of(data, progress),
    ).sealed()


def _check_model(diagnosis: DiagnosisDocument, model: Model) -> None:
    if diagnosis.model.digest != model.digest:
        raise InputError(
            f"the diagnosis is of model {diagnosis.model.name!r} (digest {diagnosis.model.digest}), not of "
            f"{model.name!r} (digest {model.digest}); give the model that was diagnosed"
        )


def _check_trials(diagnosis: DiagnosisDocument, data: Path) -> None:
    """Check that these are the trials of the diagnosis; a part, or runs of another controller, are not checked."""
    options, diagnosed = diagnosis.options, diagnosis.runs.digest
    if not diagnosed or "runs" not in options or options.keys() & {"since", "experiment"} or experiment_file_in(data):
        return
    if (digest := runs_digest(data)) != diagnosed:
        raise InputError(
            f"these are not the trials of the diagnosis (digest {digest}, expected {diagnosed}); give the folder "
            "that was diagnosed",
            file=data,
        )


def digests_of(data: Path, progress: Callable[[int, int], None] = lambda *_: None) -> tuple[FileDigest, ...]:
    """Digests of a file, or of all files below a folder except hidden ones; linked folders are followed.

    Raises:
        InputError: There is no file, or a file cannot be read.
    """
    if data.is_file():
        root, files = data.parent, [data]
    else:
        root = data
        visible = (folder / name for folder, names in folders_below(data) for name in names if not name.startswith("."))
        files = sorted(path for path in visible if path.is_file())
    if not files:
        raise InputError("no measurements here; expected the file or folder that was diagnosed", file=data)
    digests = []
    for number, path in enumerate(files, start=1):
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256")
            size = path.stat().st_size
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", file=path) from None
        digests.append(FileDigest(path=path.relative_to(root).as_posix(), size=size, sha256=digest.hexdigest()))
        progress(number, len(files))
    return tuple(digests)


def write_package(package: EvidencePackage, path: Path) -> None:
    """Write a package; an earlier one is replaced.

    Raises:
        InputError: It cannot be written.
    """
    write_whole(path, json.dumps(package.model_dump(mode="json"), indent=1, allow_nan=False) + "\n")


def read_package(path: Path) -> EvidencePackage:
    """Read a package; only its format is checked.

    Raises:
        InputError: The file is missing or no package.
    """
    data = read_json(path, "a package of evidence", MAX_JSON_BYTES)
    if not isinstance(data, dict) or "seal" not in data:
        raise InputError("not an evidence package; expected a file written by impact-rs evidence pack", file=path)
    package = validate(EvidencePackage, data, path)
    check_model(package.model, path)
    return package


def check_package(
    package: EvidencePackage, data: Path | None, progress: Callable[[int, int], None] = lambda *_: None
) -> list[PackageCheck]:
    """Check a package, and its measurements if they are at hand.

    Args:
        package: The package.
        data: Folder or file of the measurements; None: not at hand.
        progress: As for :func:`digests_of`.

    Raises:
        InputError: The measurements cannot be read.
    """
    checks = [PackageCheck("seal", package.intact, "as packed" if package.intact else "the content was changed")]
    same = package.model.digest == package.diagnosis.model.digest
    model_words = (
        package.model.digest if same else f"{package.model.digest}, diagnosed: {package.diagnosis.model.digest}"
    )
    checks.append(PackageCheck("model is the one diagnosed", same, model_words))
    effects = {effect.name for effect in package.diagnosis.effects}
    unknown = [name for name in package.diagnosis.named if name not in effects]
    checks.append(
        PackageCheck(
            "named effects have estimates", not unknown, ", ".join(unknown or package.diagnosis.named) or "none named"
        )
    )
    if data is not None:
        measured = {file.path: file.sha256 for file in digests_of(data, progress)}
        packed = {file.path: file.sha256 for file in package.data}
        problems = {
            "missing": sorted(packed.keys() - measured.keys()),
            "not in the package": sorted(measured.keys() - packed.keys()),
            "changed": sorted(path for path in packed.keys() & measured.keys() if packed[path] != measured[path]),
        }
        words = "; ".join(
            f"{problem}: {', '.join(paths[:3])}{' ...' if len(paths) > 3 else ''}"
            for problem, paths in problems.items()
            if paths
        )
        checks.append(PackageCheck("measurements", not words, words or f"{len(packed)} files as packed"))
    return checks
