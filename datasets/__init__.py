"""Readers and writers of data sets; each yields the same Scene, Query and GroundTruth records.

The name shadows the Hugging Face package ``datasets``, which is not a dependency; a test holds
that the libraries that look for it still import.
"""
