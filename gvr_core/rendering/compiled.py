"""How the kernels of the CPU renderer are compiled, and how they are spread over threads.

Kernels are compiled by numba without its own parallel loops: they release the GIL, take one
piece of the work each, and plain Python threads hand the pieces out. So renders may be started
from any number of Python threads at once, which numba's default threading layer (workqueue)
answers by ending the process, and a forked child can render, which GNU OpenMP does not allow.

Numba's cache of compiled code notices changes in the file of a kernel only. The files whose
constants and helpers are compiled in are therefore made part of the name that a kernel is cached
under, and no kernel calls compiled code of any other file.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

codegen: Any = cgutils

Function = TypeVar("Function", bound=Callable[..., Any])

Result = TypeVar("Result")

_FASTMATH = {"contract", "arcp", "nsz"}
"""Fused multiply-add and reciprocals; no reordering of sums, so results do not depend on how a
loop was vectorised."""


def digest_of_shared_files(folder: Path) -> str:
    """Short digest of the files whose constants and helpers end up in kernels of other files."""
    digest = hashlib.sha256()
    for name in ("base.py", "compiled.py", "layout.py", "tile_rows.py"):
        with contextlib.suppress(FileNotFoundError):  # an installation without sources
            digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:12]


_SHARED = digest_of_shared_files(Path(__file__).parent)


def kernel(function: Function) -> Function:
    """Compile a function with numba: cached on disk, GIL released, IEEE division by zero."""
    return _cached(function, fastmath=_FASTMATH)


def precise_kernel(function: Function) -> Function:
    """As :func:`kernel`, but every operation rounds for itself, as numpy's do."""
    return _cached(function)


def _cached(function: Function, **options: Any) -> Function:
    """Compile with the cache beside the code or, where that cannot be written, in the home folder.

    Numba refuses to compile where it can write to neither; then each process compiles for itself.
    """
    function.__qualname__ += f"_{_SHARED}"
    options = {"nogil": True, "error_model": "numpy", **options}
    try:
        return cast(Function, njit(cache=True, **options)(function))
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        return cast(Function, njit(**options)(function))


def inlined(function: Function) -> Function:
    """Compile a helper of the kernels in its file, for LLVM to put in place of each call."""
    compile_ = njit(error_model="numpy", fastmath=_FASTMATH, forceinline=True)
    return cast(Function, compile_(function))


def _wide_vectors(typing_context: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # llvmlite's own method takes only the attributes that it knows.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate


prefer_wide_vectors: Any = intrinsic(_wide_vectors)
"""In a kernel, ``prefer_wide_vectors()`` lets LLVM use vectors of 512 bits where the processor has
them. It keeps to 256 by default, since processors of around 2017 slowed down for wider ones; in
blending the wide ones are 1.4 times as fast."""


def _prefetch(typing_context: Any, array: Any, row: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = signature.args[0]
        fields = context.make_array(kind)(context, builder, arguments[0])
        place = [arguments[1], context.get_constant(types.intp, 0)]
        pointer = codegen.get_item_pointer(context, builder, kind, fields, place, wraparound=False)
        pointer = builder.bitcast(pointer, codegen.voidptr_t)
        number = codegen.int32_t
        llvm_type = ir.FunctionType(ir.VoidType(), [pointer.type, number, number, number])
        prefetch = codegen.get_or_insert_function(builder.module, llvm_type, "llvm.prefetch.p0")
        builder.call(prefetch, [pointer, number(0), number(3), number(1)])  # read, keep, data
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


prefetch_row: Any = intrinsic(_prefetch)
"""In a kernel, ``prefetch_row(array, row)`` asks for ``array[row]`` (2-D, row >= 0) to be brought
into the cache, and does not wait for it."""


def available_threads() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def _forget_pool() -> None:
    """Threads do not survive a fork: the child starts with its own."""
    global _pool, _pool_lock
    _pool, _pool_lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


def _workers() -> ThreadPoolExecutor:
    global _pool
    with _pool_lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(available_threads(), thread_name_prefix="gvr-render")
        return _pool


def run_pieces(work: Callable[[int], object], pieces: int, threads: int) -> None:
    """Call ``work(0) ... work(pieces - 1)``, each once, on several threads.

    Pieces are handed out in order to whichever thread is free, the calling one included. They
    must not write to the same memory.

    Args:
        work: Takes the number of a piece.
        pieces: How many there are.
        threads: Most threads to use, the calling one included.

    Raises:
        Exception: the first that a piece raised, after all threads have stopped.
    """
    numbers = itertools.count()  # next() is atomic under the GIL

    def drain() -> None:
        while (number := next(numbers)) < pieces:
            work(number)

    helpers = min(threads, pieces) - 1
    if helpers < 1:
        drain()
        return
    pool = _workers()
    futures = [pool.submit(drain) for _ in range(helpers)]
    try:
        drain()
    finally:
        for future in futures:
            if not future.cancel():
                future.exception()
    for future in futures:
        if not future.cancelled():
            future.result()


def in_background(work: Callable[[], Result]) -> Future[Result]:
    """Start work on another thread.

    Args:
        work: May itself use :func:`run_pieces`.
    """
    return _workers().submit(work)


def result_of(future: Future[Result], work: Callable[[], Result]) -> Result:
    """The result of :func:`in_background`, or its error.

    Work that no thread has begun yet is done here, so that nobody waits for a thread that waits
    for others.

    Args:
        future: What :func:`in_background` gave.
        work: What it was given.
    """
    return work() if future.cancel() else future.result()
