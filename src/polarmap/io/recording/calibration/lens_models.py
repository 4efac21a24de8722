"""The names that programs have for lens models, and the package's own model for each.

plumb_bob, radtan, radial-tangential, Brown-Conrady, rational_polynomial    radtan: k1 k2 p1 p2 [k3 [k4 k5 k6]]
equidistant, fisheye, Kannala-Brandt                                       equidistant: k1 k2 k3 k4

Models that none of these can stand for are refused by name, with what to fit in their place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from polarmap.errors import InputError, quoted
from polarmap.geometry.distortion import Distortion

_NONE = ("none", "no", "null", "undistorted", "rectified", "ideal", "perspective", "pinhole")
_RADTAN = (
    "radtan", "radialtangential", "plumbbob", "brown", "brownconrady", "opencv", "fullopencv", "rational",
    "rationalpolynomial", "radtan4", "radtan5", "radtan8", "radial", "polynomial",
)  # fmt: skip
_EQUIDISTANT = (
    "equidistant", "equi", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4", "kannalabrandt8", "kb", "kb4",
    "kb8", "pinholeequi",
)  # fmt: skip
_OTHERS = {
    "fov": "FOV", "atan": "FOV", "omni": "omnidirectional", "omnidirectional": "omnidirectional", "mei": "Mei's",
    "unified": "unified", "ucm": "unified", "eucm": "extended unified", "ds": "double sphere",
    "doublesphere": "double sphere", "scaramuzza": "Scaramuzza's", "ocam": "Scaramuzza's", "ocamcalib": "Scaramuzza's",
    "equirectangular": "equirectangular", "division": "division", "inversebrownconrady": "inverse Brown-Conrady",
    "modifiedbrownconrady": "modified Brown-Conrady", "ftheta": "F-theta", "thinprismfisheye": "thin prism fisheye",
    "radtanthinprismfisheye": "thin prism fisheye", "fisheye624": "thin prism fisheye",
}  # fmt: skip
_RADTAN_COUNTS = (4, 5, 8)
_LONG_COUNTS = (12, 14)  # OpenCV's s1 to s4, then the sensor's tilt


def lens_distortion(model: str, coefficients: Sequence[float]) -> Distortion | None:
    """The distortion that a program calls `model`; None where there is none.

    Raises InputError for a model that is not known here or a number of coefficients that it cannot have.
    """
    name = re.sub(r"[^a-z0-9]", "", str(model).lower())
    coefficients = tuple(float(k) for k in coefficients)
    if name in _NONE:
        if any(coefficients):
            raise InputError(
                f"distortion: model {quoted(model)} has none, but coefficients are given; name their model"
            )
        return None
    if name in _EQUIDISTANT:
        return Distortion("equidistant", coefficients)
    if name in _RADTAN:
        return _radtan(coefficients)
    if name in _OTHERS:
        raise InputError(
            f"distortion: the {_OTHERS[name]} model ({str(model)[:40]}) is not known here; calibrate again with radtan "
            "(up to about 100 degrees of view) or equidistant (fisheye), or fit one of them to it"
        )
    raise InputError(
        f"distortion: model {quoted(model)} is not known; write radtan (also called plumb_bob), equidistant (also "
        "fisheye) or none"
    )


def _radtan(coefficients: tuple[float, ...]) -> Distortion | None:
    """k1 k2 p1 p2 and so on; None where all are 0, so that no picture is resampled for nothing."""
    if not coefficients:
        return None
    if len(coefficients) in _LONG_COUNTS:
        if any(coefficients[8:]):
            raise InputError(
                "distortion: the thin prism and tilt coefficients (s1 and on, after k6) are not known here; calibrate "
                "again without them"
            )
        coefficients = coefficients[:8]
    if len(coefficients) not in _RADTAN_COUNTS:
        raise InputError(
            f"distortion: radtan takes 4, 5 or 8 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6]]), not {len(coefficients)}"
        )
    finite = Distortion("radtan", coefficients)  # which are checked before they are called zero
    return finite if any(coefficients) else None
