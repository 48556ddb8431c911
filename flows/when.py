"""When a schedule runs: a cron line or an interval, in a time zone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from gvr_core.errors import ConfigError

if TYPE_CHECKING:
    from prefect.schedules import Schedule

_UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86400}
LEAST_SECONDS = 5


@dataclass(frozen=True)
class When:
    """When a schedule runs."""

    cron: str | None = None
    interval: timedelta | None = None
    timezone: str = "UTC"

    def __str__(self) -> str:
        if self.interval is not None:
            return f"every {self.interval}"
        return f"at '{self.cron}' ({self.timezone})"

    def schedule(self) -> Schedule:
        """Prefect's own schedule.

        Raises:
            ConfigError: for a cron line that is none.
        """
        from prefect.schedules import Cron, Interval

        if self.interval is not None:
            return Interval(self.interval, timezone=self.timezone)
        try:
            return Cron(self.cron or "", timezone=self.timezone)
        except ValueError as error:
            raise _no_cron(self.cron or "") from error


def parse_when(cron: str | None, interval: str | None, timezone: str) -> When:
    """Read what was given on the command line.

    Args:
        cron: Five fields, such as ``0 2 * * *``.
        interval: A number and a unit, such as ``90s``, ``30m``, ``6h`` or ``1d``.
        timezone: Name of a time zone, such as ``Europe/Berlin``.

    Raises:
        ConfigError: for neither or both of cron and interval, or one that cannot be read.
    """
    if (cron is None) == (interval is None):
        raise ConfigError(
            "neither --cron nor --interval" if cron is None else "both --cron and --interval",
            accepted="one of the two",
        )
    try:
        ZoneInfo(timezone)
    except (ZoneInfoNotFoundError, ValueError) as error:
        raise ConfigError(
            f"unknown time zone {timezone!r}", accepted="a name such as UTC or Europe/Berlin"
        ) from error
    if cron is not None:
        if len(cron.split()) != 5:
            raise _no_cron(cron)
        return When(cron=cron, timezone=timezone)
    assert interval is not None  # one of the two is
    match = re.fullmatch(r"(\d+)([smhd])", interval)
    seconds = int(match[1]) * _UNITS[match[2]] if match else 0
    if seconds < LEAST_SECONDS:
        raise ConfigError(
            f"--interval {interval}",
            accepted=f"a number and s, m, h or d, such as 6h; at least {LEAST_SECONDS}s",
        )
    return When(interval=timedelta(seconds=seconds), timezone=timezone)


def _no_cron(cron: str) -> ConfigError:
    return ConfigError(
        f"--cron {cron!r} is no cron line",
        accepted="minute, hour, day of month, month, day of week, such as '0 2 * * *'",
    )
