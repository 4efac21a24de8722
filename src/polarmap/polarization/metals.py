"""Refractive indices n - ik of common metals, in the green of the visible, where grey polarization sensors see most.

At 0.55 µm, room temperature, clean polished surfaces; oxide and dirt change them. Sources: copper and gold, Johnson and
Christy, Phys. Rev. B 6, 4370 (1972); iron and chromium, Johnson and Christy, Phys. Rev. B 9, 5056 (1974); aluminium,
Rakić, Appl. Opt. 34, 4755 (1995); ferritic stainless steel, Karlsson and Ribbing, J. Appl. Phys. 53, 6340 (1982).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metal:
    """A metal's name and refractive index n - ik."""

    name: str
    n: float
    k: float


STEEL = Metal("steel", 1.90, 3.17)
ALUMINIUM = Metal("aluminium", 1.01, 6.62)
IRON = Metal("iron", 2.95, 2.93)
COPPER = Metal("copper", 1.02, 2.58)
GOLD = Metal("gold", 0.43, 2.46)
CHROMIUM = Metal("chromium", 3.18, 3.33)

METALS = (STEEL, ALUMINIUM, IRON, COPPER, GOLD, CHROMIUM)
