"""The commands, one file each; only this package prints and sets exit codes."""
