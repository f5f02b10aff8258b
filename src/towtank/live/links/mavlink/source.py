"""A vehicle that speaks MAVLink, over UDP, TCP or a serial line. Here it is only listened to."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.live.links.datagrams import Allowance, received_from
from towtank.live.links.mavlink.connection import Address, connection_of
from towtank.live.links.mavlink.frames import Frame, Framer
from towtank.live.links.mavlink.requests import SYSTEM, Requests, parameter_of
from towtank.live.links.mavlink.samples import Arrival, MavlinkSamples
from towtank.live.links.source import Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import Vehicle

__all__ = ["MavlinkSource"]

_LISTEN = "?listen"
_TURN = 0.1  # s at most until questions and decisions have their turn
_FIRST, _EVERY, _AT_LEAST = 1.0, 5.0, 0.5  # s until the first decision, between decisions, and at least
_SETTLED = 6.0  # s after which parameters are not waited for any longer
_STATE = 0.5  # s between two looks at rates
_MOST_SENDERS = 100
_SILENT = 3.0  # s after which a sender's messages may come from another address
_RAW = "raw"
Watch = Callable[[str, Callable[[], Any], float], None]  # a message's name, its fields on demand, when it came [s]


class MavlinkSource:
    """A link to an autopilot.

    Args:
        text: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, /dev/NAME,BAUD; with "?listen" behind it nothing is
            sent, not even a question for rates.
        vehicle: whose thrusters the outputs drive.

    Attributes:
        watch: called with every message of the autopilot that is followed; None: nobody watches.
    """

    name = "mavlink"
    keeps_time, patient = True, False

    def __init__(self, text: str, vehicle: Vehicle) -> None:
        self._text = text
        self._connection = connection_of(text.removesuffix(_LISTEN))
        self._requests = Requests(
            speaks_first=self._connection.speaks_first,
            bandwidth=self._connection.bandwidth,
            silent=text.endswith(_LISTEN),
        )
        self._layouts = layouts()
        self._framer = Framer(self._layouts, stream=self._connection.stream)
        self._samples = MavlinkSamples(self._layouts, len(vehicle.thrusters))
        self._addresses: dict[Sender, Address] = {}
        self._versions: dict[Sender, int] = {}
        self._opened = self._first = self._aimed = math.nan
        self._heard = self._next_decision = self._looked = -math.inf
        self._restarts = 0
        self._spoken: dict[Sender, float] = {}  # when each was heard last [s], at the address that it is followed at
        self._foreign: dict[str, int] = {}  # messages of a sender from another address, by both
        self._noise = Allowance()
        self._state = SourceState()
        self.watch: Watch | None = None

    def also(self, rates: Mapping[str, float], parameters: Sequence[str]) -> None:
        """Ask for further messages [Hz] and parameters; to be called before it is opened.

        Raises:
            InputError: it asks for nothing, as told.
        """
        if self._requests.silent:
            raise InputError(f'source "{self._text}": found {_LISTEN}, with which nothing may be sent; leave it out')
        self._requests.also(rates, parameters)

    @property
    def target(self) -> Sender | None:
        """The autopilot that is followed; None while there is none."""
        return self._requests.target

    @property
    def parameters(self) -> dict[str, float]:
        """The autopilot's parameters, as far as they are known."""
        return dict(self._requests.parameters)

    def send(self, data: bytes) -> None:
        """Send something of somebody else's to the autopilot; any thread may call it."""
        target = self._requests.target
        if target is not None:
            self._connection.send(data, self._addresses.get(target))

    def open(self) -> None:
        """Open the connection. Raises InputError where that cannot be."""
        self._connection.open()
        self._opened = self._heard = steady_time()
        self._look(self._opened)

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what has come, as bytes and as samples, their stamps on our clock."""
        with np.errstate(all="ignore"):  # fields may hold anything
            return self._read(min(timeout, _TURN))

    def _read(self, timeout: float) -> list[Sample | Raw]:
        found: list[Sample | Raw] = []
        arrivals: list[Arrival] = []
        for data, received, address in self._connection.receive(timeout):
            frames = self._framer.feed(data)
            if frames or self._connection.stream or self._noise.takes(data):
                found.append(Raw(self.name, _RAW, received, data))
            for frame in frames:
                if frame.sender.system != SYSTEM and self._hear(frame, received, address):
                    arrivals.append((frame, received))
        now = steady_time()
        if arrivals:
            self._heard = now
            self._first = now if math.isnan(self._first) else self._first
            found += self._samples.take(arrivals)
        self._decide(now)
        target = self._requests.target
        for message in self._requests.due(now, self._heard):
            self._connection.send(message, None if target is None else self._addresses.get(target))
        if now - self._looked >= _STATE or self._samples.restarts > self._state.restarts:
            self._look(now)
        return found

    def _hear(self, frame: Frame, received: float, address: Address) -> bool:
        """Take note of who speaks from where, and of what answers a question; return whether it is who it says.

        Two vehicles may bear one number. The one that was heard first is followed while it speaks.
        """
        before = self._addresses.get(frame.sender, address)
        if before != address and received - self._spoken.get(frame.sender, -math.inf) <= _SILENT:
            who = f"{frame.sender} at {received_from(address)}"
            who = who if who in self._foreign or len(self._foreign) < _MOST_SENDERS else "others"
            self._foreign[who] = self._foreign.get(who, 0) + 1
            return False
        if frame.sender in self._addresses or len(self._addresses) < _MOST_SENDERS:
            self._addresses[frame.sender], self._spoken[frame.sender] = address, received
            self._versions[frame.sender] = max(frame.version, self._versions.get(frame.sender, 1))
        layout = self._layouts[frame.number]
        if self.watch is not None and frame.sender == self._requests.target:
            self.watch(layout.name, lambda: layout.rows([frame.payload])[0], received)
        if layout.name == "COMMAND_ACK":
            row = layout.rows([frame.payload])[0]
            self._requests.hear(frame, float(row["command"]), float(row["result"]))
        elif layout.name == "PARAM_VALUE" and frame.sender == self._requests.target:
            row = layout.rows([frame.payload])[0]
            name = bytes(row["param_id"]).split(b"\0")[0].decode("ascii", errors="replace")
            value = parameter_of(name, float(row["param_value"]), float(row["param_type"]))
            if math.isfinite(value) and self._requests.learn(name, value):
                self._samples.hurry = True
        return True

    def _decide(self, now: float) -> None:
        """Decide anew what is used where it is time for it."""
        if math.isnan(self._first) or now - self._first < _FIRST:
            return
        since = now - (self._next_decision - _EVERY)
        if now < self._next_decision and not (self._samples.hurry and since >= _AT_LEAST):
            return
        settled = self._requests.settled or now - self._aimed > _SETTLED
        self._samples.decide(now, self._requests.parameters, settled=settled)
        self._next_decision = now + (_EVERY if settled else 1.0)
        self._state = replace(self._state, attributes=self._samples.attributes)  # known before the first sample
        target = self._samples.autopilot.sender
        if target is not None:
            if target != self._requests.target:
                self._aimed, self._restarts = now, self._samples.restarts
            self._requests.aim(target, self._versions.get(target, 2))
        if self._samples.restarts > self._restarts:
            self._restarts = self._samples.restarts
            self._requests.begin_anew()

    def _look(self, now: float) -> None:
        """Write down how the link fares, for whoever asks."""
        self._looked = now
        said = [self._connection.broken] if self._connection.broken else []
        silence = now - self._heard
        if silence > 2.0:
            said.append(f"{self._text}: nothing has come for {silence:.0f} s")
        said += [*self._samples.said(), *self._requests.said()]
        if self._restarts:
            said.append(f"the autopilot has started anew ({self._restarts} times)")
        if self._framer.unknown:
            said.append(f"{self._framer.unknown} messages of unknown numbers")
        if self._foreign:
            who = max(self._foreign, key=lambda each: self._foreign[each])
            count = sum(self._foreign.values())
            said.append(f"another vehicle bears a number that is taken ({who}): {count} messages passed over")
        if self._samples.strange:
            said.append(f"{self._samples.strange} messages passed over whose stamps cannot be")
        said += self._noise.said
        if self._connection.dropped:
            said.append(f"{self._connection.dropped} datagrams dropped by the system: more came than can be read")
        self._state = SourceState(
            said=tuple(said),
            asked={} if self._requests.target is None else dict(self._requests.asked),
            rates=self._samples.rates(now),
            bad=self._framer.bad + self._samples.strange,
            dropped=self._connection.dropped,
            foreign=sum(self._foreign.values()),
            restarts=self._samples.restarts,
            senders=tuple(str(sender) for sender in sorted(self._addresses)),
            attributes=self._samples.attributes,
        )

    def state(self) -> SourceState:
        """Return how the link fares, as of the last half second."""
        return self._state

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()
        self._look(steady_time())
