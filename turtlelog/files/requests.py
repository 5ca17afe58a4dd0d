"""Requests to servers through fsspec, with one-line errors."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

from turtlelog.errors import LibraryError, RemoteError, describe_error
from turtlelog.escapes import hide_secrets
from turtlelog.libraries import load_library

T = TypeVar("T")

_WAITS_S: Final = (0.1, 0.5)
"""Waiting times before a failed request is repeated [s]: three attempts in all."""

_CONNECT_S: Final = 10
STALL_S: Final = 20
"""Time without any byte after which a server counts as hanging [s]."""


class NoRangesError(Exception):
    """A server that does not support range requests."""


class ReplacedError(Exception):
    """A file that has changed since the first response."""


class AnswerError(Exception):
    """A response that cannot be used, with the reason. Repeating the request does not help."""


_BACKENDS: Final = {
    "http": "aiohttp", "https": "aiohttp", "s3": "s3fs", "s3a": "s3fs", "gs": "gcsfs",
    "gcs": "gcsfs", "az": "adlfs", "abfs": "adlfs", "abfss": "adlfs", "sftp": "paramiko",
    "ssh": "paramiko", "smb": "smbprotocol", "hf": "huggingface_hub",
}  # fmt: skip
"""Libraries that read URLs, in addition to fsspec."""


def open_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the file's name in it.

    Raises:
        LibraryError: If the library for such URLs is not installed.
        RemoteError: If no library supports such URLs, or credentials are missing.
    """
    fsspec = load_library("fsspec")
    scheme = urlsplit(url).scheme.lower()
    try:
        system, path = fsspec.core.url_to_fs(url, **_choose_options(url))
    except ImportError as err:
        package = _BACKENDS.get(scheme)
        advice = f"`pip install {package}`" if package else hide_secrets(str(err), url)
        raise LibraryError(
            f"{package or scheme}: needed for {scheme}:// URLs, and not installed; {advice}"
        ) from err
    except Exception as err:
        known = ", ".join(["https", "s3", "gs", "abfs", "sftp", "memory"])
        if "Protocol not known" in str(err):
            raise RemoteError(
                f"expected a URL that fsspec reads ({known}), found {scheme}://"
            ) from err
        raise RemoteError(_describe(err, url)) from err
    if hasattr(system, "retries"):
        system.retries = 1  # of s3fs, which would wait five times for a server that hangs
    return system, path


