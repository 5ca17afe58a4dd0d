"""The table of a sweep or of recordings: its parts on disk, its columns, its views."""
