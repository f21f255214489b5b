"""What a user can choose for one interception, as a frozen dataclass."""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from jaxplan.errors import InputError
from jaxplan.validation import checks_itself

Predictor = Literal[
    "none",
    "ground-truth",
    "noisy",
    "constant-velocity",
    "constant-acceleration",
    "gmm",
    "particles",
    "imm",
    "fused",
    "mdn",
    "ensemble",
]
PREDICTORS: tuple[Predictor, ...] = get_args(Predictor)
WITH_MODEL = ("gmm", "particles", "fused")
"""Those that take a target model."""
WITH_NETWORK = ("mdn", "ensemble")
"""Those that take a network."""
Planner = Literal["no-policy", "pretrained", "mfrl"]
PLANNERS: tuple[Planner, ...] = get_args(Planner)
Meet = Literal["pass", "rest", "match"]
MEETINGS: tuple[Meet, ...] = get_args(Meet)
Heading = Literal["hold", "path", "target"]
HEADINGS: tuple[Heading, ...] = get_args(Heading)
TimeUnit = Literal["s", "ms", "us", "ns"]
TIME_UNITS: tuple[TimeUnit, ...] = get_args(TimeUnit)
Frame = Literal["enu", "ned"]
FRAMES: tuple[Frame, ...] = get_args(Frame)
PlaceFor = Literal["chosen", "all"]
PLACINGS: tuple[PlaceFor, ...] = get_args(PlaceFor)
Allocate = Literal["policy", "profile", "both"]
ALLOCATIONS: tuple[Allocate, ...] = get_args(Allocate)
Selection = Literal["capture", "paper"]
SELECTIONS: tuple[Selection, ...] = get_args(Selection)

_FASTEST_TARGET = 50.0
"""m/s; arbitrary, far above any vehicle here: a larger value is a mistake of units."""
_LARGEST_PADDING = 10.0
"""m; arbitrary: a larger value is a mistake of units."""
_LARGEST_RESOLUTION = 1.0
"""m; the coarsest lattice of the interception paper."""
_LATEST_DEPARTURE = 600.0
"""s; arbitrary: a larger value is a mistake of units."""


