"""Why one run has its value: causes, contributions, luck."""
