"""What a look-up met with on its way: damage, the shared store's help, and its failures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

What = Literal["artifact", "record"]
Where = Literal["local", "shared"]


@dataclass(frozen=True)
class Finding:
    """A file of the store that was not what it should be."""

    what: What
    where: Where
    path: str
    """Relative to the store."""
    finding: str
    """What was wrong, as a phrase: ``"has 12 bytes instead of 40"``."""


@dataclass
class Notes:
    """What looking up and computing one result met with; filled by the store as it goes."""

    findings: list[Finding] = field(default_factory=list)
    fetched: bool = False
    """Whether the result came from the shared store."""
    unshared: str = ""
    """Why the shared store could not be asked, or did not get the result; empty where it did."""

    def add(self, what: What, where: Where, path: str, finding: str) -> None:
        """Note a damaged file, once however often it is looked at.

        A damaged object is moved away when it is found, and is missing from then on.
        """
        if not any((f.what, f.where, f.path) == (what, where, path) for f in self.findings):
            self.findings.append(Finding(what, where, path, finding))
