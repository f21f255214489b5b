"""The public names as type checkers and editors see them; the same list as in ``__init__.py``."""

from jaxplan.config import InterceptConfig as InterceptConfig
from jaxplan.errors import FileError as FileError
from jaxplan.errors import InputError as InputError
from jaxplan.errors import JaxplanError as JaxplanError
from jaxplan.feasibility.checkpoint import load_classifier as load_classifier
from jaxplan.feasibility.classifier import Classifier as Classifier
from jaxplan.interception import run as run
from jaxplan.io.targets import load_target as load_target
from jaxplan.minsnap.many import minimum_snap_batch as minimum_snap_batch
from jaxplan.minsnap.single import minimum_snap as minimum_snap
from jaxplan.minsnap.time_allocation import time_allocation as time_allocation
from jaxplan.planner import Planner as Planner
from jaxplan.planner import PlannerConfig as PlannerConfig
from jaxplan.planner import Plans as Plans
from jaxplan.planner import build_planner as build_planner
from jaxplan.planner import select as select
from jaxplan.policy.checkpoint import load_policy as load_policy
from jaxplan.policy.constant_speed import constant_speed_policy as constant_speed_policy
from jaxplan.prediction.candidates import Candidates as Candidates
from jaxplan.prediction.candidates import candidates_from as candidates_from
from jaxplan.prediction.predictors import build_predictor as build_predictor
from jaxplan.prediction.protocol import PredictionConfig as PredictionConfig
from jaxplan.prediction.stream import ObservationStream as ObservationStream
from jaxplan.replanner import Replanner as Replanner
from jaxplan.spline import FlatState as FlatState
from jaxplan.spline import PiecewisePolynomial as PiecewisePolynomial
from jaxplan.spline import hover as hover
from jaxplan.status import PlanStatus as PlanStatus
from jaxplan.status import Reason as Reason
from jaxplan.tracking.track import TrackConfig as TrackConfig
from jaxplan.tracking.track import track as track
from jaxplan.vehicle.flatness import differential_flatness as differential_flatness
from jaxplan.vehicle.limits import rotor_limit_margin as rotor_limit_margin
from jaxplan.vehicle.load import load_vehicle as load_vehicle
from jaxplan.vehicle.params import Vehicle as Vehicle
from jaxplan.world.clearance import clearance as clearance
from jaxplan.world.load import load_world as load_world
from jaxplan.world.obstacles import World as World
from jaxplan.world.update import update_world as update_world
from jaxplan.world.update import with_spare_boxes as with_spare_boxes

__version__: str
