"""Which of Mitsuba's variants renders polarized light on this machine."""

from __future__ import annotations

from types import ModuleType

from polarmap.errors import InputError, PolarmapError

FAST, PLAIN = "llvm_ad_mono_polarized", "scalar_spectral_polarized"
_LEAST_LLVM = 17  # older ones know no fminimum of the code that Mitsuba generates, and end the whole process


def import_mitsuba(variant: str | None = None) -> ModuleType:
    """Mitsuba, set to a polarized variant.

    variant: its name; where None, `llvm_ad_mono_polarized` if LLVM 17 or newer is found, otherwise
        `scalar_spectral_polarized`, which needs nothing and takes longer.
    Raises PolarmapError where Mitsuba is not installed, InputError where it has no such polarized variant.
    """
    try:
        import mitsuba
    except ImportError:
        raise PolarmapError("Mitsuba is not installed; get it with: pip install mitsuba") from None
    known = [name for name in mitsuba.variants() if name.endswith("_polarized")]
    variant = variant or (FAST if FAST in known and _llvm_version() >= _LEAST_LLVM else PLAIN)
    if variant not in known:
        raise InputError(f"Mitsuba variant {variant!r}: is not one of {', '.join(known)}")
    if variant.startswith("llvm") and _llvm_version() < _LEAST_LLVM:
        raise InputError(
            f"Mitsuba variant {variant!r}: needs LLVM {_LEAST_LLVM} or newer; install libllvm19, or name it in "
            f"DRJIT_LIBLLVM_PATH, or use {PLAIN}"
        )
    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def _llvm_version() -> int:
    """Major version of the LLVM that Mitsuba finds, 0 for none."""
    import drjit

    if not drjit.has_backend(drjit.JitBackend.LLVM):
        return 0
    return int(drjit.detail.llvm_version()[0])
