"""Planning: what a run will make known before it is driven, and the runs that make most known."""

from towtank.planning.design import Design, design, diagonal
from towtank.planning.forecast import INSTRUMENTS, RATE, Forecast, Instruments, Outlook, draws_of, forecast
from towtank.planning.guard import Guard, drawn_around
from towtank.planning.guarded import GuardedRun, guarded_commands, guarded_run
from towtank.planning.plan import PAUSE, Accuracy, Plan, Planned, aims, forecasts, plan, read_plan, write_plan
from towtank.planning.segments import Segment
from towtank.planning.space import Space
from towtank.planning.unsteered import Unsteered, unsteered

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
    "Unsteered",
    "aims",
    "design",
    "diagonal",
    "drawn_around",
    "draws_of",
    "forecast",
    "forecasts",
    "guarded_commands",
    "guarded_run",
    "plan",
    "read_plan",
    "unsteered",
    "write_plan",
]
