"""Samples of the machine's load: on unless switched off, bounded, and cheap."""

from __future__ import annotations

import time

import pytest

from gvr_core.errors import ConfigError
from reports.system_load import MOST_SAMPLES, LoadSampler, load_wanted

NAMES = {
    "cpu_utilization_percentage",
    "system_memory_usage_megabytes",
    "system_memory_usage_percentage",
    "disk_usage_percentage",
    "disk_available_megabytes",
    "network_receive_megabytes",
    "network_transmit_megabytes",
}


def test_samples_are_in_order_and_named_as_mlflow_does() -> None:
    with LoadSampler(every=0.01) as sampler:
        time.sleep(0.3)
    load = sampler.load()
    assert load is not None
    assert load.values.keys() >= NAMES
    assert list(load.seconds) == sorted(load.seconds)
    assert all(len(values) == len(load.seconds) for values in load.values.values())
    assert 0 < load.values["system_memory_usage_percentage"][0] < 100
    assert all(0 <= value <= 100 for value in load.values["cpu_utilization_percentage"])


def test_a_long_run_keeps_few_samples_over_all_of_its_time() -> None:
    with LoadSampler(every=0.004, most=8) as sampler:
        time.sleep(0.6)
    load = sampler.load()
    assert load is not None
    assert 3 <= len(load.seconds) < 8
    gaps = [b - a for a, b in zip(load.seconds, load.seconds[1:], strict=False)]
    assert max(gaps) < 0.4
    assert MOST_SAMPLES % 2 == 0


def test_a_sample_costs_less_than_a_hundredth_of_its_second() -> None:
    before = time.process_time()
    with LoadSampler(every=0.01) as sampler:
        time.sleep(0.5)
    spent = time.process_time() - before
    load = sampler.load()
    assert load is not None
    assert spent / len(load.seconds) < 0.01


def test_a_run_of_a_moment_has_none() -> None:
    with LoadSampler() as sampler:
        pass
    assert sampler.load() is None


@pytest.mark.parametrize("given", ["false", "0", "False"])
def test_the_switch_of_mlflow_turns_it_off(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING", given)
    with LoadSampler(every=0.01) as sampler:
        time.sleep(0.05)
    assert sampler.load() is None


def test_on_unless_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING", raising=False)
    assert load_wanted()


@pytest.mark.parametrize("given", ["", "off", "yes"])
def test_what_mlflow_does_not_take_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING", given)
    with pytest.raises(ConfigError, match="true, which is the default, or false"), LoadSampler():
        pass
