"""The one expression language: parsed by us, never run as Python."""
