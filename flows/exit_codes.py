"""The exit codes of the command line; docs/command_line.md lists them."""

EXIT_FAILED = 1
"""Something did not work, or what was checked is wrong; the same command may work another time."""

EXIT_BAD_INPUT = 2
"""Something that was given cannot be used."""
