"""Learned policies beside minimum snap, in rooms that none of them was trained in.

    jaxplan experiment policy-comparison --preset smoke|small|full

Sequences and their minimum-snap labels are made anew, from seeds that no training set has. Each policy's flights are
flown with noise, as the labels are; a flight fails beyond 0.20 m or 15 degrees. T_MS is the total time at which the
label's rotors just keep their limits; times are compared flight by flight, and their means. The learning curve trains
classifiers on growing numbers of rollouts of the last policy's flights near the boundary, with and without the low
fidelity, and scores them on flights of other rooms; it is the mean over several draws of the rollouts.
"""

import dataclasses
import functools
import itertools

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxplan.errors import InputError
from jaxplan.feasibility.classifier import make_classifier
from jaxplan.feasibility.features import low_fidelity
from jaxplan.policy.checkpoint import load_policy, resolve_policy
from jaxplan.policy.protocol import Policy
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.statistics import wilson
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.tracking.result import TRAINING
from jaxplan.tracking.track import track
from jaxplan.training import active
from jaxplan.training.classifier import ClassifierConfig, Labelled, train_classifier
from jaxplan.training.dataset import DatasetConfig, Labeller, build_flights, build_labels, make_shard
from jaxplan.training.evaluate import policy_durations
from jaxplan.training.labels import Fly, Queries
from jaxplan.training.scores import area_under_curve
from jaxplan.training.sequences import take
from jaxplan.vehicle.identity import require_same_vehicle
from jaxplan.vehicle.load import load_vehicle
from jaxplan.vehicle.params import Vehicle

from . import SUMMARIES
from .figures.policy_comparison import draw_policy_comparison

SEEDS = 1_000_000
"""Added to the seed: no training set is made from as large a one."""
ALONE, RELATED = "rollouts alone", "with rotor margins"
Merged = dict[str, np.ndarray]
"""Columns of flights."""
FIDELITIES = {ALONE: False, RELATED: True}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which policies, on how many sequences."""

    policies: tuple[str, ...] = ("pretrained", "mfrl")
    """Names of shipped policies, or files."""

    shards: int = 2
    """Of 2,560 sequences each."""

    sequences: int = 2560
    """Of each shard, at most."""

    labels: tuple[int, ...] = (60, 125, 250, 500, 1000, 2000)
    """Numbers of rollouts on the learning curve."""

    steps: int = 1500
    """Gradient steps of each classifier of the curve."""

    repeats: int = 10
    """Draws of the rollouts that the curve is the mean of."""

    tries: int = 4
    """Flights of each of the curve's sequences."""

    seed: int = 0
    """Seed of rooms, sequences and noise."""

    def __post_init__(self) -> None:
        if self.shards < 1 or not 1 <= self.sequences <= 2560 or self.seed < 0 or not self.policies:
            have = f"--shards {self.shards} --sequences {self.sequences} --seed {self.seed}"
            raise InputError(f"{have}: want at least 1 shard, 1 to 2560 sequences, a seed from 0 and a policy")
        if min(self.steps, self.repeats, self.tries, *self.labels, 1) < 1:
            have = f"--labels {self.labels} --steps {self.steps} --repeats {self.repeats} --tries {self.tries}"
            raise InputError(f"{have}: want 1 or more of each")


def items(config: Config) -> list[Item]:
    """The shards of flights, then every point and draw of the learning curve."""
    flown = [Item(f"shard {index}", "flights", {"shard": index}) for index in range(config.shards)]
    cells = itertools.product(config.labels, FIDELITIES, range(config.repeats))
    return flown + [
        Item(f"{count} labels, {name}, draw {draw}", "curve", {"labels": count, "kind": name, "draw": draw})
        for count, name, draw in cells
    ]


def evaluate(config: Config, item: Item) -> Row:
    """The flights of one shard by everyone, or one point of the learning curve."""
    if item.group == "curve":
        return _curve(config, item.values["labels"], FIDELITIES[item.values["kind"]], item.values["draw"])
    queries, limits = _sequences(config, item.values["shard"])
    found = {"label": _flown(queries, limits)}
    for name in config.policies:
        found[name] = _flown(queries, policy_durations(_policy(name), queries))
    return {"waypoints": queries.count.tolist(), **found}


