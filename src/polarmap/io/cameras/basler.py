"""Basler's cameras, by way of `pypylon`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import perf_counter
from types import TracebackType
from typing import Any

from polarmap.errors import InputError, PolarmapError
from polarmap.io.cameras.choice import choose
from polarmap.io.cameras.device import Arrived, Unplugged
from polarmap.io.cameras.features import fixed_exposure, number

_BUFFERS = 32  # pictures that the driver may fill until they are copied
_BILLION = 1_000_000_000
_UNKNOWN = (1 << 64) - 1  # a number of a picture that the driver does not know


@contextmanager
def open_basler(wanted: str | None = None) -> Iterator[BaslerDevice]:
    """A camera of Basler's, closed in the end.

    wanted: serial number or index; None where there is one alone. Raises InputError where `pypylon` is not installed or
    there is no such camera, PolarmapError where it cannot be opened.
    """
    pylon = _pylon()
    factory = pylon.TlFactory.GetInstance()
    infos = factory.EnumerateDevices()
    cameras = [(info.GetSerialNumber(), info.GetModelName()) for info in infos]
    index = choose(cameras, wanted, "Basler")
    serial, model = cameras[index]
    name = f"Basler {model} {serial}"
    try:
        camera = pylon.InstantCamera(factory.CreateDevice(infos[index]))
        camera.Open()
    except Exception as problem:
        raise PolarmapError(f"{name}: cannot be opened ({_line(problem)}); does another program use it?") from None
    try:
        yield BaslerDevice(pylon, camera, name)
    finally:
        with suppress(Exception):  # unplugged, say
            camera.Close()


class BaslerDevice:
    """A camera opened by `pypylon`, as a `Device`."""

    def __init__(self, pylon: Any, camera: Any, name: str) -> None:
        self.name = name
        self._pylon = pylon
        self._camera = camera
        self._format, self._exposure = "", float("nan")
        self._ticks = _BILLION  # a second

    def __enter__(self) -> BaslerDevice:
        self._format = self.feature("PixelFormat") or "unknown"
        self._exposure = fixed_exposure(self)
        ticks = number(self, "GevTimestampTickFrequency")  # cameras of GigE Vision 1
        self._ticks = int(ticks) if ticks > 0 else _BILLION
        try:
            self._camera.MaxNumBuffer.Value = _BUFFERS
            self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)
        except Exception as problem:
            raise PolarmapError(f"{self.name}: cannot be started ({_line(problem)})") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with suppress(Exception):
            self._camera.StopGrabbing()

    def feature(self, name: str) -> str | None:
        """See `Device`."""
        with suppress(Exception):
            return str(self._camera.GetNodeMap().GetNode(name).ToString())
        return None

    def set_feature(self, name: str, value: str) -> None:
        """See `Device`."""
        try:
            self._camera.GetNodeMap().GetNode(name).FromString(value)
        except Exception as problem:
            raise InputError(f"{self.name}: does not take {name}={value} ({_line(problem)})") from None

    def fetch(self, seconds: float) -> Arrived | None:
        """See `Device`."""
        try:
            result = self._camera.RetrieveResult(round(1000 * seconds), self._pylon.TimeoutHandling_Return)
            if result.IsValid():
                with result:
                    return self._arrived(result, perf_counter())
        except Exception as problem:
            raise Unplugged(f"{self.name}: does not answer any more ({_line(problem)})") from None
        if self._camera.IsCameraDeviceRemoved() or not self._camera.IsGrabbing():
            raise Unplugged(f"{self.name}: does not answer any more (it was taken away)")
        return None

    def _arrived(self, result: Any, came: float) -> Arrived:
        whole = result.GrabSucceeded()
        block, ticks = result.GetBlockID(), result.GetTimeStamp()
        return Arrived(
            number=None if block == _UNKNOWN else int(block),
            came=came,
            clock=int(ticks) * _BILLION // self._ticks if ticks else None,
            width=int(result.GetWidth()) if whole else 0,
            height=int(result.GetHeight()) if whole else 0,
            pixel_format=self._format,
            data=bytes(result.GetBuffer()) if whole else None,
            padding=int(result.GetPaddingX()) if whole else 0,
            exposure=self._exposure,
        )


def _pylon() -> Any:
    try:
        from pypylon import pylon
    except ImportError:
        raise InputError('Basler cameras need pypylon; install it with pip install "polarmap[basler]"') from None
    return pylon


def _line(problem: Exception) -> str:
    return (str(problem).strip().splitlines() or [type(problem).__name__])[0][:200]
