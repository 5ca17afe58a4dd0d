"""The commands, one file each. Only this package prints and sets exit codes."""
