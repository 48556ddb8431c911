from __future__ import annotations

from datetime import timedelta

import pytest

from flows.when import When, parse_when
from gvr_core.errors import ConfigError


def test_cron_and_interval() -> None:
    nightly = parse_when("0 2 * * *", None, "Europe/Berlin")
    assert (nightly.cron, nightly.timezone) == ("0 2 * * *", "Europe/Berlin")
    assert str(nightly) == "at '0 2 * * *' (Europe/Berlin)"
    assert nightly.schedule().cron == "0 2 * * *"
    often = parse_when(None, "90m", "UTC")
    assert often == When(interval=timedelta(minutes=90))
    assert often.schedule().interval == timedelta(minutes=90) and str(often) == "every 1:30:00"


@pytest.mark.parametrize(
    ("cron", "interval", "timezone", "found"),
    [
        (None, None, "UTC", "neither"),
        ("0 2 * * *", "6h", "UTC", "both"),
        ("0 2 * *", None, "UTC", "'0 2 \\* \\*' is no cron line"),
        ("0 2 * * *", None, "Mars/Olympus", "Mars/Olympus"),
        (None, "6 weeks", "UTC", "6 weeks"),
        (None, "1s", "UTC", "at least 5s"),
    ],
)
def test_what_cannot_be_is_refused(cron, interval, timezone, found) -> None:
    with pytest.raises(ConfigError, match=found):
        parse_when(cron, interval, timezone)


def test_a_cron_line_of_nonsense_is_refused_before_anything_is_scheduled() -> None:
    with pytest.raises(ConfigError, match="is no cron line"):
        parse_when("0 25 * * *", None, "UTC").schedule()
