"""One closed-loop episode: the target flies, the defender replans at 10 Hz and flies what is committed.

``episode`` flies it in simulated time, which waits for the planner; ``realtime`` against the clock on the wall, through
``jaxplan.runtime``. ``judging`` says how it ended, ``records`` what comes of it.
"""

from jaxplan.interception.episode import fly, run, warm_up
from jaxplan.interception.judging import INTERCEPTION_RADIUS
from jaxplan.interception.realtime import run_in_real_time
from jaxplan.interception.records import FLYING, Episode, Flight, Follow, Guide, Progress, React, RealTime, Watch

__all__ = [
    "FLYING",
    "INTERCEPTION_RADIUS",
    "Episode",
    "Flight",
    "Follow",
    "Guide",
    "Progress",
    "React",
    "RealTime",
    "Watch",
    "fly",
    "run",
    "run_in_real_time",
    "warm_up",
]
