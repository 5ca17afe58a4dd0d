"""Files that a user names: small texts, TOML files, and paths that may be URLs.

fsspec, which reads object storage and http, is loaded only for URLs.
"""

from turtlelog.libraries import attach_names

__getattr__, __dir__ = attach_names(__name__, __file__)
