"""One line of the table of faults, and the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass
class Line:
    """How often a fault was tried, and what it cost."""

    part: str
    """Of the script: ``--only`` takes it."""
    fault: str
    tried: int = 0
    survived: int = 0
    losses: list[str] = field(default_factory=list)
    """What did not survive, as phrases."""
    note: str = ""
    """A number that belongs to it, e.g. the longest delay."""
    skipped: str = ""
    """Why it was not tried here."""

    def add(self, losses: Sequence[str], where: str = "") -> None:
        """Count one try."""
        self.tried += 1
        self.survived += not losses
        self.losses += [f"{where}: {loss}" if where else loss for loss in losses]

    @property
    def lost(self) -> int:
        """Tries that lost something."""
        return self.tried - self.survived


def markdown(lines: Sequence[Line], command: str) -> str:
    """The table of faults."""
    head = (
        "| fault | tried | survived | lost | | command |\n| --- | ---: | ---: | ---: | --- | --- |"
    )
    rows = [
        f"| {line.fault} | {line.tried} | {line.survived} | {line.lost} "
        f"| {(line.skipped and 'skipped: ' + line.skipped) or line.note} "
        f"| `{command} --only {line.part}` |"
        for line in lines
    ]
    return "\n".join([head, *rows])
