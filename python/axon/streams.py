# SPDX-License-Identifier: GPL-2.0-or-later
"""Samples of streams: numbers and pictures as NumPy arrays, and how they are shown."""
from __future__ import annotations

import importlib
import io
from typing import TYPE_CHECKING, Any, List, Optional

from . import _native

if TYPE_CHECKING:
    import numpy


def drawing(module: str) -> Any:
    """A module of matplotlib, which is needed for drawings only."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(f"matplotlib is needed to draw, and is not there ({error}); fix: apt install python3-matplotlib") from error


class Sample:
    """One sample of a stream. It is read when it is first looked into; its arrays look into what was read, and cannot be
    written."""

    __slots__ = ("_native",)

    def __init__(self, native: _native.NativeSample) -> None:
        self._native = native

    @property
    def entity(self) -> str:
        """UUID of the entity."""
        return self._native.entity

    @property
    def stream(self) -> str:
        """The name of the stream that brought it."""
        return self._native.stream

    @property
    def sequence(self) -> int:
        """Counts from 1; a gap is a sample that was dropped on the way."""
        return self._native.sequence

    @property
    def taken_at(self) -> float:
        """Seconds, on the monotonic clock of the entity's machine: of use for differences only."""
        return self._native.taken_at

    @property
    def kind(self) -> str:
        """"scalar", "vector", "pose", "scan", "image" or "raw"."""
        return self._native.kind

    @property
    def units(self) -> str:
        """Unit of a scalar or a vector, as the robot application says. Poses and scans are in metres and radians."""
        return {"pose": "m, rad", "scan": "m"}.get(self.kind) or self._native.units

    @property
    def data(self) -> Any:
        """What it holds.

        scalar: float. vector: array of float64. pose: array of x, y, z (m), roll, pitch, yaw (rad). scan: array of float32,
        ranges in metres. image: array of bytes, height × width × channels, or the bytes of a compressed picture. raw: bytes.
        """
        return self._native.data

    @property
    def encoding(self) -> str:
        """Of an image: "rgb8", "mono8", "jpeg", …"""
        return self._native.encoding

    @property
    def frame(self) -> str:
        """Of a pose: what it is relative to; empty = the entity's own map."""
        return self._native.frame

    @property
    def max_range(self) -> float:
        """Of a scan: metres; beyond it nothing is seen."""
        return self._native.max_range

    @property
    def angles(self) -> numpy.ndarray[Any, Any]:
        """Of a scan: where each beam looks, in radians, 0 = ahead, positive = left."""
        import numpy as np
        given: numpy.ndarray[Any, Any] = self._native.angles
        if len(given):
            return given
        return np.asarray(self._native.start_angle + self._native.step * np.arange(len(self.data)))

    @property
    def points(self) -> numpy.ndarray[Any, Any]:
        """Of a scan: the points that it sees, x (ahead) and y (left) in metres; beams without an echo are left out."""
        import numpy as np
        ranges, angles = self.data, self.angles
        seen = (ranges > 0) & (ranges < self.max_range) if self.max_range > 0 else ranges > 0
        return np.column_stack((ranges[seen] * np.cos(angles[seen]), ranges[seen] * np.sin(angles[seen])))

    @property
    def picture(self) -> numpy.ndarray[Any, Any]:
        """Of an image: height × width × 3 in the order red, green, blue, or height × width. Decodes JPEG and PNG."""
        if self.kind != "image":
            raise TypeError(f"stream {self.stream} brings {self.kind}, not image")
        pixels: numpy.ndarray[Any, Any] = self.data
        if pixels.ndim > 1:
            return pixels[..., [2, 1, 0]] if self.encoding.startswith("bgr") else pixels
        decoded: numpy.ndarray[Any, Any] = drawing("matplotlib.image").imread(io.BytesIO(pixels.tobytes()), format=self.encoding.replace("jpeg", "jpg"))
        return decoded

    def plot(self, axes: Any = None) -> Any:
        """Draws it with matplotlib, into `axes` or a figure of its own."""
        return plot([self], axes)

    def __array__(self, dtype: Any = None) -> numpy.ndarray[Any, Any]:
        import numpy as np
        return np.asarray(self.data, dtype)

    def __float__(self) -> float:
        return float(self.data)

    def __repr__(self) -> str:
        return f"<Sample {self.sequence} of {self.stream}: {self.kind}>"

    def _repr_png_(self) -> Optional[bytes]:
        if self.kind != "image":
            return None
        out = io.BytesIO()
        drawing("matplotlib.image").imsave(out, self.picture, format="png", cmap="gray")
        return out.getvalue()


def plot(samples: List[Sample], axes: Any = None) -> Any:
    """Scans as points, pictures as they are, poses as a path, numbers over time."""
    if axes is None:
        _, axes = drawing("matplotlib.pyplot").subplots()
    last = samples[-1]
    axes.set_title(last.stream)
    if last.kind == "scan":
        points = last.points
        axes.plot(points[:, 0], points[:, 1], ".")
        axes.plot([0], [0], "k^")
        axes.set_aspect("equal")
        _label(axes, "x in m", "y in m")
    elif last.kind == "image":
        axes.imshow(last.picture, cmap="gray")
        axes.set_axis_off()
    elif last.kind == "pose":
        import numpy as np
        poses = np.array([sample.data for sample in samples])
        axes.plot(poses[:, 0], poses[:, 1], ".-")
        axes.set_aspect("equal")
        _label(axes, "x in m", "y in m")
    elif last.kind in ("scalar", "vector"):
        times = [sample.taken_at - samples[0].taken_at for sample in samples]
        axes.plot(times, [sample.data for sample in samples], ".-")
        _label(axes, "time in s", last.units or last.stream)
    else:
        raise TypeError(f"stream {last.stream} brings bytes, which cannot be drawn; fix: use .data")
    return axes


def _label(axes: Any, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
