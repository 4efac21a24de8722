"""polarmap warmup: compile ahead."""

from __future__ import annotations

from time import perf_counter

from polarmap.cli.common import compile_notice, console


def warm_up() -> None:
    """Compile all kernels now, so that no later run has to.

    The first run on a machine compiles for some minutes; what it compiles is kept. Where a camera is to be followed,
    do this once after installing.

    Example: polarmap warmup
    """
    from polarmap.warm_up import warm_up

    begin = perf_counter()
    with compile_notice():
        warm_up()
    console.print(f"all is compiled ({perf_counter() - begin:.0f} s)", highlight=False)
