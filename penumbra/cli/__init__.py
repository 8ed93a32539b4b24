"""The subcommands of penumbra: one file each, its arguments beside its run."""
