"""Checkpoints of the full-strength models: what they are, where they lie, how they are fetched.

``manifest`` lists them, ``folder`` finds them on disk, and ``fetching`` is the only part of this
library that uses the network.
"""
