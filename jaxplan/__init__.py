"""jaxplan: sampling-based online planning for drone interception.

These are the public names. They are imported when they are first used, so ``import jaxplan`` is instant and changes no
setting of JAX; ``__init__.pyi`` tells type checkers and editors the same list.
"""

import importlib
from typing import Any

_HOMES = {
    "jaxplan.config": ("InterceptConfig",),
    "jaxplan.errors": ("FileError", "InputError", "JaxplanError"),
    "jaxplan.feasibility.checkpoint": ("load_classifier",),
    "jaxplan.feasibility.classifier": ("Classifier",),
    "jaxplan.interception": ("run",),
    "jaxplan.io.targets": ("load_target",),
    "jaxplan.minsnap.time_allocation": ("time_allocation",),
    "jaxplan.minsnap.many": ("minimum_snap_batch",),
    "jaxplan.minsnap.single": ("minimum_snap",),
    "jaxplan.planner": ("Planner", "PlannerConfig", "Plans", "build_planner", "select"),
    "jaxplan.policy.checkpoint": ("load_policy",),
    "jaxplan.policy.constant_speed": ("constant_speed_policy",),
    "jaxplan.prediction.candidates": ("Candidates", "candidates_from"),
    "jaxplan.prediction.predictors": ("build_predictor",),
    "jaxplan.prediction.protocol": ("PredictionConfig",),
    "jaxplan.prediction.stream": ("ObservationStream",),
    "jaxplan.replanner": ("Replanner",),
    "jaxplan.spline": ("FlatState", "PiecewisePolynomial", "hover"),
    "jaxplan.status": ("PlanStatus", "Reason"),
    "jaxplan.tracking.track": ("TrackConfig", "track"),
    "jaxplan.vehicle.load": ("load_vehicle",),
    "jaxplan.vehicle.flatness": ("differential_flatness",),
    "jaxplan.vehicle.limits": ("rotor_limit_margin",),
    "jaxplan.vehicle.params": ("Vehicle",),
    "jaxplan.world.clearance": ("clearance",),
    "jaxplan.world.obstacles": ("World",),
    "jaxplan.world.load": ("load_world",),
    "jaxplan.world.update": ("update_world", "with_spare_boxes"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata  # takes a tenth of a second to import

        return metadata.version("jaxplan")
    if name not in _HOME_OF:
        raise AttributeError(f"module 'jaxplan' has no attribute {name!r}")
    from jaxplan.versions import require_supported_jax

    require_supported_jax()
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
