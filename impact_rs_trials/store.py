# SPDX-License-Identifier: Apache-2.0
"""Storage of a campaign: a folder, or a URL that fsspec supports (``s3://bucket/push``).

A bag in a folder gets its name when it is complete. At a URL a folder cannot be renamed atomically, so
``metadata.yaml`` is uploaded last: a bag that has it is complete.

A place that cannot be used, read or written, or that another process works on, raises :class:`InputError` everywhere.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import socket
import tempfile
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from impact_rs_sim.errors import InputError
from impact_rs_sim.files import write_whole
from impact_rs_trials.file_names import BAG_METADATA, SENSITIVITY

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

BAG_FILES = (".mcap", ".db3")  # endings of files of messages
LOCK = ".lock"
# Keys of fsspec file systems for size, time and checksum of a file; never the time of reading.
CHANGES = ("size", "mtime", "created", "updated", "last_modified", "LastModified", "etag", "ETag")


def is_url(place: str | Path) -> bool:
    """Whether a place is meant as a URL; ``file://`` is one, too."""
    return "://" in str(place)


def is_bag(folder: Path) -> bool:
    """Whether a folder is a rosbag2 bag, of any program."""
    try:
        with (folder / BAG_METADATA).open("rb") as file:
            return b"rosbag2_bagfile_information" in file.read(4096)
    except OSError:
        return False


def trials_in(folder: Path) -> list[Path]:
    """Trials directly in a campaign, also damaged ones: folders with files of a bag or without any, bare files.

    Hidden folders are half-written trials and left out; a link to another trial of the folder is no further trial.
    """
    trials = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or (path.is_symlink() and path.resolve().parent == folder.resolve()):
            continue
        if path.is_dir():
            names = [entry.name for entry in path.iterdir()]
            if not names or any(map(_is_of_bag, names)):
                trials.append(path)
        elif path.suffix in BAG_FILES:
            trials.append(path)
    return trials


def trials_below(folder: Path) -> list[Path]:
    """Trials at any depth below a folder, also damaged ones: folders with files of a bag.

    Hidden folders are half-written trials and left out. Trials with a varied setting are left out, too: they are no
    repeats of the trials with which they are compared.

    Raises:
        InputError: The folder does not exist.
    """
    store = Folder(folder)
    return sorted(
        folder / name for name in store.stamps() if not Path(store.path.name, name).match(f"{SENSITIVITY}/*_x*/*")
    )


def folders_below(folder: Path) -> Iterator[tuple[Path, list[str]]]:
    """A folder and all folders below it, without hidden ones, with the names of their files; linked folders last."""
    waiting, visited = [folder], set()
    while waiting:
        for path, folders, files in os.walk(waiting.pop(0)):
            status = os.stat(path)
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            if (status.st_dev, status.st_ino) in visited:
                folders.clear()
                continue
            visited.add((status.st_dev, status.st_ino))
            folder_path = Path(path)
            waiting += [folder_path / name for name in folders if (folder_path / name).is_symlink()]
            yield folder_path, files


def _is_of_bag(name: str) -> bool:
    """Whether a file of that name belongs to a bag."""
    return name == BAG_METADATA or name.endswith(BAG_FILES)


def _stamp(facts: Iterable[tuple[object, ...]]) -> int:
    """A hash of 64 bits of facts about files, independent of their order."""
    return int.from_bytes(hashlib.blake2b(repr(sorted(facts)).encode(), digest_size=8).digest())


class Store(ABC):
    """A place that holds files and bags by their name."""

    @abstractmethod
    def __str__(self) -> str:
        """Path or URL of the place."""

    @abstractmethod
    def exists(self, name: str) -> bool:
        """Whether a file or a complete bag of that name exists."""

    @abstractmethod
    def names(self) -> set[str]:
        """Names of all complete bags, and possibly of files."""

    @abstractmethod
    def stamps(self) -> dict[str, int]:
        """A number for every bag at any depth, by its path below the place; it changes if the bag is written again.

        Hidden bags are left out. No file is opened.
        """

    @abstractmethod
    def read(self, name: str) -> str:
        """Text of a file."""

    @abstractmethod
    def write(self, name: str, text: str) -> None:
        """Write a file of text; makes the place and the folder of the file."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file, where it is there."""

    @abstractmethod
    def adding(self, name: str) -> AbstractContextManager[Path]:
        """A context manager with a folder in which to make the bag ``name``; a bag is stored if no error occurs."""

    @abstractmethod
    def getting(self, name: str) -> AbstractContextManager[Path]:
        """A context manager with a folder that has the bag ``name``."""


