"""Encoding of messages, and writing of chunks, containers and other formats."""
