"""The files and URLs that a user names. fsspec, which reads URLs, is loaded only for these."""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
