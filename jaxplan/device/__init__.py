"""A replan, and whole episodes, as programs of arrays alone: many at a time on one device, a GPU above all.

``jaxplan.planner`` searches on the host and evaluates only what can win; that is soonest for one defender on a CPU.
Here every station is a pure function that is traced: ``room`` has the roadmap with the distances between all of its
places, ``paths`` reads shortest ways off it, ``replan`` goes from goals to the chosen trajectory, ``predict`` proposes
the goals, ``episodes`` is one period of a closed loop, and ``runner`` flies many loops at once. Knots, network, arrival
times, minimum snap, checks and plant are those of the other packages.
"""

from jaxplan.device.replan import Decision, ReplanConfig, build_replan
from jaxplan.device.room import Room, room_of
from jaxplan.device.stations import Goals

__all__ = ["Decision", "Goals", "ReplanConfig", "Room", "build_replan", "room_of"]
