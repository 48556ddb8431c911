"""``python -m flows`` is ``gvr``."""

from flows.cli import script

script()
