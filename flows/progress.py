"""Progress bars on long loops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress


class Progress:
    """One bar for the loop that is running; nothing where it is not shown.

    Args:
        shown: Draw bars on standard error.
    """

    def __init__(self, shown: bool = True) -> None:
        self._bars = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=not shown,
        )

    def __enter__(self) -> Self:
        self._bars.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._bars.__exit__(*error)

    def track(self, items: Iterable[Any], text: str, label: str = "") -> Iterator[Any]:
        """The items, with a bar that moves as they are taken.

        Args:
            items: What is looped over.
            text: What is done with each.
            label: What for.
        """
        total = len(items) if isinstance(items, Sized) else None
        bar = self._bars.add_task(f"{label}  {text}".strip(), total=total)
        try:
            for item in items:
                yield item
                self._bars.advance(bar)
        finally:
            self._bars.remove_task(bar)
