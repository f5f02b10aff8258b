"""ROS 2 straight over DDS (Cyclone DDS), for machines without rclpy and systems without zenoh.

Topics are known by the endpoints that DDS tells of itself; messages are handed over as they are on the wire.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import time
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype

from towtank.errors import InputError
from towtank.live.ros2_links import DOMAIN_LAST, Message, domain_of
from towtank.readers.rosbag_types import Types, types_of

__all__ = ["DdsLink"]

_DEPTH = 1000  # messages that wait for us
_TOPIC = "rt/"  # before the name of every topic of ROS 2
_KIND = re.compile(r"(\w+)::msg::dds_::(\w+)_")
_NANO = 1_000_000_000
_CONFIG = """<CycloneDDS><Domain Id="any"><Compatibility><IgnoreTypeInformation>1.1,1.15,1.16</IgnoreTypeInformation>
</Compatibility></Domain></CycloneDDS>"""  # of RTI, Fast DDS, Cyclone: types are matched by their names
_NUMBERS = {
    "bool": "bool", "byte": "uint8", "octet": "uint8", "char": "uint8", "int8": "int8", "uint8": "uint8",
    "int16": "int16", "uint16": "uint16", "int32": "int32", "uint32": "uint32", "int64": "int64", "uint64": "uint64",
    "float32": "float32", "float64": "float64",
}  # fmt: skip


class DdsLink:
    """A participant that only reads; Cyclone's own settings (CYCLONEDDS_URI) hold."""

    def __init__(self, text: str) -> None:
        match = re.fullmatch(r"dds:?(\d*)", text)
        if match is None or (match[1] and int(match[1]) > DOMAIN_LAST):
            raise InputError(f'source "{text}": expected dds:[DOMAIN] with a domain of 0 to {DOMAIN_LAST}')
        if importlib.util.find_spec("cyclonedds") is None:
            raise InputError(f'source "{text}": cyclonedds is not installed; pip install "towtank[dds]"')
        self._text, self._number = text, domain_of(int(match[1]) if match[1] else None)
        self._domain: Any = None
        self._participant: Any = None
        self._endpoints: Any = None
        self._waiting: Any = None
        self._published: dict[Any, tuple[str, str]] = {}  # key of an endpoint -> topic, type
        self._readers: list[tuple[str, str, Any, Any]] = []
        self.name = f"DDS, domain {self._number}"

    def open(self) -> None:
        """Join the domain."""
        try:
            core: Any = importlib.import_module("cyclonedds.core")
            builtin: Any = importlib.import_module("cyclonedds.builtin")
            domains: Any = importlib.import_module("cyclonedds.domain")
            self._domain = _lenient(domains, core, self._number)
            self._participant = domains.DomainParticipant(self._number)
            self._endpoints = builtin.BuiltinDataReader(self._participant, builtin.BuiltinTopicDcpsPublication)
            self._waiting = core.WaitSet(self._participant)
        except Exception as error:  # of the library's own kinds, and of a shared object that does not load
            self.close()
            raise InputError(
                f'source "{self._text}": DDS does not start ({" ".join(str(error).split())[:200]}); '
                "see CYCLONEDDS_URI for its network interfaces"
            ) from None

    def topics(self) -> dict[str, str]:
        """Return the topics of ROS 2 that somebody writes to."""
        while found := self._endpoints.take(N=100):
            for each in found:
                if not each.sample_info.valid_data:
                    self._published.pop(each.key, None)
                    continue
                match = _KIND.fullmatch(each.type_name)
                if match is not None and each.topic_name.startswith(_TOPIC):
                    kind = f"{match[1]}/msg/{match[2]}"
                    self._published[each.key] = each.topic_name.removeprefix(_TOPIC[:-1]), kind
        return dict(self._published.values())

    def subscribe(self, topic: str, kind: str) -> str:
        """Read a topic, best effort, whether its writer tells its type or not."""
        try:
            message = _struct(kind)
        except (ValueError, KeyError) as error:
            return f"{kind} is not known ({error})"
        core: Any = importlib.import_module("cyclonedds.core")
        policy = core.Policy
        qos = core.Qos(
            policy.Reliability.BestEffort,
            policy.Durability.Volatile,
            policy.History.KeepLast(_DEPTH),
            policy.TypeConsistency.AllowTypeCoercion(ignore_member_names=True),
        )
        try:
            named = importlib.import_module("cyclonedds.topic").Topic(
                self._participant, f"{_TOPIC[:-1]}{topic}", message
            )
            reader = importlib.import_module("cyclonedds.sub").DataReader(self._participant, named, qos=qos)
            unread = core.ReadCondition(reader, core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Any)
            self._waiting.attach(unread)
        except core.DDSException as error:
            return f"DDS: {' '.join(str(error).split())[:100]}"
        self._readers.append((topic, kind, reader, unread))
        return ""

    def receive(self, timeout: float) -> list[Message]:
        """Return what has come, in order of arrival topic by topic."""
        if self._readers:
            self._waiting.wait(round(timeout * _NANO))
        else:
            time.sleep(timeout)
        received = time.time()
        return [
            Message(topic, kind, received, each.data)
            for topic, kind, reader, _ in self._readers
            for each in reader.take(N=_DEPTH)
            if each.sample_info.valid_data
        ]

    def close(self) -> None:
        """Leave the domain; its entities go with the last reference to them."""
        with contextlib.suppress(Exception):
            for _, _, _, unread in self._readers:
                self._waiting.detach(unread)
        self._readers, self._published = [], {}
        self._endpoints = self._waiting = self._participant = self._domain = None