@functools.cache
def _tools() -> tuple[Vehicle, DatasetConfig, Labeller, Fly]:
    """What is compiled once in a process."""
    vehicle, config = load_vehicle(), DatasetConfig()
    return vehicle, config, build_labels(vehicle, config.labels), build_flights(config.labels)


def _policy(name: str) -> Policy:
    """A policy that was made for the vehicle that flies."""
    policy, (vehicle, *_) = load_policy(name), _tools()
    require_same_vehicle(f"policy {name!r}", policy.vehicle, vehicle)
    return policy


@functools.cache
def _sequences(config: Config, shard: int) -> tuple[Queries, Float[np.ndarray, "m b"]]:
    """Labelled sequences of new rooms: queries and durations at the rotors' limits."""
    _, made, label, fly = _tools()
    seeded = dataclasses.replace(made, seed=SEEDS + config.seed)
    found = make_shard(seeded, shard, label, fly)
    good = np.flatnonzero(found.feasible)[: config.sequences]
    return take(found.queries, good), found.durations[:, good]


def _flown(queries: Queries, durations: Float[np.ndarray, "m b"]) -> Row:
    """Total times [s], tracking errors [m] and whether each flight was tracked, as lists."""
    vehicle, _, _, fly = _tools()
    result = track(fly(queries, durations), vehicle=vehicle, indices=10**6 + np.arange(len(queries.count)))
    return {
        "time": durations.sum(axis=0).tolist(),
        "error": np.nan_to_num(result.max_position_error, nan=9.0).tolist(),
        "tracked": np.asarray(result.feasible).tolist(),
    }


@functools.cache
def _near_the_boundary(config: Config, shard: int) -> Labelled:
    """Motions of the last policy's flights, too fast to comfortable, and whether a rollout tracked them."""
    vehicle, made, _, _ = _tools()
    queries, _ = _sequences(config, shard)
    rng = np.random.default_rng([config.seed, shard])
    durations = policy_durations(_policy(config.policies[-1]), queries)
    solve, tries = active.build_solve(vehicle, made.labels), []
    for draw in range(config.tries):
        flights = solve(queries, active.perturbed(durations, (0.8, 1.15), 0.05, rng))
        feasible = active.roll_out(flights, np.arange(len(queries.count)), vehicle, seed=100 * shard + draw)
        tries.append((flights.motion, feasible))
    return Labelled(*(np.concatenate(columns, axis=-1) for columns in zip(*tries, strict=True)))


def _curve(config: Config, count: int, related: bool, draw: int) -> Row:
    """Area under the curve on rooms held out, of a classifier that saw ``count`` rollouts of the others."""
    seen, unseen = (_near_the_boundary(config, config.shards + part) for part in (0, 1))
    if count > len(seen.feasible):
        raise InputError(
            f"--labels {count}: have {len(seen.feasible)} flights to learn from; ask for fewer, or --tries"
        )
    some = np.random.default_rng([config.seed, draw]).permutation(len(seen.feasible))[:count]
    settings = ClassifierConfig(steps=config.steps, related_to_low=related, seed=draw)
    model, _ = train_classifier(settings, Labelled(seen.motion[..., some], seen.feasible[some]))
    chance = active.probabilities(make_classifier(model), np.asarray(unseen.motion))
    margin = np.asarray(low_fidelity(unseen.motion))[0]
    auc, without_rollouts = (area_under_curve(score, np.asarray(unseen.feasible)) for score in (chance, margin))
    return {"labels": count, "related": related, "auc": auc, "margin_alone": without_rollouts}


