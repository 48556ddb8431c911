"""Faults made on purpose, and what has to hold after them.

Shared by the tests in this folder and by ``benchmarks/reliability.py``, which tries each fault
more often and prints how many it survived.
"""
