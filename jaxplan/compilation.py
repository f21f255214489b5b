"""Counting XLA compilations, so that "none after warm-up" can be measured instead of hoped for."""

import jax

_EVENT = "/jax/core/compile/backend_compile_duration"
_counts = {"compilations": 0, "listening": 0}


def compilations() -> int:
    """Compilations of this process since the first call of this function."""
    if not _counts["listening"]:
        _counts["listening"] = 1
        jax.monitoring.register_event_duration_secs_listener(_listen)
    return _counts["compilations"]


def _listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
    if event == _EVENT:
        _counts["compilations"] += 1
