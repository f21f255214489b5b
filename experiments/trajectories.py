"""The optimised trajectories over time of one episode: all candidates of some of its cycles, and what was flown.

jaxplan experiment trajectories [--world NAME] [--target NAME] [--speed V] [--predictor NAME]
"""

import dataclasses

import numpy as np

from jaxplan import interception
from jaxplan.config import InterceptConfig, Planner, Predictor
from jaxplan.errors import InputError
from jaxplan.policy.checkpoint import resolve_policy
from jaxplan.replanner import Cycle
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown
from jaxplan.scenario import build_scenario
from jaxplan.viz.candidates import candidate_curves
from jaxplan.world.load import load_world

from . import SUMMARIES
from .figures.trajectories import draw_moments

SAMPLES = 6
"""Points of a segment's curve."""
MOST_CURVES = 120
"""Curves of a moment that are kept, usable ones first."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which episode, and at how many moments it is looked at."""

    world: str = "env3"
    """A stored world or a file."""

    target: str | None = "env3-09"
    """A stored trajectory or a recorded flight; the default is the paper's ninth of its third environment."""

    planner: Planner = "pretrained"
    """Who allots the times."""

    predictor: Predictor = "gmm"
    """How the target's future is predicted."""

    vehicle: str = InterceptConfig.vehicle
    """A preset, or a file."""

    padding: float = InterceptConfig.padding
    """Distance [m] that goals and paths keep from obstacles."""

    speed: float = 2.5
    """The target's maximum speed [m/s]."""

    departure: float = 0.5
    """Time at which the defender leaves its hover [s]."""

    moments: int = 6
    """Panels, evenly over the cycles that planned anew."""

    seed: int = 0
    """Seed of all noise."""

    def __post_init__(self) -> None:
        if not 1 <= self.moments <= 24:
            raise InputError(f"--moments: have {self.moments}, want 1 to 24")
        self.intercept()

    def intercept(self) -> InterceptConfig:
        """The same as the options of an interception, checked; what is drawn are the planner's own trajectories."""
        names = {field.name for field in dataclasses.fields(self)} - {"moments"}
        return InterceptConfig(**{name: getattr(self, name) for name in names}, refine=False)


def items(config: Config) -> list[Item]:
    """One item: the episode."""
    return [Item("episode", config.planner, {})]


def evaluate(config: Config, item: Item) -> Row:
    """Fly with every candidate evaluated, and keep some moments."""
    asked = config.intercept()
    episode = interception.fly(build_scenario(asked, exhaustive=True))
    telling = [cycle for cycle in episode.cycles if (cycle.plans.trajectory >= 0).any()]
    places = np.unique(np.linspace(0, len(telling) - 1, config.moments if telling else 0).astype(int))
    flight = episode.flight
    return {
        "outcome": episode.outcome,
        "times": flight.times,
        "flown": flight.position,
        "target": flight.target,
        "moments": [_moment(telling[place]) for place in places],
    }


def _moment(cycle: Cycle) -> Row:
    """What is kept of one replan cycle, to be drawn."""
    curves = candidate_curves(cycle, SAMPLES)
    order = np.argsort(~curves.curve_usable, kind="stable")[:MOST_CURVES]
    return {
        "time": curves.time,
        "status": cycle.status.name.lower(),
        "generated": cycle.generated,
        "usable": int(curves.usable.sum()),
        "goals": curves.goals,
        "goal_usable": curves.usable,
        "curves": curves.curves[order],
        "curve_usable": curves.curve_usable[order],
        "chosen": curves.chosen,
    }


def report(results: Results[Config]) -> Report:
    """The outcome, a line and a panel for each moment."""
    (row,) = results.finished_rows()
    table = [{key: m[key] for key in ("time", "status", "generated", "usable")} for m in row["moments"]]
    header = ["time [s]", "the cycle came to", "candidates", "usable"]
    lines = [[f"{m['time']:.1f}", m["status"].replace("_", " "), str(m["generated"]), str(m["usable"])] for m in table]
    markdown = f"Outcome: {row['outcome'].replace('_', ' ')} after {row['times'][-1]:.2f} s.\n\n"
    markdown += as_markdown(header, lines)
    world = load_world(results.config.world)
    return Report(
        markdown=markdown + "\n![candidates over time](trajectories.png)\n",
        table=table,
        latex=as_latex(header, lines, "Moments of one episode"),
        figures={"trajectories.png": lambda path: draw_moments(world, row, path)},
        summary=markdown,
    )


EXPERIMENT = Experiment(
    summary=SUMMARIES["trajectories"],
    presets={
        "smoke": Config(world="env1", target="env1-07", planner="no-policy", moments=3),
        "small": Config(),
        "full": Config(moments=12),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [] if config.planner == "no-policy" else [resolve_policy(config.planner)[0]],
    parallel=False,
)