class Folder(Store):
    """A folder of this machine, or a shared folder that has the same path on all machines.

    Args:
        path: Path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()  # a worker process may stand elsewhere

    def __str__(self) -> str:
        return str(self.path)

    def exists(self, name: str) -> bool:
        """Whether a name exists; half-written bags have temporary names."""
        return (self.path / name).exists()

    def names(self) -> set[str]:
        """Names of everything in the folder."""
        return set(os.listdir(self.path)) if self.path.is_dir() else set()

    def stamps(self) -> dict[str, int]:
        """Fingerprints of all bags, also damaged ones, from sizes and times of their files."""
        if not self.path.is_dir():
            raise InputError("no such file or folder" if self.path.suffix else "no such folder", file=self.path)
        stamps = {}
        for folder, files in folders_below(self.path):
            if any(map(_is_of_bag, files)):
                with suppress(FileNotFoundError):  # it was removed since
                    facts = [(name, (folder / name).stat()) for name in files]
                    stamps[os.path.relpath(folder, self.path)] = _stamp(
                        (name, status.st_size, status.st_mtime_ns) for name, status in facts
                    )
        return stamps

    def read(self, name: str) -> str:
        """Text of a file."""
        try:
            return (self.path / name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read: {error}", file=self.path / name) from None

    def write(self, name: str, text: str) -> None:
        """Write a file of text."""
        write_whole(self.path / name, text)

    def remove(self, name: str) -> None:
        """Remove a file, and its folder if it is empty then."""
        path = self.path / name
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"cannot be removed: {error.strerror}", file=path) from None
        if path.parent != self.path:
            with suppress(OSError):  # something else is in there
                path.parent.rmdir()

    @contextmanager
    def adding(self, name: str) -> Iterator[Path]:
        """The folder itself: bags are written in place."""
        del name
        yield self.path

    @contextmanager
    def getting(self, name: str) -> Iterator[Path]:
        """The folder itself."""
        del name
        yield self.path


class Remote(Store):
    """A place that fsspec reaches by its URL.

    Args:
        url: URL, for example ``s3://bucket/push``.
        files: File system of fsspec.
        root: Path of the place in that file system.
    """

    def __init__(self, url: str, files: AbstractFileSystem, root: str) -> None:
        self.url = url
        self._files = files
        self._root = root

    @classmethod
    def at(cls, url: str) -> Remote:
        """The place of a URL."""
        from fsspec.core import url_to_fs

        try:
            return cls(url.rstrip("/"), *url_to_fs(url.rstrip("/")))
        except (ImportError, ValueError) as error:
            raise InputError(f"this URL cannot be used: {error}", file=url) from None

    def __str__(self) -> str:
        return self.url

    def exists(self, name: str) -> bool:
        """Whether there is a file of that name, or a bag with its metadata."""
        self._files.invalidate_cache()
        path = f"{self._root}/{name}"
        return bool(self._files.isfile(path) or self._files.isfile(f"{path}/{BAG_METADATA}"))

    def names(self) -> set[str]:
        """Names of all complete bags."""
        self._files.invalidate_cache()
        return {path.rsplit("/", 2)[-2] for path in self._files.glob(f"{self._root}/*/{BAG_METADATA}")}

    def read(self, name: str) -> str:
        """Text of a file."""
        try:
            return str(self._files.cat_file(f"{self._root}/{name}").decode("utf-8"))
        except Exception as error:  # every file system of fsspec has errors of its own
            raise InputError(f"cannot be read: {type(error).__name__}: {error}", file=f"{self.url}/{name}") from None

    def write(self, name: str, text: str) -> None:
        """Write a file of text."""
        try:
            self._files.makedirs(f"{self._root}/{name}".rsplit("/", 1)[0], exist_ok=True)
            self._files.pipe_file(f"{self._root}/{name}", text.encode("utf-8"))
        except Exception as error:  # as above
            raise InputError(f"cannot be written: {type(error).__name__}: {error}", file=f"{self.url}/{name}") from None

    def remove(self, name: str) -> None:
        """Remove a file, where it is there."""
        try:
            self._files.invalidate_cache()
            if self._files.isfile(f"{self._root}/{name}"):
                self._files.rm_file(f"{self._root}/{name}")
        except Exception as error:  # as above
            raise InputError(f"cannot be removed: {type(error).__name__}: {error}", file=f"{self.url}/{name}") from None

    @contextmanager
    def adding(self, name: str) -> Iterator[Path]:
        """A temporary folder of this machine, from which the bag is uploaded."""
        with tempfile.TemporaryDirectory(prefix="impact_rs_") as scratch:
            yield Path(scratch)
            bag, target = Path(scratch) / name, f"{self._root}/{name}"
            if bag.is_dir():  # an aborted trial may have none
                self._files.makedirs(target, exist_ok=True)
                for file in sorted(bag.iterdir(), key=lambda file: file.name == BAG_METADATA):
                    self._files.put_file(str(file), f"{target}/{file.name}")

    @contextmanager
    def getting(self, name: str) -> Iterator[Path]:
        """A temporary folder of this machine with a copy of the bag."""
        with tempfile.TemporaryDirectory(prefix="impact_rs_") as scratch:
            self.copy(name, Path(scratch))
            yield Path(scratch)

    def stamps(self) -> dict[str, int]:
        """Stamps of complete bags from size, time and checksum of their files, as far as the file system has them."""
        self._files.invalidate_cache()
        try:
            files = self._files.find(self._root, detail=True)
        except Exception as error:  # as above
            raise InputError(f"cannot be read: {type(error).__name__}: {error}", file=self.url) from None
        bags: dict[str, list[tuple[object, ...]]] = defaultdict(list)
        for path, facts in files.items():
            folder, _, name = path.split(f"{self._root}/", 1)[1].rpartition("/")
            bags[folder].append((name, *(str(facts.get(key)) for key in CHANGES)))
        return {
            folder: _stamp(facts)
            for folder, facts in bags.items()
            if any(fact[0] == BAG_METADATA for fact in facts)
            and not any(part.startswith(".") for part in folder.split("/"))
        }

    def copy(self, name: str, directory: Path) -> None:
        """Copy a bag into a folder of this machine, at the same path below it."""
        (directory / name).mkdir(parents=True)
        for path in self._files.ls(f"{self._root}/{name}", detail=False):
            self._files.get_file(path, str(directory / name / path.rsplit("/", 1)[-1]))


def open_store(place: str | Path | Store) -> Store:
    """The store at a place: a path or a URL."""
    if isinstance(place, Store):
        return place
    if not is_url(place):
        return Folder(place)
    protocol, _, path = str(place).partition("://")
    return Folder(path) if protocol in ("file", "local") else Remote.at(str(place))


@contextmanager
def local_copy(
    place: str | Path, files: tuple[str, ...] = (), progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[Path]:
    """A local folder with the bags of a folder or URL: the folder itself, or a temporary copy.

    Args:
        place: Path or URL.
        files: Names of further files to copy if they exist.
        progress: Progress callback, called with the number of copied bags and of all bags.
    """
    store = open_store(place)
    if not isinstance(store, Remote):
        yield Path(place) if not is_url(place) else Path(str(store))
        return
    with tempfile.TemporaryDirectory(prefix="impact_rs_") as scratch:
        try:
            bags = sorted(store.stamps())
            for number, name in enumerate(bags, start=1):
                store.copy(name, Path(scratch))
                progress(number, len(bags))
            for name in filter(store.exists, files):
                (Path(scratch) / name).write_text(store.read(name), encoding="utf-8")
        except InputError:
            raise
        except Exception as error:  # every file system of fsspec has errors of its own
            raise InputError(f"cannot be read: {type(error).__name__}: {error}", file=str(place)) from None
        if not bags:
            raise InputError("no bags of trials here", file=str(place))
        yield Path(scratch)


@contextmanager
def owned(store: Store, contents: str = "campaign") -> Iterator[None]:
    """Keep other processes from a folder; the lock ends with this process, however it ends.

    A URL cannot be locked: two campaigns on one URL waste work, but every bag is still one whole trial.

    Args:
        store: The folder.
        contents: Contents of the folder in words, for the error.
    """
    if not isinstance(store, Folder):
        yield
        return
    path = store.path / LOCK
    with _locked(path, contents) as file:
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _locked(path: Path, contents: str) -> TextIO:
    """An open file with an exclusive lock, released when the file is closed."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("a+", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=path) from None
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            owner = file.read().strip() or "another process"
            file.close()
            raise InputError(f"{owner} works on this {contents}; wait for it, or stop it", file=path.parent) from None
        except OSError as error:
            file.close()
            raise InputError(
                f"cannot be locked: {error.strerror}; choose a folder on a file system with locks", file=path
            ) from None
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()  # its owner removed it between our two calls
