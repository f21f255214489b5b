"""A planner in a process of its own that looks for its target before that is seen."""

import time

from jaxplan.prediction.lookout import Lookout
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.replanner import ReplannerConfig
from jaxplan.replanner.committed import hold
from jaxplan.runtime import RuntimeConfig
from jaxplan.runtime.channel import CHANNEL_BYTES, Channel
from jaxplan.runtime.messages import Answer, pack_sample
from jaxplan.runtime.worker import Task, Worker
from jaxplan.spline import hover
from jaxplan.status import Note, PlanStatus
from oracles import runtime_builds
from oracles.planner_cases import START
from oracles.runtime_builds import GOAL

SLOW = RuntimeConfig(replanning=ReplannerConfig(latency=1.0))
"""For a machine on which other tests run too."""


def test_a_planner_that_looks_for_its_target_begins_before_it_is_seen():
    built = runtime_builds.planner()
    looking = built._replace(predictor=Lookout(built.predictor, built.world, PredictionConfig()))

    def worker():
        channel = Channel(bytearray(CHANNEL_BYTES))
        channel.epoch = time.monotonic()
        return Worker(looking, Task(runtime_builds.planner, SLOW, hold(hover(START)), Answer(0, 0), ()), channel)

    worker().tick()  # compiles
    one = worker()
    cycle = one.tick()
    assert cycle.note is Note.SEARCHING
    assert cycle.status is PlanStatus.INTERCEPT
    assert len(list(one.channel.plans.since(0))) == 1
    one.channel.samples.write(pack_sample(one.now, GOAL))
    assert one.tick().note is Note(0)
