"""The environments with their ten target trajectories each.

jaxplan experiment environments
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxplan.io.targets import Target, load_target, stored_targets
from jaxplan.runner.definition import Experiment, Item, Report, Results, Row
from jaxplan.runner.tables import as_latex, as_markdown, number
from jaxplan.viz.world import draw_world_picture
from jaxplan.world.load import ENVIRONMENTS, environment_path, load_world
from jaxplan.world.report import lattice_reports, obstacle_counts

from . import SUMMARIES
from .closed_loop import check_names


@dataclasses.dataclass(frozen=True, kw_only=True)
class Config:
    """Which environments are drawn."""

    worlds: tuple[str, ...] = ENVIRONMENTS
    """Stored worlds."""

    speed: float = 1.0
    """Maximum speed of the targets [m/s] for which durations are stated."""

    def __post_init__(self) -> None:
        check_names(self.worlds, ("no-policy",), ("none",))


def items(config: Config) -> list[Item]:
    """One item for each world."""
    return [Item(world, world, {"world": world}) for world in config.worlds]


def evaluate(config: Config, item: Item) -> Row:
    """Size, obstacles and targets of a world."""
    name = item.values["world"]
    world, targets = load_world(name), [load_target(t, world=name, speed=config.speed) for t in stored_targets(name)]
    lengths = [np.linalg.norm(np.diff(target.position(_times(target)), axis=0), axis=1).sum() for target in targets]
    finest = next(iter(lattice_reports(world)))
    return {
        "world": name,
        "size_m": " x ".join(f"{side:.4g}" for side in np.asarray(world.bounds[1] - world.bounds[0])),
        "obstacles": ", ".join(f"{count} {kind}" for kind, count in obstacle_counts(world).items()),
        "occupied_share": float(finest.occupied),
        "targets": len(targets),
        "mean_length_m": float(np.mean(lengths)),
        "mean_duration_s": float(np.mean([target.duration for target in targets])),
    }


def report(results: Results[Config]) -> Report:
    """A line and a picture for each world."""
    rows = results.finished_rows()
    header = ["world", "size [m]", "obstacles", "kept out of", "targets", "mean length [m]", "mean duration [s]"]
    columns = ("world", "size_m", "obstacles", "occupied_share", "targets", "mean_length_m", "mean_duration_s")
    lines = [[_text(row[column]) for column in columns] for row in rows]
    markdown = as_markdown(header, lines)
    pictures = "".join(f"\n![{row['world']}]({row['world']}.png)\n" for row in rows)
    return Report(
        markdown=markdown + pictures,
        table=rows,
        latex=as_latex(header, lines, "Environments"),
        figures={f"{row['world']}.png": lambda path, name=row["world"]: _draw(name, path) for row in rows},
        summary=markdown,
    )


def _text(value: float | str | None) -> str:
    return number(value, ".3g") if value is None or isinstance(value, float) else str(value)


def _times(target: Target) -> Float[np.ndarray, "n"]:
    return np.linspace(0.0, target.duration, 400)


def _draw(name: str, path: Path) -> None:
    targets = [load_target(target, world=name) for target in stored_targets(name)]
    draw_world_picture(load_world(name), path, {target.name: target.position(_times(target)) for target in targets})


EXPERIMENT = Experiment(
    summary=SUMMARIES["environments"],
    presets={"smoke": Config(), "small": Config(), "full": Config()},
    items=items,
    evaluate=evaluate,
    report=report,
    artefacts=lambda config: [environment_path(world) for world in config.worlds],
    parallel=False,
)
