# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags that were never closed, because the writing process was killed or froze.

The chunks of such a file are complete up to the last one, which their checksums confirm; index, summary and
``metadata.yaml`` are missing. The messages of the complete chunks go to a new bag with the outcome ``ABORTED``.
"""

from __future__ import annotations

from pathlib import Path

from impact_rs_trials.bags import checksums, topics
from impact_rs_trials.bags.trial_info import TrialInfo
from impact_rs_trials.bags.types import typestore
from impact_rs_trials.bags.writer import BagWriter


def recover(cut: Path, whole: Path) -> bool:
    """Write the readable messages of a truncated trial to a new bag, with the end of the recording in its reason.

    Args:
        cut: Folder of the truncated bag; it is not changed.
        whole: Folder of the new bag; must not exist yet.

    Returns:
        Whether a bag was written: the truncated bag has at least ``/trial_info``.

    Raises:
        InputError: The new bag cannot be written.
        OSError: A file cannot be read or written.
    """
    messages = [message for path in sorted(cut.glob("*.mcap")) for message in checksums.whole_messages(path)]
    first = next(((time, data) for topic, time, data in messages if topic == topics.TRIAL_INFO), None)
    if first is None:
        return False
    origin, recorded = first  # the first message of a trial, at trial time 0
    info = TrialInfo.from_message(typestore().deserialize_cdr(recorded, topics.TRIAL_INFO_TYPE))
    with BagWriter.create(whole, list(info.robots), origin_ns=origin, neighbours=info.neighbours) as bag:
        bag.describe(info)
        bag.date(cut.stat().st_mtime)
        for topic, nanoseconds, data in messages:
            bag.write_raw(topic, nanoseconds - origin, data)
        last = max(nanoseconds for _, nanoseconds, _ in messages) - origin
        bag.finish("ABORTED", f"the recording was cut off at t = {1e-9 * last:.3f} s: the recorder was killed or froze")
    return True