def require_writable(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the file's name in it, as `open_system` does."""
    if url.endswith("/"):
        raise RemoteError("expected the URL of a file to write to, found that of a folder")
    system, path = open_system(url)
    if urlsplit(url).scheme.lower() in {"http", "https"}:
        raise RemoteError("expected a URL of an object storage to write to, found one of http")
    return system, path


def find_objects(url: str) -> bool:
    """Return whether any object exists below a writable URL."""
    system, path = require_writable(url.rstrip("/"))

    def look() -> bool:
        system.invalidate_cache()
        try:
            return bool(system.ls(path, detail=False))
        except FileNotFoundError:
            return False

    return try_thrice(look, url)


def find_object(url: str) -> bool:
    """Return whether an object exists. The bucket must exist."""
    system, path = open_system(url)

    def look() -> bool:
        system.invalidate_cache()
        try:
            system.info(path)
        except FileNotFoundError:
            if urlsplit(url).scheme.lower() in _WITH_BUCKETS:
                with suppress(PermissionError):  # who may write need not be allowed to look
                    system.info(path.partition("/")[0])
            return False
        return True

    return try_thrice(look, url)


_WITH_BUCKETS: Final = frozenset({"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss"})


def put_file(source: Path, url: str) -> None:
    """Upload a local file to a URL, replacing an existing object."""
    system, path = require_writable(url)
    try_thrice(lambda: system.put_file(str(source), path), url)


def _choose_options(url: str) -> dict[str, Any]:
    """Return options with timeouts for fsspec. The user's configuration has priority."""
    if "::" in url:
        return {}  # they are told apart by nothing but the user's configuration
    scheme = urlsplit(url).scheme.lower()
    conf = dict(load_library("fsspec").config.conf.get(scheme, {}))
    if scheme in {"http", "https"}:
        try:
            from aiohttp import ClientTimeout
        except ImportError:
            return {}
        timeout = ClientTimeout(total=None, sock_connect=_CONNECT_S, sock_read=STALL_S)
        client = {"timeout": timeout, **conf.get("client_kwargs", {})}
        headers = {**conf.get("headers", {}), "Accept-Encoding": "identity"}
        # What is percent-encoded already is signed like that.
        is_encoded = url.isascii() and " " not in url
        # What is compressed is refused, and never inflated.
        client["auto_decompress"] = False
        return {"client_kwargs": client, "headers": headers, "encoded": is_encoded}
    if scheme in {"s3", "s3a"}:
        usual = {
            "connect_timeout": _CONNECT_S,
            "read_timeout": STALL_S,
            "retries": {"total_max_attempts": 1},
        }
        return {"config_kwargs": {**usual, **conf.get("config_kwargs", {})}}
    return {}


def try_thrice(ask: Callable[[], T], url: str) -> T:
    """Return the result of a request, which is repeated after temporary failures.

    Raises:
        RemoteError: If the request fails permanently, or every repetition fails.
    """
    for wait_s in (*_WAITS_S, None):
        try:
            return ask()
        except NoRangesError:
            raise
        except Exception as err:
            if wait_s is None or not _may_pass(err):
                raise RemoteError(_describe(err, url)) from err
        time.sleep(wait_s)
    raise AssertionError


def _list_causes(err: BaseException) -> list[BaseException]:
    found: list[BaseException] = []
    cause: BaseException | None = err
    while cause is not None and cause not in found:
        found.append(cause)
        cause = cause.__cause__ or cause.__context__
    return found


def _find_status(err: BaseException) -> int | None:
    for cause in _list_causes(err):
        response = getattr(cause, "response", None)
        meta = response.get("ResponseMetadata", {}) if isinstance(response, dict) else {}
        status = getattr(cause, "status", None) or meta.get("HTTPStatusCode")
        if isinstance(status, int):
            return status
    return None


_LOST: Final = ("NoCredentialsError", "PartialCredentialsError", "TokenRetrievalError")
_REPLACED: Final = ("ReplacedError", "FileExpired")
MOST_REDIRECTS: Final = 5
"""Largest number of redirects. File servers need two: to https, and from a link to a storage."""

_CIRCLES: Final = ("TooManyRedirects",)
_WILD: Final = ("HttpProcessingError",)
_CUT: Final = ("ClientPayloadError", "ServerDisconnectedError", "ConnectionResetError")
_ASIDE: Final = ("InvalidUrlRedirectClientError", "NonHttpUrlRedirectClientError")
_AWAY: Final = ("ClientConnectorError", "ClientConnectorDNSError", "EndpointConnectionError",
    "ConnectionRefusedError", "gaierror")  # fmt: skip
_SLOW: Final = ("TimeoutError", "ReadTimeoutError", "ConnectTimeoutError", "FSTimeoutError",
    "SocketTimeoutError", "ConnectionTimeoutError", "ServerTimeoutError")  # fmt: skip

_SURE: Final = (
    (_REPLACED, "expected one file throughout, found that it was replaced while it was read"),
    (
        _CIRCLES,
        f"expected the file after {MOST_REDIRECTS} redirects at most, found more: the server sends"
        " in circles",
    ),
    (_CUT, "expected all of the bytes asked for, found that the connection broke off"),
    (_WILD, "expected an answer in http, found one that breaks its rules"),
    (_ASIDE, "a redirect to something other than http or https, not followed"),
)
_LIKELY: Final = (
    (_LOST, "the credentials of the object storage are missing"),
    (_SLOW, "the server did not answer within {stall_s} s"),
    (_AWAY, "no server answers at this address"),
)
"""Meaning of errors by name, with a status and without one."""


def _describe(err: BaseException, url: str) -> str:
    """Return a one-line description of an error, without secrets."""
    names = {kind.__name__ for cause in _list_causes(err) for kind in type(cause).__mro__}
    status = _find_status(err)
    sure, likely = (
        next((said for kinds, said in table if names & {*kinds}), None)
        for table in (_SURE, _LIKELY)
    )
    if isinstance(err, AnswerError) or sure is not None:
        return sure or str(err)
    if status in {401, 403} or (isinstance(err, PermissionError) and status is None):
        return "expected a file that may be read, found no access to it (the server refuses)"
    if likely is not None:
        return likely.format(stall_s=STALL_S)
    if status == 404 or (isinstance(err, FileNotFoundError) and status is None):
        return "no object or file of this name"
    found = hide_secrets(describe_error(err), url)
    if status is not None and status >= 400:
        found = f"the server's error {status}"
    return f"expected all of the bytes asked for, found {found[:300]}"


def _may_pass(err: BaseException) -> bool:
    status, names = _find_status(err), {type(cause).__name__ for cause in _list_causes(err)}
    if names & {*_LOST, *_AWAY, *_SLOW, *_REPLACED, *_CIRCLES, *_ASIDE} or isinstance(
        err, AnswerError | PermissionError | ImportError
    ):
        return False
    if isinstance(err, FileNotFoundError) and status is None:
        return False
    return status is None or status >= 500 or status in {408, 429}
