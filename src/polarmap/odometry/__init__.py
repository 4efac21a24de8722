"""Direct sparse odometry."""

from polarmap.odometry.odometry import Odometry
from polarmap.odometry.options import OdometryOptions

__all__ = ["Odometry", "OdometryOptions"]
