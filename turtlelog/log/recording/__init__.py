"""turtlelog's own recordings: what stands in them, how they are written and read."""
