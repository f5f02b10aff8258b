"""What was repaired in a recording, counted; what a log held, table by table, and what each was used for."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Content", "Repairs"]


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


@dataclass(frozen=True)
class Repairs:
    """Counts of what reading and alignment mended; add two to get both.

    Attributes:
        disorder: samples whose stamp was earlier than one before them; sorted.
        duplicates: samples with the stamp of another one; merged, the last value that is not NaN wins.
        untimed: rows without a time that can be one; dropped.
        nan: values missing in the middle of a channel (NaN or an empty cell); interpolated if the hole is
            short.
        infinities: infinite values; treated as not measured.
        beyond: values beyond what their unit can be; treated as not measured.
        spikes: isolated outliers of one sample; treated as not measured.
        gaps: holes too long to interpolate over; left as NaN.
        damaged: messages that could not be decoded, of a broken or cut file; left out.
        dead: channels that stand still while their neighbours, or they themselves before, carry noise; reported, not
            changed.
        details: further lines for a person, such as which channel had the spikes.
    """

    disorder: int = 0
    duplicates: int = 0
    untimed: int = 0
    nan: int = 0
    infinities: int = 0
    beyond: int = 0
    spikes: int = 0
    gaps: int = 0
    damaged: int = 0
    dead: tuple[str, ...] = ()
    details: tuple[str, ...] = ()

    def __add__(self, other: Repairs) -> Repairs:
        if not isinstance(other, Repairs):
            return NotImplemented
        return Repairs(
            disorder=self.disorder + other.disorder,
            duplicates=self.duplicates + other.duplicates,
            untimed=self.untimed + other.untimed,
            nan=self.nan + other.nan,
            infinities=self.infinities + other.infinities,
            beyond=self.beyond + other.beyond,
            spikes=self.spikes + other.spikes,
            gaps=self.gaps + other.gaps,
            damaged=self.damaged + other.damaged,
            dead=tuple(dict.fromkeys(self.dead + other.dead)),
            details=tuple(dict.fromkeys(self.details + other.details)),
        )

    def __bool__(self) -> bool:
        return self != Repairs()

    @property
    def lines(self) -> tuple[str, ...]:
        """One line per kind of repair, then the details; empty when nothing was wrong."""
        counted = [
            (self.damaged, "damaged message (left out)", "damaged messages (left out)"),
            (self.disorder, "sample out of order (sorted)", "samples out of order (sorted)"),
            (self.duplicates, "repeated time stamp (merged)", "repeated time stamps (merged)"),
            (self.untimed, "row without a time (dropped)", "rows without a time (dropped)"),
            (self.nan, "missing value", "missing values"),
            (self.infinities, "infinite value (taken as missing)", "infinite values (taken as missing)"),
            (self.beyond, "value that cannot be (taken as missing)", "values that cannot be (taken as missing)"),
            (self.spikes, "spike (taken as missing)", "spikes (taken as missing)"),
            (self.gaps, "gap (not bridged)", "gaps (not bridged)"),
        ]
        lines = [_count(number, one, many) for number, one, many in counted if number]
        if self.dead:
            why = "constant, while channels beside or they themselves before carry noise"
            lines.append(f"dead: {', '.join(self.dead)} ({why})")
        return (*lines, *self.details)

    @property
    def summary(self) -> str:
        """All lines in one, or "nothing to repair"."""
        return "; ".join(self.lines) or "nothing to repair"


@dataclass(frozen=True)
class Content:
    """One table of a log: a topic, a message type or one instance of it.

    Attributes:
        name: as a mapping names it: "IMU[0]", "SERVO_OUTPUT_RAW", "/rov/dvl".
        kind: type of its messages: "DataFlash", "MAVLink", "sensor_msgs/msg/Imu".
        count: messages.
        rate: usual rate [Hz], None where fewer than two have a time.
        used: the channels that were taken from it.
        reason: why it, or the rest of it, was not used; empty where there is nothing to say.
    """

    name: str
    kind: str
    count: int
    rate: float | None
    used: tuple[str, ...] = ()
    reason: str = ""
