"""URLs of folders that several machines share: which are accepted, and what they are opened with.

A URL names the folder and nothing else. Credentials, endpoints and other settings are those of
the protocol's own library (for s3: the environment, ``~/.aws``) and of fsspec (``~/.config/fsspec``
or variables such as ``FSSPEC_S3_ENDPOINT_URL``).
"""

from __future__ import annotations

import hashlib
import importlib
import re
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from gvr_core.errors import ConfigError

_SQUEEZED = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
_ACCEPTED = "a folder, or a URL such as s3://bucket/prefix, gs://, abfs://, sftp:// or file:///"

_S3: dict[str, Any] = {
    # The library's own limits add up to minutes of waiting for a server that is gone.
    "config_kwargs": {"connect_timeout": 5, "read_timeout": 20, "retries": {"max_attempts": 1}},
}
_SETTINGS: dict[str, dict[str, Any]] = {"s3": _S3, "s3a": _S3}


def is_url(location: Path | str) -> bool:
    """Whether this names a folder by URL and not by path.

    Raises:
        ConfigError: A URL that was made a `Path`, which loses one of its slashes.
    """
    if isinstance(location, Path):
        if _SQUEEZED.match(str(location)) and not location.exists():
            raise ConfigError(f"{str(location)!r}: a URL given as a Path", accepted="a str")
        return False
    return "://" in location


def check_url(url: str) -> str:
    """The URL without a slash at its end, if a folder can be opened by it.

    Raises:
        ConfigError: An unknown protocol, one whose package is not installed (which it names), a
            password in the URL, or a place that is none.
    """
    parts = urlsplit(url)
    shown = url
    if "@" in parts.netloc:
        shown = url.replace(parts.netloc.rpartition("@")[0], "***")
        if ":" in parts.netloc.rpartition("@")[0]:
            # It would stand in Prefect's database, in warnings and in the process list.
            raise ConfigError(
                f"{shown}: a password in the URL",
                accepted="credentials in the environment or in the configuration of fsspec",
            )
    if "::" in url or parts.query or parts.fragment or re.search(r"[\s\\*?\[\]]", url):
        raise ConfigError(f"{shown!r} is no folder's URL", accepted=_ACCEPTED)
    steps = (parts.netloc + parts.path).split("/")
    if any(step in (".", "..") for step in steps) or not any(steps):
        raise ConfigError(f"{shown!r} names no folder", accepted=_ACCEPTED)
    registry = importlib.import_module("fsspec.registry")
    try:
        registry.get_filesystem_class(parts.scheme)
    except ValueError as error:
        raise ConfigError(f"{shown}: {error}", accepted=_ACCEPTED) from error
    except ImportError as error:
        raise ConfigError(
            f"{shown}: its package is not installed: {error}",
            accepted='e.g. pip install "gvr-bench[remote]" for s3://',
        ) from error
    return url.rstrip("/")


def open_url(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the folder's path in it.

    fsspec keeps one for each process (and thread, where it must not be shared), so this is cheap.
    """
    fsspec = importlib.import_module("fsspec")
    protocol = url.partition("://")[0].lower()
    users = fsspec.config.conf.get(protocol, {})
    ours = {k: v for k, v in _SETTINGS.get(protocol, {}).items() if k not in users}
    system, path = fsspec.core.url_to_fs(url, **ours)
    if protocol in ("s3", "s3a"):
        system.retries = 2  # of its own, on top of those above
    return system, path


def url_id(url: str) -> str:
    """Sixteen digits that stand for a URL in names of folders."""
    return hashlib.sha256(url.encode()).hexdigest()[:16]
