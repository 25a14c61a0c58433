# SPDX-License-Identifier: MIT
"""Samples that an entity sends continuously."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Optional, Union

from . import _native

SAMPLE_MAX = 1024 * 1024
_MARGIN = 512  # of a sample, beside its pixels


@dataclass(frozen=True)
class Pose:
    """A pose: metres and radians, in the entity's own map frame unless ``frame`` names another one."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    frame: str = ""


@dataclass(frozen=True)
class Scan:
    """Ranges of a scanner, in metres and radians: beam i points to ``angles[i]`` if given, else to start_angle + i * step."""

    ranges: Any
    start_angle: float = 0.0
    step: float = 0.0
    max_range: float = 0.0
    angles: Any = field(default_factory=list)


@dataclass(frozen=True)
class Image:
    """An encoded image: the bytes of a file, with "jpeg" or "png", or pixels of another encoding than NumPy arrays have."""

    data: Any
    width: int
    height: int
    encoding: str


class Stream:
    """A named stream. Publishing never blocks; samples are dropped while nobody subscribes."""

    def __init__(self, native: _native.Stream, name: str) -> None:
        self._native = native
        self._name = name

    @property
    def name(self) -> str:
        """The name by which clients subscribe."""
        return self._name

    @property
    def wanted(self) -> bool:
        """False while nobody subscribes: the sample need not be made then."""
        return self._native.wanted

    def publish(
        self, sample: Union[float, Sequence[float], bytes, Pose, Scan, Image, Any], *, units: str = "", encoding: Optional[str] = None
    ) -> None:
        """Sends a sample.

        A number or a sequence of numbers is sent with its ``units``. A NumPy array of one dimension is a sequence of
        numbers. A contiguous array of ``uint8`` is an image: (height, width) is mono8, (height, width, 3) is rgb8 and
        (height, width, 4) is rgba8, unless ``encoding`` says otherwise, such as "bgr8"; ``uint16`` of (height, width)
        is mono16. Its pixels are copied once, as one block. Bytes are sent as they are.

        Raises TypeError or ValueError with what was expected. A sample has at most 1 MiB.
        """
        native = self._native
        if isinstance(sample, Pose):
            native.pose(sample.x, sample.y, sample.z, sample.roll, sample.pitch, sample.yaw, sample.frame)
        elif isinstance(sample, Scan):
            native.scan(sample.start_angle, sample.step, sample.max_range, sample.ranges, sample.angles)
        elif isinstance(sample, Image):
            self._check_size(len(sample.data))
            native.image(sample.data, sample.width, sample.height, sample.encoding)
        elif isinstance(sample, (bytes, bytearray)):
            self._check_size(len(sample))
            native.bytes(sample)
        elif isinstance(sample, (list, tuple)):
            native.values(self._numbers(sample), units)
        elif isinstance(sample, (bool, str)) or sample is None:
            raise self._wrong(sample)
        elif hasattr(sample, "ndim") and getattr(sample, "ndim") > 0:
            self._publish_array(sample, units, encoding)
        else:
            one: Any = sample
            try:
                number = float(one)
            except (TypeError, ValueError):
                raise self._wrong(sample) from None
            native.value(number, units)

    def _publish_array(self, array: Any, units: str, encoding: Optional[str]) -> None:
        shape, kind = tuple(array.shape), str(array.dtype)
        if len(shape) == 1:
            native = array if kind in ("float64", "float32") else [float(one) for one in array]
            return self._native.values(native, units)
        found = {("uint8", 2): "mono8", ("uint16", 2): "mono16"}.get((kind, len(shape)))
        if kind == "uint8" and len(shape) == 3 and shape[2] in (3, 4):
            found = "rgb8" if shape[2] == 3 else "rgba8"
        if found is None:
            raise TypeError(
                f"stream '{self._name}': expected an array of one dimension, or an image of uint8 (height, width), (height, width, 3) "
                f"or (height, width, 4), or of uint16 (height, width); found {kind} {shape}"
            )
        self._check_size(int(array.nbytes))
        self._native.image(array, shape[1], shape[0], encoding or found)

    def _numbers(self, sample: Sequence[Any]) -> list[float]:
        for one in sample:
            if isinstance(one, (str, bytes, bool)) or not hasattr(one, "__float__"):
                raise TypeError(f"stream '{self._name}': expected numbers, found {one!r}")
        return [float(one) for one in sample]

    def _check_size(self, count: int) -> None:
        if count > SAMPLE_MAX - _MARGIN:
            raise ValueError(
                f"stream '{self._name}': expected a sample of at most 1 MiB, found {count} bytes; fix: send a smaller or a compressed image"
            )

    def _wrong(self, sample: Any) -> TypeError:
        return TypeError(f"stream '{self._name}': expected a number, numbers, an array, bytes, Pose, Scan or Image, found {sample!r}")