class _Bytes:
    """A message as it came: encapsulation and CDR."""

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


def _lenient(domains: Any, core: Any, number: int) -> Any:
    """Return the domain, set up to believe that a writer's type is what its name says; None where it exists already.

    Of a writer that tells its type Cyclone asks for all types within. Fast DDS answers with the outermost one alone,
    and then no reader is ever matched.
    """
    import os

    told = [os.environ.get("CYCLONEDDS_URI", ""), _CONFIG]
    with contextlib.suppress(core.DDSException):
        return domains.Domain(number, ",".join(filter(None, told)))
    return None


@cache
def _struct(kind: str) -> Any:
    """Return the type of a message for DDS, whose samples are left as bytes.

    Raises:
        ValueError: its definition is not known, or holds what DDS cannot be told.
    """
    message = _nested(kind, types_of(kind, "", "ros2msg", False))
    message.deserialize = staticmethod(lambda data, *rest, **more: _Bytes(bytes(data)))
    message.deserialize_key = message.deserialize  # of a writer that has gone
    return message


def _nested(kind: str, types: Types) -> Any:
    package, _, name = kind.partition("/msg/")
    fields = {each: _field(description, types) for each, description in types[kind]}
    idl: Any = importlib.import_module("cyclonedds.idl")
    return idl.make_idl_struct(f"{name}_", f"{package}::msg::dds_::{name}_", fields, dataclassify=False)


def _field(description: Any, types: Types) -> Any:
    node, detail = description
    kinds: Any = importlib.import_module("cyclonedds.idl.types")
    if node == Nodetype.NAME:
        return _nested(detail, types)
    if node == Nodetype.ARRAY:
        return kinds.array[_field(detail[0], types), detail[1]]
    if node == Nodetype.SEQUENCE:
        inner = _field(detail[0], types)
        return kinds.sequence[inner, detail[1]] if detail[1] else kinds.sequence[inner]
    name, bound = detail
    if name == "string":
        return kinds.bounded_str[bound] if bound else str
    if name not in _NUMBERS:
        raise ValueError(f"it holds {name}")
    return bool if name == "bool" else getattr(kinds, _NUMBERS[name])
