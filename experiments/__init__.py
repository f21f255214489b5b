"""The experiments by name. Each is the module of that name with underscores, and has an ``EXPERIMENT``."""

NAMES = (
    "table1",
    "table2",
    "policy-comparison",
    "alpha-iteration",
    "scale-factor",
    "prediction-comparison",
    "multi-resolution",
    "environments",
    "trajectories",
    "tune-knots",
    "network-size",
    "placing",
    "faults",
    "vehicles",
    "reference-times",
    "foreign-plants",
    "arena",
    "firmware",
)
