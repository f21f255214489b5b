"""How arrival times are matched: passes of the iteration, growth of the flight time with alpha, and tracking error.

    jaxplan experiment alpha-iteration --preset smoke|small|full [--policy NAME]

Sequences from hover and from states in flight, in open space. The left panel compares the paper's fixed point
alpha <- T_goal / sum pi(p, alpha D) with the safeguarded iteration of ``jaxplan.arrival``, for times 1 to 3 times
the least. The middle panel shows T(alpha) = alpha sum pi(p, alpha D), which must grow for alpha to be found by it; the
right one the tracking error of the flights (paper, Fig. 5).
"""

import dataclasses
import functools
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from jaxplan.arrival import ArrivalConfig, match_arrival
from jaxplan.arrival import sped_up as sped_up_state
from jaxplan.errors import InputError
from jaxplan.policy.checkpoint import load_policy, resolve_policy
from jaxplan.policy.protocol import Policy
from jaxplan.precision import in_float64
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown
from jaxplan.spline import FlatState
from jaxplan.tracking.result import TRAINING
from jaxplan.tracking.track import track
from jaxplan.training.dataset import build_flights
from jaxplan.training.evaluate import policy_durations
from jaxplan.training.labels import LabelConfig, Queries, initial_states, sped_up
from jaxplan.training.sequences import free_queries, join, suffix_queries
from jaxplan.vehicle.identity import require_same_vehicle
from jaxplan.vehicle.load import load_vehicle

from . import SUMMARIES
from .figures.alpha_iteration import draw_alpha_iteration

ALPHAS = np.round(np.arange(0.7, 2.01, 0.1), 2)
PASSES = 16


