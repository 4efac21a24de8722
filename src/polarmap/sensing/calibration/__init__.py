"""Black level, gains, angles and efficiencies of a sensor's polarizers, from a few pictures."""

from polarmap.sensing.calibration.calibrate import SensorCalibration, calibrate_sensor
from polarmap.sensing.calibration.polarizer_fit import PolarizerFit

__all__ = ["PolarizerFit", "SensorCalibration", "calibrate_sensor"]
