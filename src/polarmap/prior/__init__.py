"""Depth priors: relative depth networks aligned to sparse points, or the points themselves interpolated."""

from polarmap.prior.alignment import PriorAlignment, Verdict, align
from polarmap.prior.bending import bend_to_points
from polarmap.prior.network import DepthNetwork
from polarmap.prior.network_spec import NetworkSpec, OutputSpace, network_spec
from polarmap.prior.options import PriorOptions
from polarmap.prior.polarization_network import PolarNetwork
from polarmap.prior.prediction import Prediction
from polarmap.prior.priors import (
    Network,
    NetworkPrior,
    Prior,
    PriorDepth,
    SparsePrior,
    make_prior,
)
from polarmap.prior.sparse import interpolate_inverse_depth
from polarmap.prior_names import DEFAULT_PRIOR, POLARNET, SPARSE

__all__ = [
    "DEFAULT_PRIOR",
    "POLARNET",
    "SPARSE",
    "DepthNetwork",
    "Network",
    "NetworkPrior",
    "NetworkSpec",
    "OutputSpace",
    "PolarNetwork",
    "Prediction",
    "Prior",
    "PriorAlignment",
    "PriorDepth",
    "PriorOptions",
    "SparsePrior",
    "Verdict",
    "align",
    "bend_to_points",
    "interpolate_inverse_depth",
    "make_prior",
    "network_spec",
]
