"""ROS 2 by the ways there are: rclpy where it can be imported, else zenoh, or straight over DDS (Cyclone DDS).

All hand over messages as they are on the wire (CDR), so that nothing of ROS is needed to know what they mean. Nothing
is published; subscriptions are best effort, so that a slow listener holds up nobody. DDS is for machines without rclpy
and systems without zenoh; topics are known by the endpoints that it announces.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import time
from collections import deque
from functools import cache
from typing import Any, NamedTuple, Protocol

from rosbags.interfaces import Nodetype

from towtank.errors import InputError
from towtank.live.pipeline.clock import steady_time
from towtank.readers.ros.types import Types, types_of

__all__ = ["DdsLink", "Message", "RclpyLink", "Ros2Link", "ZenohLink", "link_of", "topic_of_key", "topic_of_token"]

DOMAIN_LAST = 232  # that DDS has ports for
_DEPTH = 1000  # messages that wait for us
_ENDPOINT = "tcp/localhost:7447"  # of the router of rmw_zenoh
_DDS = re.compile(r"(\w+)::(\w+)::dds_::(\w+)_")
_PUBLISHER = "MP"
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


class Message(NamedTuple):
    """One message: topic and type, when it came [s], and its bytes."""

    topic: str
    kind: str
    received: float
    data: bytes


class Ros2Link(Protocol):
    """A way to the topics of a ROS 2 system; `name` says which."""

    name: str

    def open(self) -> None:
        """Begin. Raises InputError in one line where that cannot be."""

    def topics(self) -> dict[str, str]:
        """Return the topics that somebody publishes, with their types."""
        ...

    def subscribe(self, topic: str, kind: str) -> str:
        """Listen to a topic; return why that cannot be, "" where it can."""
        ...

    def receive(self, timeout: float) -> list[Message]:
        """Return what has come; wait for it at most so long [s]."""
        ...

    def close(self) -> None:
        """End; may be called twice."""


def link_of(text: str) -> Ros2Link:
    """Return the link for ros2:[DOMAIN][@ENDPOINT] or dds:[DOMAIN]. Raises InputError where there is none."""
    if text.startswith("dds"):
        return DdsLink(text)
    match = re.fullmatch(r"ros2:?(\d*)(?:@(.+))?", text)
    if match is None or (match[1] and int(match[1]) > DOMAIN_LAST):
        raise InputError(
            f'source "{text}": expected ros2:[DOMAIN] with a domain of 0 to {DOMAIN_LAST}, or ros2:[DOMAIN]@ENDPOINT'
        )
    domain = int(match[1]) if match[1] else None
    if match[2] is None and importlib.util.find_spec("rclpy") is not None:
        return RclpyLink(text, domain)
    if importlib.util.find_spec("zenoh") is not None:
        return ZenohLink(text, domain, match[2] or _ENDPOINT)
    raise InputError(
        f'source "{text}": neither rclpy nor zenoh is installed; source a ROS 2 installation for this Python, or '
        'pip install "towtank[ros2]" and run the zenoh router of ROS 2, or "towtank[dds]" and name dds:DOMAIN'
    )


def domain_of(domain: int | None) -> int:
    """Return the domain that was given, else that of ROS_DOMAIN_ID, else 0."""
    import os

    number = os.environ.get("ROS_DOMAIN_ID", "")
    return domain if domain is not None else int(number) if number.isdigit() else 0


class RclpyLink:
    """A node without publishers, services or parameters."""

    def __init__(self, text: str, domain: int | None) -> None:
        self._text, self._domain = text, domain
        self._context: Any = None
        self._node: Any = None
        self._executor: Any = None
        self._came: deque[Message] = deque(maxlen=100 * _DEPTH)
        self.name = "rclpy"

    def open(self) -> None:
        """Join the ROS graph."""
        try:
            rclpy: Any = importlib.import_module("rclpy")
            self._context = rclpy.Context()
            options = importlib.import_module("rclpy.signals").SignalHandlerOptions.NO
            rclpy.init(context=self._context, domain_id=self._domain, signal_handler_options=options)
            self._node = rclpy.create_node(
                "towtank", context=self._context, start_parameter_services=False, enable_rosout=False
            )
            executors = importlib.import_module("rclpy.executors")
            self._executor = executors.SingleThreadedExecutor(context=self._context)
            self._executor.add_node(self._node)
        except Exception as error:  # a broken installation raises anything
            self.close()
            reason = " ".join(str(error).split())
            raise InputError(
                f'source "{self._text}": rclpy does not start ({type(error).__name__}: {reason})'
            ) from None
        self.name = f"rclpy, domain {self._context.get_domain_id()}"

    def topics(self) -> dict[str, str]:
        """Return the topics that are published, with the first of their types."""
        found = self._node.get_topic_names_and_types()
        return {name: kinds[0] for name, kinds in found if kinds and self._node.count_publishers(name)}

    def subscribe(self, topic: str, kind: str) -> str:
        """Subscribe to the bytes of a topic."""
        package, _, name = kind.partition("/msg/")
        try:
            message = getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            return f"{kind} is not installed in this ROS"
        qos: Any = importlib.import_module("rclpy.qos")
        profile = qos.QoSProfile(depth=_DEPTH, reliability=qos.ReliabilityPolicy.BEST_EFFORT)

        def keep(data: bytes) -> None:
            self._came.append(Message(topic, kind, steady_time(), bytes(data)))

        self._node.create_subscription(message, topic, keep, profile, raw=True)
        return ""

    def receive(self, timeout: float) -> list[Message]:
        """Return what has come."""
        end = time.monotonic() + timeout
        self._executor.spin_once(timeout_sec=timeout)
        while self._came and len(self._came) < 256 and time.monotonic() < end:
            before = len(self._came)
            self._executor.spin_once(timeout_sec=0.0)
            if len(self._came) == before:
                break
        return [self._came.popleft() for _ in range(len(self._came))]

    def close(self) -> None:
        """Leave the graph."""
        with contextlib.suppress(Exception):
            if self._executor is not None:
                self._executor.shutdown(timeout_sec=1.0)
            if self._node is not None:
                self._node.destroy_node()
            if self._context is not None:
                self._context.try_shutdown()
        self._executor = self._node = self._context = None


class ZenohLink:
    """A zenoh session as client of a router; topics are known by the tokens that rmw_zenoh declares."""

    def __init__(self, text: str, domain: int | None, endpoint: str) -> None:
        self._text, self._number, self._endpoint = text, domain_of(domain), endpoint
        self._session: Any = None
        self._subscriptions: list[Any] = []
        self._came: deque[Message] = deque(maxlen=100 * _DEPTH)
        self.name = f"zenoh at {endpoint}, domain {self._number}"

    def open(self) -> None:
        """Connect to the router."""
        zenoh: Any = importlib.import_module("zenoh")
        config = zenoh.Config()
        try:
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", f'["{self._endpoint}"]')
            config.insert_json5("connect/timeout_ms", "2000")
            config.insert_json5("scouting/multicast/enabled", "false")
            self._session = zenoh.open(config)
        except Exception as error:  # of the library's own kinds
            reason = " ".join(str(error).split())[:200]
            raise InputError(f'source "{self._text}": no zenoh router at {self._endpoint} ({reason})') from None

    def topics(self) -> dict[str, str]:
        """Return the topics by the tokens of their publishers."""
        found: dict[str, str] = {}
        for reply in self._session.liveliness().get(f"@ros2_lv/{self._number}/**", timeout=1.0):
            known = topic_of_token(str(reply.ok.key_expr)) if reply.ok is not None else None
            if known is not None:
                found.setdefault(*known)
        return found

    def subscribe(self, topic: str, kind: str) -> str:
        """Subscribe to a topic, whatever the hash of its type, which Humble does not send."""
        package, _, name = kind.partition("/msg/")
        key = f"{self._number}/{topic.strip('/')}/{package}::msg::dds_::{name}_/**"

        def keep(sample: Any) -> None:
            self._came.append(Message(topic, kind, steady_time(), sample.payload.to_bytes()))

        try:
            self._subscriptions.append(self._session.declare_subscriber(key, keep))
        except Exception as error:
            return f"zenoh: {' '.join(str(error).split())[:100]}"
        return ""

    def receive(self, timeout: float) -> list[Message]:
        """Return what has come; zenoh's own threads take it."""
        end = time.monotonic() + timeout
        while not self._came and time.monotonic() < end:
            time.sleep(0.001)
        return [self._came.popleft() for _ in range(len(self._came))]

    def close(self) -> None:
        """Disconnect."""
        if self._session is not None:
            with contextlib.suppress(Exception):
                self._session.close()
            self._session = None


def topic_of_token(token: str) -> tuple[str, str] | None:
    """Return topic and type of a publisher's token, None for anything else.

    @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/MP/ENCLAVE/NAMESPACE/NODE NAME/TOPIC/TYPE/HASH/QOS, where % stands for /.
    """
    parts = token.split("/")
    if len(parts) < 11 or parts[5] != _PUBLISHER:
        return None
    kind = _kind(parts[10])
    return (parts[9].replace("%", "/"), kind) if kind else None


def topic_of_key(key: str) -> tuple[str, str] | None:
    """Return topic and type of DOMAIN/TOPIC/TYPE/HASH, None for anything else."""
    parts = key.split("/")
    for place in range(2, len(parts)):
        kind = _kind(parts[place])
        if kind:
            return "/" + "/".join(parts[1:place]), kind
    return None


def _kind(mangled: str) -> str:
    match = _DDS.fullmatch(mangled)
    return "/".join(match.groups()) if match else ""


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
        received = steady_time()
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

    configuration = [os.environ.get("CYCLONEDDS_URI", ""), _CONFIG]
    with contextlib.suppress(core.DDSException):
        return domains.Domain(number, ",".join(filter(None, configuration)))
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
