"""``jaxplan intercept --realtime``: the simulated vehicle against the clock, its planner in another process."""

from jaxplan.config import InterceptConfig
from jaxplan.interception import run_in_real_time
from jaxplan.runtime import Phase


def test_the_vehicle_is_flown_and_measured_against_the_clock():
    """What comes of it depends on the machine; that it is flown, measured and judged does not."""
    config = InterceptConfig(planner="no-policy", predictor="constant-velocity", speed=1.0, refine=False)
    episode = run_in_real_time(config)
    assert episode.real_time.status.phase in (Phase.PLANNING, Phase.SILENT)
    assert len(episode.plans) > 0
    assert any(cycle.deviation > 0.0 for cycle in episode.cycles), "the planner knows where the vehicle is"
    assert len(episode.real_time.setpoint_us) >= len(episode.flight.times)
    assert episode.compilations_after_warmup == 0
