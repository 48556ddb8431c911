"""The books that earlier stages have made, opened by memory map."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from typing import Any, TypeVar

from gvr_core.books import Books, DepthBook, PatchBook, SemanticVectorBook, ViewBook
from tasks.arrays import StoredArrays
from tasks.store import Store

T = TypeVar("T")

NO_BOOKS = hashlib.sha256(b"no books").hexdigest()
"""Stands for the results of the preparation where a method needs none."""


class OpenBooks:
    """Books of a scene, each opened when it is first asked for.

    Args:
        store: Where they lie.
        inputs: A stage's inputs: how the stages that made them ended, or :data:`NO_BOOKS`.
    """

    def __init__(self, store: Store, inputs: Mapping[str, Any]) -> None:
        self._store = store
        self._inputs = inputs
        self._opened: list[StoredArrays] = []

    @cached_property
    def views(self) -> ViewBook:
        """The View Book."""
        return ViewBook.from_arrays(self._open("render", "views"))

    @cached_property
    def depths(self) -> DepthBook:
        """The Depth Book."""
        return DepthBook.from_arrays(self._open("depth", "depths"))

    @cached_property
    def patches(self) -> PatchBook:
        """The patches; small, so in memory."""
        return PatchBook.from_arrays(self._store.load_arrays(self._inputs["masks"]["patches"]))

    @cached_property
    def all(self) -> Books:
        """All that have been made so far; of a method that needs none, none."""
        if self._inputs["encode"] == NO_BOOKS:
            return Books.none()
        features = self._open("encode", "features")["features"]
        semantics = SemanticVectorBook(features, self.patches)
        index = dict(self._open("index", "index")) if "index" in self._inputs else {}
        return Books(self.views, self.depths, semantics, index)

    def let_go_after_each(self, items: Iterable[T]) -> Iterator[T]:
        """The items; after each, what was read of the books stops counting as memory in use."""
        for item in items:
            yield item
            for arrays in self._opened:
                arrays.let_go()

    def _open(self, stage: str, name: str) -> StoredArrays:
        arrays = self._store.open_arrays(self._inputs[stage][name])
        self._opened.append(arrays)
        return arrays
