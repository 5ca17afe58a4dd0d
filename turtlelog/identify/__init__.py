"""A robot's dynamics from commands and motion."""
