"""``jaxplan intercept --realtime``: the simulated vehicle against the clock, its planner in another process."""

from jaxplan.config import InterceptConfig
from jaxplan.interception import run_in_real_time
from jaxplan.runtime import Phase

UNDER_WAY = 0.1
"""s after its first plan began a vehicle is beside its reference. On a busy machine no cycle may be later."""


def test_the_vehicle_is_flown_and_measured_against_the_clock():
    """What comes of it depends on the machine; that it is flown, measured and judged does not."""
    config = InterceptConfig(planner="no-policy", predictor="constant-velocity", speed=1.0, refine=False)
    episode = run_in_real_time(config)
    assert episode.real_time.status.phase in (Phase.PLANNING, Phase.SILENT)
    assert len(episode.plans) > 0
    off = episode.plans[0].start_time + UNDER_WAY
    under_way = [cycle.deviation for cycle in episode.cycles if cycle.time > off]
    assert all(deviation > 0.0 for deviation in under_way), "the planner knows where the vehicle is"
    assert len(episode.real_time.setpoint_us) >= len(episode.flight.times)
    assert episode.compilations_after_warmup == 0
