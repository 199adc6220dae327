# SPDX-License-Identifier: Apache-2.0
"""Checksums of a bag, which reveal any changed bit.

``rosbags`` writes MCAP with checksums of 0, which mean "unknown". :func:`seal` fills them in (CRC-32, at the positions
that the format defines)::

    magic | header | chunks, message indexes, metadata | data end | summary | footer | magic
                     ^ of a chunk's messages             ^ of all before it   ^ of the summary and the footer itself

A bag holds its ``metadata.yaml`` twice, as a file and inside the MCAP file. In a sealed bag both are identical, so that
the same checksums protect the file. :func:`check` verifies all of it if the metadata of the bag declare checksums;
those of earlier versions and of other programs do not.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from textwrap import indent
from typing import Final
from zlib import crc32

from rosbags.rosbag2.storage_mcap import decompress

NAME: Final = "checksums"
KIND: Final = "crc32"  # value in the custom data of a sealed bag
METADATA = "metadata.yaml"
MAGIC = b"\x89MCAP0\r\n"
FOOTER, CHANNEL, MESSAGE, CHUNK, METADATA_RECORD, DATA_END = 0x02, 0x04, 0x05, 0x06, 0x0C, 0x0F
HEAD = 9  # bytes of a record before its content: its kind and size
CHUNK_CHECKSUM = 24  # its offset in the content of a chunk
_SAID = f"{NAME}: {KIND}\n".encode()
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_MESSAGE_HEAD = struct.Struct("<HIQ")  # channel, sequence, time; the time of publication and the message follow


class ChecksumError(Exception):
    """Bytes have changed since they were written; the message says where."""


def seal(bag: Path) -> None:
    """Add checksums to a closed bag.

    Args:
        bag: Its folder, with one MCAP file, whose custom data says ``checksums: crc32``.

    Raises:
        OSError: It cannot be written.
    """
    (path,) = bag.glob("*.mcap")
    data = bytearray(path.read_bytes())
    with path.open("r+b") as file:
        for kind, start, _ in _records(data):  # in this order: the data's end covers the checksums of its chunks
            if kind == CHUNK and _U32.unpack_from(data, start + CHUNK_CHECKSUM)[0]:
                continue  # the writer has set it
            for place, value in _checksum(data, kind, start):
                _U32.pack_into(data, place, value)
                file.seek(place)
                file.write(_U32.pack(value))
    (bag / METADATA).write_bytes(_metadata(data))


def check(bag: Path) -> bool:
    """Whether a bag is sealed; a sealed one that differs in any bit from what was written is an error.

    Args:
        bag: Its folder.

    Returns:
        False where it carries no checksums of ours: only those that it does carry are held against it.

    Raises:
        ChecksumError: A checksum is wrong, or lacks in a bag that was sealed.
        OSError: It cannot be read.
    """
    metadata = (bag / METADATA).read_bytes()
    sealed = _SAID in metadata
    for path in sorted(bag.glob("*.mcap")):
        data = path.read_bytes()
        sealed = sealed or _SAID in data  # metadata lie in the file as they are, whatever becomes of their own file
        try:
            _check_file(data, sealed)
            if sealed and _metadata(data) != metadata:
                raise ChecksumError(f"{METADATA} is not the one that was recorded")
        except (struct.error, IndexError, ValueError):
            raise ChecksumError(f"{path.name} is cut off or damaged") from None
    return sealed


def says_so(bag: Path) -> bool:
    """Whether the metadata of a bag say that it was sealed; nothing is held against it here."""
    try:
        return _SAID in (bag / METADATA).read_bytes()
    except OSError:
        return False


def unsealed_words(count: int) -> str:
    """Warning about a number of bags without checksums; empty for none."""
    if not count:
        return ""
    return (
        f"{count} bag{'s carry' if count > 1 else ' carries'} no checksums (bags of 0.1.0 and of other programs): "
        "changes of their numbers cannot be detected"
    )


def whole_messages(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Topic, time [ns] and bytes of each message of an MCAP file that was perhaps never closed.

    They end with the first chunk that is not all there, or whose checksum is not its own.

    Raises:
        OSError: The file cannot be read.
    """
    data = path.read_bytes()
    names: dict[int, str] = {}
    try:
        for kind, start, end in _contents(data, len(MAGIC), len(data)):
            if kind != CHUNK:
                continue
            chunk = _unpacked(data, start)
            if end > len(data) or _U32.unpack_from(data, start + CHUNK_CHECKSUM)[0] != crc32(chunk):
                return
            for inner, at, behind in _contents(chunk, 0, len(chunk)):
                if inner == CHANNEL:
                    names[_U16.unpack_from(chunk, at)[0]] = _text(memoryview(chunk), at + 4)[0].decode()
                elif inner == MESSAGE:
                    channel, _, nanoseconds = _MESSAGE_HEAD.unpack_from(chunk, at)
                    yield names[channel], nanoseconds, chunk[at + 22 : behind]
    except Exception:  # what breaks off or is damaged can fail anywhere inside the library
        return


