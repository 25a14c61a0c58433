# SPDX-License-Identifier: GPL-2.0-or-later
"""Samples as numbers, arrays and pictures."""
import struct
import time

import numpy
import pytest

import axon
from axon import Sample, _native
from axon import RefusalCode as Code
from support import wait_until


def varint(number):
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes(out + bytes([number]))


def field(number, content):
    """A field of a message of protobuf: bytes, a whole number or a double."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    if isinstance(content, float):
        return varint(number << 3 | 1) + struct.pack("<d", content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def sample(number, content, stream=b"eye", sequence=7):
    """As api/proto/axon/stream.proto: 4 scalar, 5 vector, 6 pose, 7 scan, 8 image, 9 raw."""
    raw = field(1, stream) + field(2, sequence) + field(3, 2_000_000 * 2) + field(number, content)
    return Sample(_native.read_sample("eye", raw))


def image(width, height, encoding, pixels):
    return sample(8, field(1, width) + field(2, height) + field(3, encoding) + field(4, pixels))


def test_numbers_poses_and_scans_are_arrays():
    assert float(sample(4, field(1, 12.5) + field(2, b"V"))) == 12.5
    assert sample(4, field(1, 12.5) + field(2, b"V")).units == "V"
    vector = sample(5, field(1, struct.pack("<3d", 1, 2, 3)) + field(2, b"mm"))
    assert vector.data.dtype == numpy.float64 and list(vector.data) == [1, 2, 3]
    assert vector.units == "mm" and vector.taken_at == 2.0
    pose = sample(6, field(1, 1.0) + field(6, 0.5) + field(7, b"map"))
    assert list(pose.data) == [1, 0, 0, 0, 0, 0.5] and pose.frame == "map"
    scan = sample(7, field(1, -0.5) + field(2, 0.5) + field(3, 8.0) + field(4, struct.pack("<3f", 1, 9, 2)))
    assert scan.data.dtype == numpy.float32 and list(scan.data) == [1, 9, 2]
    assert list(scan.angles) == [-0.5, 0, 0.5]
    assert len(scan.points) == 2, "9 m is beyond what it sees"
    assert sample(9, b"\x01\x02").data == b"\x01\x02"


def test_a_picture_is_an_array_that_nobody_has_copied():
    pixels = numpy.random.default_rng(1).integers(0, 256, (480, 640, 3), dtype=numpy.uint8)
    picture = image(640, 480, b"rgb8", pixels.tobytes())
    first, second = picture.data, picture.data
    assert first.shape == (480, 640, 3) and (first == pixels).all()
    assert not first.flags.owndata and not first.flags.writeable
    assert first.__array_interface__["data"] == second.__array_interface__["data"], "both look into the sample"
    assert numpy.shares_memory(first, picture.picture)
    del picture, second
    assert (first == pixels).all(), "the array keeps the sample alive"
    with pytest.raises(ValueError):
        first[0, 0, 0] = 1
    blue = image(1, 1, b"bgr8", b"\x00\x01\x02")
    assert list(blue.picture[0, 0]) == [2, 1, 0]
    assert image(2, 1, b"mono8", b"\x01\x02").data.shape == (1, 2)
    assert image(1, 2, b"mono16", b"\x01\x00\x02\x00").data.tolist() == [[1], [2]]


def test_reading_an_array_does_not_take_longer_for_more_pixels():
    def fastest(picture):
        picture.data  # reads the sample once; pylint: disable=pointless-statement
        times = []
        for _ in range(200):
            begin = time.perf_counter()
            picture.data  # pylint: disable=pointless-statement
            times.append(time.perf_counter() - begin)
        return min(times)
    small, large = image(8, 8, b"rgb8", bytes(8 * 8 * 3)), image(640, 480, b"rgb8", bytes(640 * 480 * 3))
    assert fastest(large) < 10 * fastest(small)


def test_what_cannot_be_read_says_so():
    with pytest.raises(ValueError, match="cannot be read"):
        Sample(_native.read_sample("eye", b"\xff\xff\xff")).data  # pylint: disable=expression-not-assigned
    with pytest.raises(ValueError, match="640 x 480 pixels of rgb8 was expected, and it has 3 bytes"):
        image(640, 480, b"rgb8", b"abc").data  # pylint: disable=expression-not-assigned
    with pytest.raises(ValueError):
        image(2**32 - 1, 2**32 - 1, b"rgb8", b"").data  # pylint: disable=expression-not-assigned
    with pytest.raises(TypeError, match="brings scalar, not image"):
        sample(4, field(1, 1.0)).picture  # pylint: disable=expression-not-assigned
    with pytest.raises(TypeError, match="brings scalar, not scan"):
        sample(4, field(1, 1.0)).points  # pylint: disable=expression-not-assigned
    assert Sample(_native.read_sample("eye", b"")).data is None


def test_samples_are_drawn(tmp_path):
    import matplotlib
    matplotlib.use("Agg")
    for drawn in (image(2, 2, b"rgb8", bytes(12)), sample(7, field(4, struct.pack("<2f", 1, 2)) + field(2, 0.1)), sample(4, field(1, 1.0)),
                  sample(6, field(1, 1.0)), sample(5, field(1, struct.pack("<2d", 1, 2)))):
        axes = drawn.plot()
        assert axes.get_title() == "eye"
        axes.figure.savefig(tmp_path / "figure.png")
    assert image(2, 2, b"rgb8", bytes(12))._repr_png_().startswith(b"\x89PNG")
    assert sample(4, field(1, 1.0))._repr_png_() is None
    with pytest.raises(TypeError, match="bytes, which cannot be drawn"):
        sample(9, b"x").plot()
    jpeg = tmp_path / "picture.jpg"
    from matplotlib import image as files
    files.imsave(jpeg, numpy.full((8, 8, 3), 200, dtype=numpy.uint8))
    assert image(8, 8, b"jpeg", jpeg.read_bytes()).picture.shape == (8, 8, 3)


def test_a_stream_is_iterated_and_its_oldest_samples_give_way(laboratory, client, take, refused):
    entity = laboratory.add()
    robot = take(client())
    with refused(Code.TIMED_OUT) as told:
        robot.battery.next(timeout=0.1)
    assert "0 of 1 samples of battery" in told.error.message
    texts = []
    robot.on_text(texts.append)
    with robot.stream("battery", limit=4).watch() as watch, robot.stream("where").watch() as end:
        wait_until(lambda: entity.sample("battery", 1.0, units="V") or len(watch._feed))
        wait_until(lambda: entity.sample("where", 0.0, 0.0) or len(end._feed))
        for number in range(40):
            entity.sample("battery", float(number), units="V")
        entity.sample("where", 9.0, 9.0)
        while list(end.take(1)[0].data) != [9, 9]:  # what was sent before has come before
            pass
        assert watch.dropped >= 30
        assert len(watch._feed) == 4
        last = watch.take(4)
    assert [float(one) for one in last] == [36, 37, 38, 39] and last[0].units == "V"
    assert last[0].sequence + 3 == last[3].sequence
    seen = []
    import threading
    stop = threading.Event()

    def send():
        while not stop.wait(0.01):
            entity.sample("where", 1.0, 2.0)
    sender = threading.Thread(target=send)
    sender.start()
    for one in robot.where:
        seen.append(list(one.data))
        if len(seen) == 3:
            break
    stop.set()
    sender.join()
    assert seen == [[1, 2]] * 3


def test_closing_the_connection_ends_an_iteration(laboratory, client, take):
    laboratory.add()
    lab = client()
    robot = take(lab)
    import threading
    ended = threading.Event()

    def iterate():
        for _ in robot.battery:
            pass
        ended.set()
    threading.Thread(target=iterate).start()
    wait_until(lambda: lab._feeds)
    lab.close()
    assert ended.wait(5)


def test_whoever_watches_need_not_hold(laboratory, client):
    entity = laboratory.add()
    lab = client()
    with lab.stream("PeopleBot", "").watch() as watch:
        wait_until(lambda: entity.sample("any", 3.0) or len(watch._feed))
        assert watch.take()[0].stream == "any"
    with pytest.raises(axon.Refused):
        lab.stream("Nobody", "x").watch()
