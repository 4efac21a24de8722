"""polarmap record: what a camera sends becomes a sequence."""

from __future__ import annotations

from typing import Annotated

import typer

from polarmap.cli.cameras import CameraOptions, open_camera, say_losses
from polarmap.cli.common import Out, console, end_requests, messages
from polarmap.cli.option_groups import with_option_groups
from polarmap.errors import PolarmapError


@with_option_groups
def record(
    camera: CameraOptions,
    out: Out,
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.001, help="End after so many seconds.")] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Keep the camera's own bytes in place of PNG files, which need more time.")
    ] = False,
) -> None:
    """Record what a camera sends, as a sequence that 'polarmap run' reads.

    Ctrl-C, --seconds or --frames ends it; what has come by then is written. Each frame has the time of the camera's
    clock, and its exposure where the camera tells one.

    Examples: polarmap record --camera camera.yaml --cti producer.cti --out recording

    polarmap record --camera camera.yaml --basler --raw --seconds 60 --out recording
    """
    from polarmap.io.cameras.recorder import Recorder

    with open_camera(camera) as (opened, camera_file), end_requests() as stop:
        recorder = Recorder(out, opened, camera_file, raw)
        with messages.status(f"{opened.name}: waiting for the first frame") as status:

            def show(progress) -> None:
                rate = progress.written / max(progress.seconds, 1e-3)
                status.update(
                    f"{progress.written} frames, {rate:.1f} a second, {progress.waiting} wait to be written, "
                    f"{progress.lost + progress.missed} lost"
                )

            done = recorder.record(camera.frames, seconds, lambda: stop.requested, show)
        if not done.written:
            raise PolarmapError(f"{opened.name}: no frame came; nothing is recorded in {out}")
        say_losses(
            done.lost, done.missed, "writing was too slow for them; try --raw, a faster disk or a lower frame rate"
        )
        console.print(f"{done.written} frames: {out}", markup=False, highlight=False, soft_wrap=True)