def report(results: Results[Config]) -> Report:
    """A line for each policy, the learning curve, and the picture."""
    config = results.config
    rows = [(item, row) for item, row in zip(results.items, results.rows, strict=True) if row is not None]
    flown = results.finished_rows("flights")
    names = ("label", *config.policies)
    merged = {name: _merged(flown, name) for name in names}
    waypoints = np.concatenate([np.asarray(row["waypoints"]) for row in flown])
    table = [_summary(name, merged[name], merged["label"]) for name in names]
    drawn: dict[str, dict[int, list[float]]] = {name: {} for name in FIDELITIES}
    for item, row in rows:
        if item.group == "curve" and row["auc"] is not None:
            drawn[item.values["kind"]].setdefault(item.values["labels"], []).append(row["auc"])
    curve = {name: {count: float(np.mean(of)) for count, of in found.items()} for name, found in drawn.items()}
    header = [column.replace("_", " ") for column in table[0]]
    lines = [
        [v if isinstance(v, str) else f"{v:.3f}" if isinstance(v, float) else str(v) for v in r.values()] for r in table
    ]
    markdown = as_markdown(header, lines)
    scores = as_markdown(
        ["rollout labels", *FIDELITIES, "rollouts with margins for the AUC of as many alone"],
        [
            [str(count), *(number(curve[name].get(count)) for name in FIDELITIES), _needed(curve, count)]
            for count in config.labels
        ],
    )
    alone = next((row["margin_alone"] for item, row in rows if item.group == "curve"), None)
    curves = f"Area under the classifier's ROC curve (of the margin alone, which needs no rollout: {number(alone)})"
    relative = {name: merged[name]["time"] / merged["label"]["time"] for name in config.policies}
    failures = {name: _by_length(waypoints, ~merged[name]["tracked"]) for name in names}
    return Report(
        markdown=f"{markdown}\n![policies](policy_comparison.png)\n\n{curves}:\n\n{scores}",
        table=table,
        latex=as_latex(header, lines, "Learned policies beside minimum snap"),
        figures={
            "policy_comparison.png": lambda path: draw_policy_comparison(
                relative,
                {name: merged[name]["error"] for name in names},
                failures,
                curve if config.labels else {},
                path,
                limit=TRAINING.position,
            )
        },
        summary=markdown,
    )


def _merged(flown: list[Row], name: str) -> Merged:
    """The flights of all shards by the one called ``name``: ``time``, ``error`` and ``tracked``."""
    return {key: np.concatenate([np.asarray(row[name][key]) for row in flown]) for key in ("time", "error", "tracked")}


def _summary(name: str, mine: Merged, label: Merged) -> Row:
    """A line of the table."""
    failed, count = int((~mine["tracked"]).sum()), len(mine["tracked"])
    low, high = wilson(failed, count)
    relative = mine["time"] / label["time"]
    return {
        "policy": name,
        "flights": count,
        "T_over_T_MS": float(relative.mean()),
        "mean_T_over_mean_T_MS": float(mine["time"].mean() / label["time"].mean()),
        "failed": failed / count,
        "failed_low": low,
        "failed_high": high,
        "median_error_m": float(np.median(mine["error"])),
    }


def _needed(curve: dict[str, dict[int, float]], count: int) -> str:
    """How many rollouts with margins rank as well as ``count`` alone: interpolated, and as a share of ``count``."""
    known = sorted(curve[RELATED])
    wanted, reached = curve[ALONE].get(count), np.maximum.accumulate([curve[RELATED][labels] for labels in known])
    if wanted is None or not known or wanted > reached[-1]:
        return "-"
    first = int(np.searchsorted(reached, wanted))
    if first == 0:
        return f"< {known[0]} ({known[0] / count:.2f})"
    above = (wanted - reached[first - 1]) / (reached[first] - reached[first - 1])
    labels = known[first - 1] ** (1.0 - above) * known[first] ** above
    return f"{labels:.0f} ({labels / count:.2f})"


def _by_length(waypoints: Int[np.ndarray, "n"], failed: Bool[np.ndarray, "n"]) -> dict[int, float]:
    """The share of flights that failed, by their number of waypoints."""
    return {int(n): float(failed[waypoints == n].mean()) for n in np.unique(waypoints)}


EXPERIMENT = Experiment(
    summary=SUMMARIES["policy-comparison"],
    presets={
        "smoke": Config(shards=1, sequences=256, labels=(100,), steps=50, repeats=1, tries=1),
        "small": Config(),
        "full": Config(shards=8, steps=3000),
    },
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [resolve_policy(name)[0] for name in config.policies],
)
