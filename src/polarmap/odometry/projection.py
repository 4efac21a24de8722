"""How a motion carries pixels with an inverse depth from one image to another."""

from __future__ import annotations

from polarmap.jit import njit


@njit
def fill_projection(K, T, KRKi, Kt):
    """K R K⁻¹ and K t of a motion, float32 3×3 and 3, are filled: p' ~ K R K⁻¹ (u, v, 1) + d K t.

    T: float64, three rows of it are read.
    """
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    for i in range(3):
        focal, centre = (fx, cx) if i == 0 else (fy, cy)
        a, b, c, t = T[i, 0], T[i, 1], T[i, 2], T[i, 3]
        if i < 2:
            a, b = focal * a + centre * T[2, 0], focal * b + centre * T[2, 1]
            c, t = focal * c + centre * T[2, 2], focal * t + centre * T[2, 3]
        KRKi[i, 0], KRKi[i, 1], KRKi[i, 2] = a / fx, b / fy, c - a * cx / fx - b * cy / fy
        Kt[i] = t
