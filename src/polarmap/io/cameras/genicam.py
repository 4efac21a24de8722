"""Cameras of any maker whose software has a GenTL producer (.cti), by way of `harvesters`."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any

from polarmap.errors import InputError, PolarmapError
from polarmap.io.cameras.choice import choose
from polarmap.io.cameras.device import Arrived, Unplugged
from polarmap.io.cameras.features import fixed_exposure

_BUFFERS = 16  # pictures that the driver may fill until they are copied
_SILENCE = 2.0  # seconds without a picture, after which the camera is asked whether it is there
_BILLION = 1_000_000_000


@contextmanager
def open_genicam(cti: Path, wanted: str | None = None) -> Iterator[GenICamDevice]:
    """A camera of a GenTL producer, closed in the end.

    wanted: serial number or index; None where there is one alone. Raises InputError where `harvesters` is not
    installed, the producer cannot be used, or there is no such camera, PolarmapError where it cannot be opened.
    """
    core = _harvesters()
    if not cti.is_file():
        raise InputError(f"{cti}: no such file; name the GenTL producer (.cti) of the camera's maker, see docs/live.md")
    harvester = core.Harvester()
    try:
        _load(harvester, cti)
        infos = harvester.device_info_list
        cameras = [(_told(info, "serial_number"), f"{_told(info, 'vendor')} {_told(info, 'model')}") for info in infos]
        index = choose(cameras, wanted, str(cti))
        serial, model = cameras[index]
        name = f"{model} {serial}".strip()
        try:
            acquirer = harvester.create(index)
        except Exception as problem:
            raise PolarmapError(f"{name}: cannot be opened ({_line(problem)}); does another program use it?") from None
        try:
            yield GenICamDevice(acquirer, name)
        finally:
            with suppress(Exception):  # unplugged, say
                acquirer.destroy()
    finally:
        with suppress(Exception):
            harvester.reset()


class GenICamDevice:
    """A camera opened by `harvesters`, as a `Device`."""

    def __init__(self, acquirer: Any, name: str) -> None:
        self.name = name
        self._acquirer = acquirer
        self._nodes = acquirer.remote_device.node_map
        self._format, self._exposure = "", float("nan")
        self._size = 0, 0
        self._last = perf_counter()

    def __enter__(self) -> GenICamDevice:
        self._format = self.feature("PixelFormat") or "unknown"
        self._size = int(self.feature("Width") or 0), int(self.feature("Height") or 0)
        self._exposure = fixed_exposure(self)
        try:
            self._acquirer.num_buffers = max(_BUFFERS, self._acquirer.min_num_buffers)
            self._acquirer.start()
        except Exception as problem:
            raise PolarmapError(f"{self.name}: cannot be started ({_line(problem)})") from None
        self._last = perf_counter()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with suppress(Exception):
            self._acquirer.stop()

    def feature(self, name: str) -> str | None:
        """See `Device`."""
        with suppress(Exception):
            return str(self._nodes.get_node(name).to_string())
        return None

    def set_feature(self, name: str, value: str) -> None:
        """See `Device`."""
        try:
            self._nodes.get_node(name).from_string(value)
        except Exception as problem:
            raise InputError(f"{self.name}: does not take {name}={value} ({_line(problem)})") from None

    def fetch(self, seconds: float) -> Arrived | None:
        """See `Device`. Pictures of which a part was lost are left out by `harvesters`; their numbers are missing."""
        try:
            buffer = self._acquirer.try_fetch(timeout=seconds, is_raw=True)
        except Exception as problem:
            raise Unplugged(f"{self.name}: does not answer any more ({_line(problem)})") from None
        if buffer is None:
            self._require_there()
            return None
        self._last = perf_counter()
        try:
            return self._arrived(buffer, self._last)
        finally:
            buffer.parent.queue_buffer(buffer)

    def _arrived(self, buffer: Any, came: float) -> Arrived:
        begin = _known(lambda: buffer.image_offset) or 0
        filled = _known(lambda: buffer.size_filled) or len(buffer.raw_buffer)
        width, height = self._size
        return Arrived(
            number=_known(lambda: buffer.frame_id),
            came=came,
            clock=self._clock(buffer),
            width=_known(lambda: buffer.width) or width,
            height=_known(lambda: buffer.height) or height,
            pixel_format=self._format,
            data=bytes(memoryview(buffer.raw_buffer)[begin:filled]),
            padding=_known(lambda: buffer.padding_x) or 0,
            exposure=self._exposure,
        )

    def _clock(self, buffer: Any) -> int | None:
        """Nanoseconds of the camera's clock; 0, which cameras without one tell, is none."""
        nanoseconds = _known(lambda: buffer.timestamp_ns)
        if nanoseconds:
            return nanoseconds
        ticks = _known(lambda: buffer.timestamp)
        frequency = _known(lambda: self._acquirer.device.module.timestamp_frequency)
        return ticks * _BILLION // frequency if ticks and frequency else None

    def _require_there(self) -> None:
        """Raise Unplugged where nothing has come for a while and the camera does not answer a question either."""
        if perf_counter() - self._last < _SILENCE:
            return
        self._last = perf_counter()
        try:
            self._nodes.get_node("Width").get_value(False, True)  # asks the camera, not what is remembered of it
        except Exception as problem:
            raise Unplugged(f"{self.name}: does not answer any more ({_line(problem)})") from None


def _harvesters() -> Any:
    try:
        from harvesters import core
    except ImportError:
        raise InputError('GenICam cameras need harvesters; install it with pip install "polarmap[genicam]"') from None
    logging.getLogger(core.__name__).setLevel(logging.CRITICAL)  # what fails is told here, in one line
    return core


def _load(harvester: Any, cti: Path) -> None:
    try:
        harvester.add_file(str(cti), check_existence=True, check_validity=True)
        harvester.update()
    except Exception as problem:
        raise InputError(f"{cti}: is no GenTL producer that can be used here ({_line(problem)})") from None


def _known(ask: Callable[[], int]) -> int | None:
    """What a driver tells, which may be nothing."""
    try:
        return int(ask())
    except Exception:
        return None


def _told(info: Any, name: str) -> str:
    with suppress(Exception):
        return str(getattr(info, name) or "")
    return ""


def _line(problem: Exception) -> str:
    return (str(problem).strip().splitlines() or [type(problem).__name__])[0][:200]
