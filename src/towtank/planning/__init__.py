"""Planning: what a run will make known before it is driven, and the runs that make most known."""

from towtank.planning.design import Design, design, diagonal
from towtank.planning.forecast import INSTRUMENTS, RATE, Forecast, Instruments, Outlook, draws_of, forecast
from towtank.planning.guard import Guard, drawn_around
from towtank.planning.guarded import GuardedRun, guarded_commands, guarded_run
from towtank.planning.plan import PAUSE, Accuracy, Plan, Planned, aims, plan, read_plan, write_plan
from towtank.planning.segments import Segment
from towtank.planning.space import Space

__all__ = [
    "INSTRUMENTS",
    "PAUSE",
    "RATE",
    "Accuracy",
    "Design",
    "Forecast",
    "Guard",
    "GuardedRun",
    "Instruments",
    "Outlook",
    "Plan",
    "Planned",
    "Segment",
    "Space",
    "aims",
    "design",
    "diagonal",
    "drawn_around",
    "draws_of",
    "forecast",
    "guarded_commands",
    "guarded_run",
    "plan",
    "read_plan",
    "write_plan",
]
