"""The table of a sweep or of recordings: parts on disk, columns, views."""