def sequences(policy: Policy, count: int, rng: np.random.Generator) -> Queries:
    """Half from hover, half from states in flight on the policy's own trajectories."""
    rest = free_queries(rng, count // 2)
    flown = build_flights(LabelConfig())(rest, policy_durations(policy, rest))
    return join([rest, suffix_queries(rng, rest, flown)])


def fixed_point_errors(
    policy: Policy, queries: Queries, goals: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "passes k"]:
    """The paper's iteration: relative error of the arrival time after each pass."""
    alpha, errors = np.ones(len(goals)), []
    for _ in range(PASSES):
        total = policy_durations(policy, sped_up(queries, alpha)).sum(axis=0)
        errors.append(np.abs(alpha * total / goals - 1.0))
        alpha = goals / total
    return np.stack(errors)


@in_float64
def safeguarded_errors(
    policy: Policy, queries: Queries, goals: Float[np.ndarray, "k"], config: ArrivalConfig
) -> tuple[Float[np.ndarray, "p k"], Int[np.ndarray, "k"], UInt32[np.ndarray, "k"]]:
    """Ours: the error of each lane after 2, 3, ... passes, the passes it took, and its reasons."""

    def match(
        state: FlatState,
        waypoints: Float[Array, "n 3"],
        count: Int[Array, ""],
        goal: Float[Array, ""],
        passes: ArrivalConfig,
    ) -> tuple[Float[Array, ""], Int[Array, ""], UInt32[Array, ""]]:
        context = policy.encode(waypoints[..., None], count[None])
        found = match_arrival(lambda s: policy.decode(context, s), state, goal[None], passes)
        alpha = found.alpha
        total = policy.decode(context, sped_up_state(state, alpha)).sum(axis=0)
        return (abs(alpha * total / goal - 1.0))[0], found.calls[0], found.reasons[0]

    states = initial_states(queries)
    derivatives, yaw, waypoints = (
        np.moveaxis(np.asarray(leaf), -1, 0) for leaf in (states.derivatives, states.yaw, queries.waypoints)
    )
    arguments = FlatState(derivatives=derivatives, yaw=yaw), waypoints, queries.count, goals
    errors = []
    for passes in range(2, PASSES + 1):
        limited = ArrivalConfig(tolerance=config.tolerance, max_calls=passes)
        every = jax.jit(jax.vmap(functools.partial(match, passes=limited)))
        found = jax.tree.map(np.asarray, every(*arguments))
        errors.append(found[0])
    return np.stack(errors), found[1], found[2]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Whose times are matched, over how many sequences."""

    policy: str = "pretrained"
    """A shipped policy or a file."""

    count: int = 400
    """Sequences."""

    seed: int = 0
    """Seed of the sequences and of their arrival times."""

    def __post_init__(self) -> None:
        if self.count < 2 or self.seed < 0:
            raise InputError(f"--count {self.count} --seed {self.seed}: want at least 2 and at least 0")


def items(config: Config) -> list[Item]:
    """One item: all sequences are asked for at once."""
    return [Item("sequences", config.policy, {})]


def evaluate(config: Config, item: Item) -> Row:
    """All curves of the picture, and the numbers beside it."""
    rng, limits, chosen = np.random.default_rng(config.seed), ArrivalConfig(), load_policy(config.policy)
    vehicle = load_vehicle()
    require_same_vehicle(f"policy {config.policy!r}", chosen.vehicle, vehicle)
    queries = sequences(chosen, config.count, rng)
    least = policy_durations(chosen, queries).sum(axis=0)
    goals = least * rng.uniform(1.0, 3.0, len(least))
    ours, calls, reasons = safeguarded_errors(chosen, queries, goals, limits)
    paper = fixed_point_errors(chosen, queries, goals)
    times, tracking = [], []
    fly = build_flights(LabelConfig())
    for alpha in ALPHAS:
        durations = alpha * policy_durations(chosen, sped_up(queries, alpha))
        times.append(durations.sum(axis=0) / least)
        error = track(fly(queries, durations), vehicle=vehicle).max_position_error
        tracking.append(np.where(error < 5.0, error, np.nan))  # lost: its error says only how far it fell
    grows = (np.diff(np.stack(times), axis=0) > 0.0).all(axis=0)
    return {
        "median_passes": float(np.median(calls)),
        "most_passes": int(calls.max()),
        "flagged_share": float(np.mean(reasons > 0)),
        "paper_converged_share": float(np.mean(paper[-1] <= limits.tolerance)),
        "time_grows_with_alpha_share": float(grows.mean()),
        "fixed_point": paper,
        "safeguarded": np.concatenate([paper[:1], ours]),  # both begin at alpha = 1
        "times": np.stack(times),
        "tracking": np.stack(tracking),
    }


def report(results: Results[Config]) -> Report:
    """The numbers, a row for each alpha, and the picture."""
    (row,) = results.finished_rows()
    curves = {name: np.array(row[name], dtype=float) for name in ("fixed_point", "safeguarded", "times", "tracking")}
    numbers = {name: value for name, value in row.items() if name not in curves}
    lines = [[name.replace("_", " "), f"{value:.4g}"] for name, value in numbers.items()]
    tracking = curves["tracking"]
    table = [
        {"alpha": float(alpha), "median_time": float(np.median(t)), "mean_tracking_error_m": _mean_of_known(e)}
        for alpha, t, e in zip(ALPHAS, curves["times"], tracking, strict=True)
    ]

    def draw(path: Path) -> None:
        errors = {"fixed point (paper)": curves["fixed_point"], "safeguarded": curves["safeguarded"]}
        tolerance, limit = ArrivalConfig().tolerance, TRAINING.position
        draw_alpha_iteration(errors, ALPHAS, curves["times"], tracking, path, tolerance=tolerance, limit=limit)

    markdown = as_markdown(["", f"{results.config.count} sequences"], lines)
    return Report(
        markdown=markdown + "\n![convergence, flight time and tracking error](alpha_iteration.png)\n",
        table=table,
        latex=as_latex(["", "value"], lines, "Matching of arrival times"),
        figures={"alpha_iteration.png": draw},
        summary=markdown,
    )


def _mean_of_known(errors: Float[np.ndarray, "k"]) -> float | None:
    """The mean of the flights that were not lost; None where all were."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if known.size else None


EXPERIMENT = Experiment(
    summary=SUMMARIES["alpha-iteration"],
    presets={"smoke": Config(count=20), "small": Config(), "full": Config(count=4000)},
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [resolve_policy(config.policy)[0]],
    parallel=False,
)
