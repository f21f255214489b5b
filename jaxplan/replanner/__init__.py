"""The loop around the planner: what is committed, when it is replaced, and what happens when things go wrong.

``loop`` goes round, cycle by cycle; ``decision`` chooses among what a cycle has planned, ``stopping`` among stops;
``committed`` holds the plans and is the reference that the vehicle flies; ``incumbent`` says what the committed plan is
still worth, ``measured`` where the next plan begins if the vehicle is off its reference. ``passing`` is what is kept
from boxes that move, ``foresight`` where they will be if they are only seen, ``moving`` tells a loop of them;
``records`` names what goes in and out.
"""

from jaxplan.replanner.foresight import Foresight
from jaxplan.replanner.loop import Replanner
from jaxplan.replanner.moving import MovingBoxes
from jaxplan.replanner.passing import Ways
from jaxplan.replanner.records import CommittedPlan, Cycle, Measured, ReplannerConfig

__all__ = ["CommittedPlan", "Cycle", "Foresight", "Measured", "MovingBoxes", "Replanner", "ReplannerConfig", "Ways"]
