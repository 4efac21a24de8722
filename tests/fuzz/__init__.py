"""Mutated inputs for every reader of the package: `python -m fuzz --count 100000` in the folder of the tests.

Each reader must give values or the package's own error, in one short line, below 1 GB and 10 s.
"""
