"""Messages of ROS byte by byte: where each number stands, in both orders of bytes and both versions."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from towtank.readers.common.raw_messages import RawMessages
from towtank.readers.ros.layout import Decoded, decode
from towtank.readers.ros.types import types_of

KIND = "own_msgs/msg/Own"
DEFINITION = """
bool flag
float64 wide
int8 small
uint16 half
int32 whole
string frame_id
string note
uint64 long
float32[3] three
int16[] many
own_msgs/Part[] parts
own_msgs/Part part
string[] words
float64[4] covariance
uint8 last
================================================================================
MSG: own_msgs/Part
uint8 a
float64 b
"""


class Cdr:
    """Writes fields one behind the other, aligned as CDR is or packed as ROS 1 is."""

    def __init__(self, order: str, ros1: bool) -> None:
        self.order, self.ros1 = order, ros1
        self.data = b"" if ros1 else (b"\0\1\0\0" if order == "<" else b"\0\0\0\0")

    def put(self, letter: str, *numbers: float) -> None:
        for number in numbers:
            size = struct.calcsize("<" + letter)
            if not self.ros1:
                self.data += bytes(-(len(self.data) - 4) % size)
            self.data += struct.pack(self.order + letter, number)

    def text(self, words: str) -> None:
        data = words.encode() + (b"" if self.ros1 else b"\0")
        self.put("I", len(data))
        self.data += data


def message(
    order: str = "<", *, ros1: bool = False, many: tuple[int, ...] = (7, 8), note: str = "ab", k: int = 0
) -> bytes:
    out = Cdr(order, ros1)
    out.put("?", True)
    out.put("d", 1.5 + k)
    out.put("b", -3)
    out.put("H", 40_000)
    out.put("i", -70_000)
    out.text("base" if k % 2 == 0 else "odom")
    out.text(note)
    out.put("Q", 2**40)
    out.put("f", 0.25, 0.5, 0.75)
    out.put("I", len(many))
    out.put("h", *many)
    out.put("I", 2)
    for n in range(3):
        out.put("B", 10 + n)
        out.put("d", 20.0 + n)
    out.put("I", 2)
    out.text("x")
    out.text("yz")
    out.put("d", 1.0, 2.0, 3.0, 4.0)
    out.put("B", 200)
    return out.data


def decoded(messages: list[bytes], *, ros1: bool = False, definition: str = DEFINITION) -> Decoded:
    types = types_of(KIND, definition, "ros1msg" if ros1 else "ros2msg", ros1)
    return decode(RawMessages.of(messages), KIND, types, ros1=ros1)


EXPECTED = {
    **{"flag": 1.0, "wide": 1.5, "small": -3.0, "half": 40_000.0, "whole": -70_000.0, "long": 2.0**40},
    **{"three[0]": 0.25, "three[1]": 0.5, "three[2]": 0.75, "many[0]": 7.0, "many[1]": 8.0},
    **{"parts[0].a": 10.0, "parts[0].b": 20.0, "parts[1].a": 11.0, "parts[1].b": 21.0, "part.a": 12.0, "part.b": 22.0},
    **{"covariance[0]": 1.0, "covariance[3]": 4.0, "last": 200.0},
}


@pytest.mark.parametrize(("order", "ros1"), [("<", False), (">", False), ("<", True)])
def test_every_number_stands_where_it_should(order: str, ros1: bool) -> None:
    found = decoded([message(order, ros1=ros1)], ros1=ros1)
    assert found.good.tolist() == [True]
    assert {name: float(values[0]) for name, values in found.columns.items()} == EXPECTED
    assert found.texts == {"frame_id": ("base",)}


def test_messages_of_several_lengths_are_told_apart() -> None:
    mixed = [message(k=0), message(many=(), k=1), message(note="abcd", k=2), message(many=(1,), k=3), message(k=4)]
    found = decoded(mixed)
    assert found.good.all()
    np.testing.assert_array_equal(found.columns["wide"], [1.5, 2.5, 3.5, 4.5, 5.5])
    np.testing.assert_array_equal(found.columns["many[0]"], [7.0, np.nan, 7.0, 1.0, 7.0])
    np.testing.assert_array_equal(found.columns["many[1]"], [8.0, np.nan, 8.0, np.nan, 8.0])
    assert found.columns["last"].tolist() == [200.0] * 5
    assert found.texts["frame_id"] == ("base", "odom", "base", "odom", "base")


def test_both_orders_of_bytes_in_one_topic() -> None:
    found = decoded([message("<"), message(">", k=1), message("<", k=2)])
    assert found.columns["wide"].tolist() == [1.5, 2.5, 3.5]


@pytest.mark.parametrize("ros1", [False, True])
def test_a_message_that_does_not_fit_its_type_is_left_out(ros1: bool) -> None:
    whole = message(ros1=ros1)
    spare = whole + bytes(1 if ros1 else 8)
    found = decoded([whole, whole[:-1], spare, b"", whole], ros1=ros1)
    assert found.good.tolist() == [True, False, False, False, True]
    np.testing.assert_array_equal(found.columns["last"], [200.0, np.nan, np.nan, np.nan, 200.0])
    if not ros1:
        assert decoded([whole + bytes(7)]).good.tolist() == [True]  # filled up
        assert decoded([b"\1" + whole[1:], b"\0\2" + whole[2:], whole[:3]]).good.tolist() == [False] * 3


def test_a_topic_of_nothing_but_misfits_is_given_up() -> None:
    found = decoded([b"no"] * 300 + [message()])
    assert not found.good.any()
    assert decoded([b"no"] * 199 + [message()]).good.sum() == 1


def test_long_arrays_are_cut_and_of_covariances_the_diagonal_is_taken() -> None:
    definition = "float32[100] many\nfloat64[36] pose_covariance\nfloat64[6] covariance_of\nfloat64[1] covar\n"
    out = Cdr("<", False)
    out.put("f", *range(100))
    out.put("d", *range(36), *range(6), 9.0)
    found = decoded([out.data], definition=definition)
    assert found.good.all()
    names = [name for name in found.columns if name.startswith("many")]
    assert names == [f"many[{k}]" for k in range(64)]
    assert found.columns["many[63]"][0] == 63.0
    assert [name for name in found.columns if name.startswith("pose")] == [
        f"pose_covariance[{7 * k}]" for k in range(6)
    ]
    assert [name for name in found.columns if name.startswith("covariance_of")] == [
        f"covariance_of[{k}]" for k in range(6)
    ]
    assert found.columns["covar[0]"][0] == 9.0


def test_a_covariance_that_is_no_square_is_taken_whole() -> None:
    out = Cdr("<", False)
    out.put("d", 0.1, 0.2, 0.3)
    found = decoded([out.data], definition="float64[3] velocity_covariance\n")
    assert {name: float(values[0]) for name, values in found.columns.items()} == {
        "velocity_covariance[0]": 0.1,
        "velocity_covariance[1]": 0.2,
        "velocity_covariance[2]": 0.3,
    }


def test_arrays_longer_than_the_message_and_endless_types_are_refused() -> None:
    out = Cdr("<", False)
    out.put("I", 2**31)
    out.put("B", 1)
    assert not decoded([out.data], definition="uint8[] many\n").good.any()
    empty = Cdr("<", False)
    empty.put("I", 0)
    found = decoded([empty.data], definition="float64[] many\n")
    assert found.good.all()
    assert not found.columns
    strings = Cdr("<", False)
    strings.put("I", 30_000)
    strings.data += bytes(30_000 * 4)
    assert not decoded([strings.data], definition="string[] words\n").good.any()
