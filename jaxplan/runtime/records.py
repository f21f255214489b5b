"""What the runtime is told and what it says of itself."""

import dataclasses
import enum
from typing import NamedTuple, Protocol, runtime_checkable

from jaxplan.planner import Planner
from jaxplan.prediction.protocol import Predictor
from jaxplan.prediction.stream import StreamConfig
from jaxplan.replanner import ReplannerConfig
from jaxplan.spline import FlatState
from jaxplan.status import PlanStatus
from jaxplan.validation import require_at_least, require_positive, require_within
from jaxplan.world.obstacles import World


class Phase(enum.Enum):
    """What the planner's process is doing. Whatever it is, the certified plan is flown, to rest at its end."""

    STARTING = "starting"
    """It loads and compiles."""
    WAITING = "waiting"
    """It is ready, and nothing was seen of the target yet."""
    PLANNING = "planning"
    """It plans, cycle by cycle."""
    SILENT = "silent"
    """Nothing was heard of it for a while."""
    RESTARTING = "restarting"
    """It died or was killed, and another one loads and compiles."""
    FAILED = "failed"
    """It cannot be started; it is not tried again."""
    STOPPED = "stopped"
    """``close`` was called."""


@dataclasses.dataclass(frozen=True)
class RuntimeConfig:
    """Timing of the watchdog, and what the loop in the planner's process is told."""

    replanning: ReplannerConfig = ReplannerConfig(drop_late=True, most_latency=0.3)
    stream: StreamConfig = StreamConfig()
    silent_after: float = 0.5
    """Seconds without a sign of life after which the planner counts as silent."""
    restart_after: float = 5.0
    """Seconds of silence after which it is killed and started anew."""
    start_within: float = 300.0
    """Seconds after which a planner that is still loading is killed and started anew."""
    most_restarts: int = 5
    """Restarts in a row without one that became ready; after these it is given up."""
    odometry_age: float = 0.1
    """Older [s] measurements of the vehicle are not used."""
    niceness: int = 5
    """By how much the planner's process stands back behind the one that asks for setpoints."""
    remembered: int = 100
    """Plans that are kept for the record."""

    def __post_init__(self) -> None:
        require_positive("runtime", self, "silent_after", "start_within", "odometry_age")
        require_at_least("runtime", self, self.silent_after, "restart_after")
        require_at_least("runtime", self, 0, "most_restarts")
        require_at_least("runtime", self, 4, "remembered")
        require_within("runtime", self, 0, 19, "niceness")


class Built(NamedTuple):
    """What the planner's process needs."""

    planner: Planner
    predictor: Predictor
    world: World
    """The planner's, with spare boxes where boxes are to appear (``jaxplan.with_spare_boxes``)."""
    start: FlatState
    """Any state in the world: what warm-up plans from."""


@runtime_checkable
class Build(Protocol):
    """Makes what the planner's process needs, in that process: a function at the top of a module, or a ``partial``."""

    def __call__(self) -> Built:
        """Called once in each process that is started; errors of the library end the runtime with their message."""


class RuntimeStatus(NamedTuple):
    """How the planner's process is doing."""

    phase: Phase
    reason: str
    """Why, where the phase does not say it; the last error or refusal otherwise."""
    age: float
    """Seconds since its last sign of life; infinite before the first."""
    plan_age: float
    """Seconds since the newest plan took over, negative before; infinite for the hover at the start."""
    plan_status: PlanStatus
    """Of the newest cycle."""
    latency: float
    """Seconds from a cycle's observations until its plan takes over; NaN before the first cycle."""
    cycles: int
    """Of this process."""
    late: int
    """Plans that were dropped because they were too late."""
    refused: dict[str, int]
    """Plans that the pilot did not take, by reason."""
    restarts: int
    """Processes that were started after the first one."""
    compilations_after_warmup: int
    memory_mb: float
    """Resident memory of the planner's process, at its largest."""