def _check_file(data: bytes, sealed: bool) -> None:
    kinds = set()
    for kind, start, _ in _records(data):
        if kind == CHUNK:
            continue  # the data's end covers them, and rosbags checks each as it reads it
        for place, value in _checksum(data, kind, start):
            (found,) = _U32.unpack_from(data, place)
            if found != value and (sealed or found):
                raise ChecksumError(f"damaged: its checksum is {found:08x}, that of what is there {value:08x}")
            kinds.add(kind)
    if sealed and kinds != {DATA_END, FOOTER}:
        raise ChecksumError("damaged: its checksums are missing")


def _records(data: bytes | bytearray) -> Iterator[tuple[int, int, int]]:
    """Kind, start and end of the content of each record.

    Raises:
        ValueError: The file is no MCAP, or breaks off.
        struct.error: It breaks off.
    """
    end = len(data) - len(MAGIC)
    if not (data.startswith(MAGIC) and data.endswith(MAGIC)):
        raise ValueError("no MCAP")
    yield from _contents(data, len(MAGIC), end)


def _contents(data: bytes | bytearray, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """The same of the records between two places."""
    while at < end:
        kind, (size,) = data[at], _U64.unpack_from(data, at + 1)
        at += HEAD
        yield kind, at, at + size
        at += size
    if at != end:
        raise ValueError("breaks off")


def _checksum(data: bytes | bytearray, kind: int, start: int) -> Iterator[tuple[int, int]]:
    """Where the checksum of a record stands, and what it is to be; nothing for a record that has none."""
    view = memoryview(data)
    if kind == CHUNK:
        yield start + CHUNK_CHECKSUM, crc32(_unpacked(data, start))
    elif kind == DATA_END:
        yield start, crc32(view[: start - 9])
    elif kind == FOOTER:
        summary = _U64.unpack_from(data, start)[0]
        yield start + 16, crc32(view[summary : start + 16])


def _unpacked(data: bytes | bytearray, start: int) -> bytes:
    """The records in a chunk."""
    view = memoryview(data)
    (size,) = _U64.unpack_from(data, start + 16)
    name, packed = _text(view, start + 28)
    (length,) = _U64.unpack_from(data, packed)
    return decompress(bytes(view[packed + 8 : packed + 8 + length]), name.decode(), size, 0)


def _metadata(data: bytes | bytearray) -> bytes:
    """``metadata.yaml`` by what the MCAP file says: what ``rosbags`` writes, but for its line breaks.

    Raises:
        ValueError: It says nothing.
    """
    for kind, start, _ in _records(data):
        if kind == METADATA_RECORD:
            name, at = _text(memoryview(data), start)
            if name == b"rosbag2":
                text, _ = _text(memoryview(data), _text(memoryview(data), at + 4)[1])
                return f"rosbag2_bagfile_information:\n{indent(text.decode(), '  ')}\n".encode()
    raise ValueError("no metadata")


def _text(view: memoryview, at: int) -> tuple[bytes, int]:
    """A text that stands behind its length, and where it ends."""
    end = at + 4 + _U32.unpack_from(view, at)[0]
    return bytes(view[at + 4 : end]), end
