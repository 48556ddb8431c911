"""Work on several items at a time, with the results in the items' order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def in_order(work: Callable[[T], R], items: Iterable[T], threads: int) -> Iterator[R]:
    """What the work gives for each item, in the items' order.

    Args:
        work: Called from several threads where there is more than one; an item's result must not
            depend on the others.
        items: Taken one by one as there is room for them.
        threads: So many items are worked on at a time, and at most so many results are held.

    Raises:
        Exception: the first, in the items' order, that the work raised; nothing more is begun.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(threads, "views")
    waiting: deque[Future[R]] = deque()
    try:
        for item in items:
            if len(waiting) > threads:
                yield waiting.popleft().result()
            waiting.append(pool.submit(work, item))
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
