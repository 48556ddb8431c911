"""What a shared store costs and gives, over S3 on loopback: ``python benchmarks/remote_store.py``.

Starts an S3 server on 127.0.0.1 (moto's, which is written in Python and keeps everything in
memory) and times, for results of several sizes, putting one, fetching it on another machine,
finding it in the local folder afterwards, and looking for what is not there. Loopback has no
latency to speak of and the server is the slow end, so this is the overhead of the store itself
and a lower bound of what a real S3 carries.

``--into docs/sharing.md`` puts the table there.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import fsspec
import numpy as np

from reports.document import replace_block
from reports.environment import describe_environment
from reports.sheet import Sheet, to_markdown
from tasks.store import Store, stage_key

BLOCK = "remote-store"
SIZES_MB = (0.01, 1.0, 8.0, 32.0)
REPEATS = 3

SERVE = """
import threading
from moto.server import ThreadedMotoServer
server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
server.start()
print(server.get_host_and_port()[1], flush=True)
threading.Event().wait()
"""


def machine(folder: Path, url: str) -> Store:
    """A store as a machine with this folder would have it."""
    os.environ["GVR_STORE_LOCAL"] = str(folder)
    return Store(url)


def seconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def measure(size: float, url: str, folder: Path) -> list[float]:
    """Medians in seconds: compute alone, compute and put, fetch, local hit, miss."""
    count = int(size * 1e6 / 8)
    times: list[list[float]] = []
    for repeat in range(REPEATS):
        array = np.random.default_rng([repeat, count]).random(count)
        key = stage_key("bench", 1, {}, {"size": size, "repeat": repeat})
        alone = Store(folder / f"alone-{size}-{repeat}")
        first = machine(folder / f"a-{size}-{repeat}", url)
        second = machine(folder / f"b-{size}-{repeat}", url)

        def compute(store: Store, key: str = key, array: np.ndarray = array) -> object:
            return store.compute_once(
                "bench", 1, key, lambda: {"a": store.put_arrays("a", {"a": array})}
            )

        def fetch(store: Store, key: str = key) -> None:
            if store.lookup("bench", key) is None:
                raise SystemExit("the result did not arrive")

        missing = stage_key("bench", 1, {}, {"missing": repeat, "size": size})
        row = [seconds(lambda s=alone: compute(s)), seconds(lambda s=first: compute(s))]
        row += [seconds(lambda s=second: fetch(s)) for _ in range(2)]
        row.append(seconds(lambda s=second, m=missing: s.lookup("bench", m)))
        times.append(row)
    return [statistics.median(column) for column in zip(*times, strict=True)]


def table(rows: list[tuple[float, list[float]]]) -> str:
    where = describe_environment()
    cells = []
    for size, (alone, put, fetched, hit, miss) in rows:
        cells.append(
            (
                f"{size:g} MB",
                *(f"{1000 * value:.1f}" for value in (alone, put, fetched, hit, miss)),
                f"{size / (put - alone):.0f}" if put > alone else "–",
                f"{size / fetched:.0f}",
            )
        )
    sheet = Sheet(
        title="one result through S3 on loopback, milliseconds",
        columns=(
            *("result", "computed, local only", "computed and put", "fetched", "hit again"),
            *("miss", "put MB/s", "fetch MB/s"),
        ),
        rows=tuple(cells),
        n_names=1,
        notes=(
            f"Medians of {REPEATS}; {where.cpu_count} x {where.processor}; the server, in Python, "
            "ran on the same processors.",
        ),
    )
    return to_markdown(sheet)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--into", type=Path, help="document whose block is rewritten")
    arguments = parser.parse_args()
    server = subprocess.Popen(
        [sys.executable, "-c", SERVE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert server.stdout is not None
        settings = {
            "key": "key",
            "secret": "secret",
            "endpoint_url": f"http://127.0.0.1:{int(server.stdout.readline())}",
        }
        fsspec.config.conf["s3"] = settings
        fsspec.filesystem("s3", **settings).mkdir("bench")
        with tempfile.TemporaryDirectory() as folder:
            url = "s3://bench/store"
            machine(Path(folder) / "warm", url).check()
            measure(0.001, url, Path(folder))  # connections, imports
            rows = [(size, measure(size, url, Path(folder))) for size in SIZES_MB]
    finally:
        server.kill()
        server.wait()
    text = table(rows)
    print(text)
    if arguments.into:
        replace_block(arguments.into, BLOCK, text)


if __name__ == "__main__":
    main()
