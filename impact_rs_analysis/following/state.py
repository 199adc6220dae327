# SPDX-License-Identifier: Apache-2.0
"""State file of a follower: a later run goes on where an earlier one ended.

It is a NumPy archive (``.npz``) with numbers alone, and one text that is a JSON document: hits of the window and the
last of every condition are kept by name and read again.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from impact_rs_analysis.following.follow import Follower
from impact_rs_sim.errors import InputError
from impact_rs_sim.files import whole

VERSION = 4
TEXT = "document"


def save_state(follower: Follower, path: Path) -> None:
    """Write the state of a follower, completely or not at all.

    Raises:
        InputError: It cannot be written.
    """
    document, arrays = follower.saved()
    text = json.dumps({"version": VERSION, **document})
    with whole(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{TEXT: np.array(text), **arrays})


def restore_state(follower: Follower, path: Path) -> int:
    """Let a new follower go on where the state was saved.

    Args:
        follower: It has seen no hit.
        path: The file.

    Returns:
        Number of hits that were seen before.

    Raises:
        InputError: It is no state file, one of another model, or a hit that it needs is gone.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        document = json.loads(str(arrays.pop(TEXT)))
        version = document["version"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("not a state file of impact-rs follow; name another, or remove it", file=path) from None
    if version != VERSION:
        raise InputError(f"a state file of version {version}, expected {VERSION}; remove it to begin anew", file=path)
    if document["model"] != follower.model.digest:
        raise InputError(
            f"the state of another model (digest {document['model']}, here {follower.model.digest}); name its model "
            "or remove the file to begin anew",
            file=path,
        )
    try:
        follower.restore(document, arrays)
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise InputError(f"a damaged state file ({error}); remove it to begin anew", file=path) from None
    return len(document["names"])
