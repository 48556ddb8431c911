"""``python -m flows`` is ``gvr``."""

from flows.cli import main

main()
