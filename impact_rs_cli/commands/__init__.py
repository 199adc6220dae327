"""The subcommands of ``impact-rs``, one per file: ``add(subparsers)`` declares one, ``run(args, terminal)`` runs it."""
