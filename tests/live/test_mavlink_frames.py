"""Messages out of datagrams and streams: what pymavlink packs is found, what is none is counted and never raises."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.live.links.mavlink.frames import Framer
from towtank.readers.mavlink.format import layouts

from .mavlink_peer import Autopilot


def messages(version: int = 2) -> list[bytes]:
    autopilot = Autopilot(version=version)
    return [
        part
        for k in range(20)
        for part in (
            autopilot.attitude(0.1 * k, 0.3),
            autopilot.outputs(0.1 * k, [1500 + k] * 8),
            autopilot.heartbeat(),
        )
    ]


@pytest.mark.parametrize("version", [1, 2])
def test_what_pymavlink_packs_is_found(version: int) -> None:
    packed = messages(version)
    authority = dialect.MAVLink(None).parse_buffer(b"".join(packed))
    framer = Framer(layouts(), stream=False)
    frames = [frame for data in packed for frame in framer.feed(data)]
    assert [frame.number for frame in frames] == [message.get_msgId() for message in authority]
    head = 10 if version == 2 else 6
    assert [frame.payload for frame in frames] == [bytes(message.get_msgbuf()[head:-2]) for message in authority]
    assert {(frame.sender, frame.version) for frame in frames} == {((1, 1), version)}
    assert (framer.bad, framer.unknown) == (0, 0)


@pytest.mark.parametrize("version", [1, 2])
def test_a_companion_is_told_from_the_autopilot_beside_it(version: int) -> None:
    framer = Framer(layouts(), stream=False)
    sent = [Autopilot(7, component, version=version).heartbeat() for component in (1, 194)]
    assert [frame.sender for data in sent for frame in framer.feed(data)] == [(7, 1), (7, 194)]


@pytest.mark.parametrize("step", [1, 7, 100])
def test_a_stream_in_pieces_gives_the_same(step: int) -> None:
    data = b"".join(messages())
    framer = Framer(layouts(), stream=True)
    frames = [frame for at in range(0, len(data), step) for frame in framer.feed(data[at : at + step])]
    assert len(frames) == 60
    assert framer.bad == 0


def test_signed_messages_are_taken() -> None:
    autopilot = Autopilot()
    autopilot.encoder.signing.secret_key = bytes(32)
    autopilot.encoder.signing.sign_outgoing = True
    autopilot.encoder.signing.timestamp = 1
    data = autopilot.attitude(1.0) + autopilot.heartbeat()
    assert [frame.number for frame in Framer(layouts(), stream=False).feed(data)] == [30, 0]


def test_garbage_between_messages_counts_once() -> None:
    first, second, *_ = messages()
    framer = Framer(layouts(), stream=True)
    assert len(framer.feed(first + b"\xfd\x09 not a message, and long enough to hold one" * 3 + second)) == 2
    assert framer.bad == 1


def test_a_wrong_checksum_counts_and_the_next_message_is_found() -> None:
    first, second, *_ = messages()
    damaged = bytearray(first)
    damaged[15] ^= 1
    framer = Framer(layouts(), stream=False)
    assert [frame.payload for frame in framer.feed(bytes(damaged) + second)] == [second[10:-2]]
    assert framer.bad == 1


def test_unknown_messages_are_not_bad() -> None:
    unknown = bytes((0xFD, 3, 0, 0, 0, 1, 1, 0xFF, 0xFE, 0x7F, 1, 2, 3, 9, 9))
    framer = Framer(layouts(), stream=False)
    assert len(framer.feed(unknown + messages()[0])) == 1
    assert (framer.bad, framer.unknown) == (0, 1)


def _flipped(data: bytearray, rng: random.Random) -> bytes:
    for _ in range(rng.randrange(1, 5)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


BREAKERS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "random": lambda data, rng: rng.randbytes(rng.randrange(400)),
    "cut": lambda data, rng: data[: rng.randrange(len(data))],
    "headless": lambda data, rng: data[rng.randrange(1, len(data)) :],
    "flipped": lambda data, rng: _flipped(bytearray(data), rng),
    "spliced": lambda data, rng: data[: rng.randrange(len(data))] + data[rng.randrange(len(data)) :],
    "magic": lambda data, rng: bytes(rng.choice((0xFD, 0xFE, rng.randrange(256))) for _ in range(300)),
}


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize("how", BREAKERS)
def test_broken_bytes_never_raise_and_good_ones_are_found_again(how: str, stream: bool) -> None:
    rng = random.Random(f"{how} {stream}")
    good = messages()
    framer = Framer(layouts(), stream=stream)
    for _ in range(500):
        framer.feed(BREAKERS[how](rng.choice(good), rng))
    assert len(framer._rest) < 600
    assert framer.bad + framer.unknown > 0
    framer.feed(bytes(600))
    assert len(framer.feed(good[0] + good[1])) == 2
