"""Planning beside a real vehicle: the planner in a process of its own, setpoints that never wait for it.

``pilot`` answers what is to be flown and watches over ``process``, in which ``worker`` plans. They talk through rings
in shared memory (``ring``, ``channel``, ``messages``); ``table`` and ``held`` are the plans as they are flown.
"""

from jaxplan.runtime.build import from_config, from_observed
from jaxplan.runtime.held import Setpoint
from jaxplan.runtime.memory import settle
from jaxplan.runtime.pilot import Runtime
from jaxplan.runtime.records import Build, Built, Phase, RuntimeConfig, RuntimeStatus

__all__ = [
    "Build",
    "Built",
    "Phase",
    "Runtime",
    "RuntimeConfig",
    "RuntimeStatus",
    "Setpoint",
    "from_config",
    "from_observed",
    "settle",
]
