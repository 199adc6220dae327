# SPDX-License-Identifier: Apache-2.0
"""The commands of ``impact-rs``, each declared once (:mod:`impact_rs_commands.declaration`)."""

from __future__ import annotations

from impact_rs_commands import explaining, measuring, predicting
from impact_rs_commands.declaration import Command

COMMANDS: dict[str, Command] = {  # in the order of the help
    command.name: command
    for command in (
        measuring.DEMO,
        predicting.MAP,
        measuring.DESIGN,
        predicting.LIMITS,
        measuring.TRIAL,
        measuring.CAMPAIGN,
        explaining.ANALYZE,
        measuring.STUDY,
        predicting.STUDY_DESIGN,
        explaining.SHOW,
        explaining.EXPORT,
        explaining.IMPORT,
        explaining.IMPACTS,
        explaining.COMPARE,
        explaining.DIAGNOSE,
        explaining.FOLLOW,
        explaining.DISCOVER,
        explaining.ADD,
        explaining.HISTORY,
        explaining.EVIDENCE,
        predicting.EFFECTS,
        measuring.INVESTIGATE,
        measuring.BLIND,
        measuring.FRICTION,
        predicting.ROBOT,
        predicting.SCENARIO_DRAFT,
        explaining.PAPER,
        measuring.REHEARSE,
        measuring.UP,
        explaining.WORKBENCH,
    )
}


def command_named(words: str) -> Command:
    """A command, or an action of one, by its words, for example ``robot check``."""
    command = COMMANDS[words.split()[0]]
    return next((action for action in command.actions if action.name == words), command)
