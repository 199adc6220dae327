# SPDX-License-Identifier: Apache-2.0
"""The subcommands of ``impact-rs``, one per file: ``add(parser)`` declares its arguments and what runs it."""