@checks_itself
@dataclass(frozen=True, kw_only=True)
class InterceptConfig:
    """One closed-loop interception."""

    world: str = "env1"
    """A stored world (env1) or a file: MJCF (.xml), rotorpy's boxes (.json), surfaces (.stl, .obj, .ply), points (.pcd,
    .npy, .ply), an OctoMap (.bt), an occupancy grid (.npz); docs/worlds.md says how each is read."""

    target: str | None = None
    """A stored trajectory, or a recorded flight: t,x,y,z, TUM, PX4's ULog or MCAP. Default: the world's first."""

    time_unit: TimeUnit | None = None
    """What the times of a recorded flight are counted in. Default: what its header says, or seconds."""

    frame: Frame | None = None
    """Axes of a recorded flight: enu, z up; ned, north, east, down. Default: z up, or what a log's format says."""

    columns: tuple[str, str, str, str] | None = None
    """Time, x, y and z of a recorded flight, by name or by number from 1; topic.field in a log with topics. Default:
    found by their names."""

    predictor: Predictor = "fused"
    """How the target's future is predicted: from what is seen of it, or, to study a planner, as it really is
    (ground-truth), which needs a target that is known beforehand."""

    target_model: str | None = None
    """A mixture for --predictor fused, gmm or particles (.npy, see jaxplan train gmm), or a network for mdn or ensemble
    (.npz, see jaxplan train mdn). Default: the world's own mixture or the generic one; the network for any room."""

    vehicle: str = "mfrl"
    """A preset (jaxplan vehicle lists them), or a file: TOML of the presets' form, or MJCF (.xml)."""

    padding: float = 0.5
    """Distance [m] that goals and searched paths keep from obstacles. What is flown keeps the vehicle's radius and a
    margin for tracking, not this."""

    resolution: float = 0.1
    """Side [m] of the cells on which places to fly through are looked for; larger where a map has too many of them."""

    planner: Planner | None = None
    """Who allots the times between waypoints; no-policy: distance / 2.5 m/s; pretrained: a policy that imitates the
    optimiser; mfrl: the same, reinforced, with the feasibility classifier in place of the rotor limits. Default: mfrl
    for the vehicle that it was made for; for others none of them, but the profile of speeds and the rotor limits."""

    policy: str | None = None
    """A policy of one's own in place of --planner (.npz, see jaxplan train): for the vehicle that it learned to fly."""

    classifier: str | None = None
    """The feasibility classifier that learned beside it (.npz). Default: the rotor limits decide."""

    meet: Meet = "pass"
    """How the target is met: pass flies through it and stops behind it; match does so at the target's own velocity;
    rest stops at it, no faster than the policy says, as in the paper."""

    heading: Heading = "hold"
    """Where the defender looks: hold keeps its yaw, path turns it along the path as in the paper, target
    towards the target until they meet."""

    allocate: Allocate | None = None
    """Who allots the times: policy, the profile of speeds that one acceleration allows, or both in turn, which is the
    default; with --meet rest or no-policy it is the policy alone."""

    refine: bool | None = None
    """Whether chosen plans are made sooner, by optimising waypoints and times together. Default: with --meet pass and
    --heading hold, which it needs. --refine=no leaves them as the policy has them, as in the paper."""

    placing: str | None = None
    """A policy that places waypoints and times (the shipped fleet, or a .npz, see jaxplan train placing), from which
    --refine goes on where that is the better start. Default: --refine goes on from the plan that was chosen."""

    place: PlaceFor = "chosen"
    """For whom --placing places: for the chosen plan, whose refinement then has a second start, or for all candidates,
    too, before anybody allots times alone: sooner, and longer in each cycle."""

    selection: Selection = "capture"
    """What plans are compared by: capture is the expected time until one captures the target, with --meet pass where
    the predictor knows its motions as a whole (particles, imm, fused, mdn, ensemble); paper is eq. 9 of the paper, as
    for others."""

    speed: float | None = None
    """The target's maximum speed [m/s]. Default: 1 for a stored target, as recorded for a flight."""

    departure: float = 0.5
    """Time [s] at which the defender leaves its hover."""

    start: tuple[float, float, float] | None = None
    """The defender's start X Y Z [m, world]. Default: the world's own."""

    seed: int = 0
    """Seed of all noise."""

    out: str = "out/intercept"
    """Folder for the results."""

    def __post_init__(self) -> None:
        self.validate()

    def validate(self) -> None:
        """Raise ``InputError`` for a value that no run can use."""
        _require_name("world", self.world)
        _require_name("out", self.out)
        if self.target is not None:
            _require_name("target", self.target)
        self._validate_log()
        _require_choice("predictor", self.predictor, PREDICTORS)
        if self.target_model is not None:
            _require_name("target-model", self.target_model)
            takers = (*WITH_MODEL, *WITH_NETWORK)
            if self.predictor not in takers:
                raise _refusal("target-model", self.target_model, f"none unless the predictor is {' or '.join(takers)}")
        _require_name("vehicle", self.vehicle)
        if self.placing is not None:
            _require_name("placing", self.placing)
        _require_up_to("padding", self.padding, _LARGEST_PADDING, "m")
        _require_up_to("resolution", self.resolution, _LARGEST_RESOLUTION, "m")
        if self.planner is not None:
            _require_choice("planner", self.planner, PLANNERS)
        self._validate_own()
        _require_choice("meet", self.meet, MEETINGS)
        _require_choice("heading", self.heading, HEADINGS)
        if self.allocate is not None:
            _require_choice("allocate", self.allocate, ALLOCATIONS)
        _require_choice("selection", self.selection, SELECTIONS)
        self._validate_refine()
        if self.speed is not None:
            _require_up_to("speed", self.speed, _FASTEST_TARGET, "m/s")
        _require_number("departure", self.departure, "a time in seconds")
        if not 0.0 <= self.departure <= _LATEST_DEPARTURE:
            raise _refusal("departure", self.departure, f"a time from 0 to {_LATEST_DEPARTURE:g} s")
        _require_start(self.start)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 2**32:
            raise _refusal("seed", self.seed, "a whole number from 0 to 4294967295")

    def _validate_refine(self) -> None:
        """Raise ``InputError`` for a refinement of plans that cannot be refined."""
        if self.refine is not None and not isinstance(self.refine, bool):
            raise _refusal("refine", self.refine, "true or false")
        if self.refine and not self._refinable:
            have = f"--meet {self.meet} and --heading {self.heading}"
            raise InputError(f"--refine: have {have}, want --meet pass and --heading hold")
        _require_choice("place", self.place, PLACINGS)
        if self.place == "all" and self.placing is None:
            raise InputError("--place: have all and no policy to place by, want --placing, such as --placing fleet")
        if self.placing is not None and not self.refines:
            raise InputError(f"--placing: have {self.placing!r} and plans that are not refined, want --refine or none")

    @property
    def refines(self) -> bool:
        """Whether chosen plans are refined, in the end."""
        return self._refinable if self.refine is None else self.refine

    @property
    def _refinable(self) -> bool:
        return (self.meet, self.heading) == ("pass", "hold")

    def _validate_log(self) -> None:
        """Raise ``InputError`` for words about a recorded flight that mean nothing."""
        if self.time_unit is not None:
            _require_choice("time-unit", self.time_unit, TIME_UNITS)
        if self.frame is not None:
            _require_choice("frame", self.frame, FRAMES)
        if self.columns is not None:
            if not isinstance(self.columns, tuple | list) or len(self.columns) != 4:
                raise _refusal("columns", self.columns, "four: time, x, y and z")
            for name in self.columns:
                _require_name("columns", name)

    def _validate_own(self) -> None:
        """Raise ``InputError`` for files of one's own that do not fit together."""
        for name, path in (("policy", self.policy), ("classifier", self.classifier)):
            if path is not None:
                _require_name(name, path)
        if self.policy is not None and self.planner is not None:
            raise _refusal("planner", self.planner, "none beside --policy")
        if self.classifier is not None and self.policy is None:
            raise _refusal("classifier", self.classifier, "none without --policy")


def _refusal(name: str, have: object, want: str) -> InputError:
    return InputError(f"--{name}: have {have!r}, want {want}")


def _require_name(name: str, value: object) -> None:
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise _refusal(name, value, "a name or a path")


def _require_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise _refusal(name, value, f"one of {', '.join(choices)}")


def _require_number(name: str, value: object, want: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _refusal(name, value, want)


def _require_up_to(name: str, value: Any, most: float, unit: str) -> None:
    want = f"a number above 0 and at most {most:g} {unit}"
    _require_number(name, value, want)
    if not 0.0 < value <= most:
        raise _refusal(name, value, want)


def _require_start(start: object) -> None:
    if start is None:
        return
    if not isinstance(start, tuple | list) or len(start) != 3:
        raise _refusal("start", start, "three coordinates X Y Z in metres")
    for coordinate in start:
        _require_number("start", coordinate, "three finite coordinates X Y Z in metres")
