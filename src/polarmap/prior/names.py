"""Names of the built-in priors, and which of them is the default. Imports nothing, for the command line."""

SPARSE = "sparse"
"""Needs nothing but the sparse points."""
POLARNET = "polarnet"
"""The network that comes with the package."""
BUILT_IN = (SPARSE, POLARNET)

DEFAULT_PRIOR = POLARNET
"""What runs use unless told otherwise."""
