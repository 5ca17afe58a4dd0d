"""Run <-> files: topics and schemas, writer, reader, importers."""
