"""What the machine did while a benchmark ran: samples of processor, memory, disk and network.

The names and units are those of MLflow's own system metrics, so its pages show them as such.
However long a run takes, fewer than `MOST_SAMPLES` are kept: when there are as many, every second
one is dropped, and from then on half as many are taken.
"""

from __future__ import annotations

import importlib
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any

import psutil

from gvr_core.errors import ConfigError
from reports.record import SystemLoad

SWITCH = "MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING"
"""MLflow's own environment variable; here system metrics are on where it is not set."""
EVERY_SECONDS = 1.0
"""Between samples, at first."""
MOST_SAMPLES = 60

_ON, _OFF = ("true", "1"), ("false", "0")


def load_wanted() -> bool:
    """Whether the user wants system metrics.

    Raises:
        ConfigError: for a value of the switch that MLflow does not take either.
    """
    given = os.environ.get(SWITCH, "true").lower()
    if given not in (*_ON, *_OFF):
        raise ConfigError(f"{SWITCH}={given}", accepted="true, which is the default, or false")
    return given in _ON


class LoadSampler:
    """Takes samples in a thread of its own, from entering its context until leaving it.

    Args:
        every: Seconds between samples, at first.
        most: Samples that are kept; an even number.

    Raises:
        ConfigError: as `load_wanted` does, when it is entered.
    """

    def __init__(self, every: float = EVERY_SECONDS, most: int = MOST_SAMPLES) -> None:
        self._every = every
        self._most = most
        self._samples: list[tuple[float, dict[str, float]]] = []
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> LoadSampler:
        if load_wanted():
            self._thread = threading.Thread(target=self._run, name="system load", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def load(self) -> SystemLoad | None:
        """The samples, in the order of time; None where there are none."""
        if not self._samples:
            return None
        names = set.intersection(*(set(values) for _, values in self._samples))
        return SystemLoad(
            seconds=tuple(round(moment, 1) for moment, _ in self._samples),
            values={
                name: tuple(round(values[name], 1) for _, values in self._samples)
                for name in sorted(names)
            },
        )

    def _run(self) -> None:
        # Where a container hides a figure the run goes on with the samples until then.
        with suppress(OSError, psutil.Error):
            self._watch()

    def _watch(self) -> None:
        start, every = time.monotonic(), self._every
        gpus = _gpu_readers()
        psutil.cpu_percent()  # says what was used since it was asked last, the first time nothing
        received, sent = _network()
        while not self._over.wait(every):
            now_received, now_sent = _network()
            values = _machine() | {
                "network_receive_megabytes": (now_received - received) / 1e6,
                "network_transmit_megabytes": (now_sent - sent) / 1e6,
            }
            for read in gpus:
                values |= read()
            self._samples.append((time.monotonic() - start, values))
            if len(self._samples) >= self._most:
                del self._samples[::2]
                every *= 2


def _machine() -> dict[str, float]:
    memory, disk = psutil.virtual_memory(), psutil.disk_usage(os.sep)
    return {
        "cpu_utilization_percentage": psutil.cpu_percent(),
        "system_memory_usage_megabytes": memory.used / 1e6,
        "system_memory_usage_percentage": 100 * memory.used / memory.total,
        "disk_usage_percentage": disk.percent,
        "disk_available_megabytes": disk.free / 1e6,
    }


def _network() -> tuple[int, int]:
    counted = psutil.net_io_counters()
    return (counted.bytes_recv, counted.bytes_sent) if counted else (0, 0)  # type: ignore[redundant-expr]


def _gpu_readers() -> list[Callable[[], dict[str, float]]]:
    """One for each GPU that NVIDIA's library sees; none without ``pynvml`` or a GPU."""
    try:
        nvml: Any = importlib.import_module("pynvml")
        nvml.nvmlInit()
        handles = [nvml.nvmlDeviceGetHandleByIndex(i) for i in range(nvml.nvmlDeviceGetCount())]
    except Exception:  # no library, no driver, no permission: then there is nothing to read
        return []

    def reader(number: int, handle: Any) -> Callable[[], dict[str, float]]:
        def read() -> dict[str, float]:
            values: dict[str, float] = {}
            with suppress(nvml.NVMLError):
                memory = nvml.nvmlDeviceGetMemoryInfo(handle)
                values[f"gpu_{number}_memory_usage_megabytes"] = memory.used / 1e6
                values[f"gpu_{number}_memory_usage_percentage"] = 100 * memory.used / memory.total
            with suppress(nvml.NVMLError):
                used = nvml.nvmlDeviceGetUtilizationRates(handle).gpu
                values[f"gpu_{number}_utilization_percentage"] = float(used)
            with suppress(nvml.NVMLError):
                values[f"gpu_{number}_power_usage_watts"] = (
                    nvml.nvmlDeviceGetPowerUsage(handle) / 1000
                )
            return values

        return read

    return [reader(number, handle) for number, handle in enumerate(handles)]
