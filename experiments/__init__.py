"""The experiments by name, and what each shows.

Each is the module of that name with underscores, and has an ``EXPERIMENT``.
"""

SUMMARIES = {
    "table1": "Table I: success by planner and predictor, over environments, trajectories, speeds and departures",
    "table2": "Table II: wall time of the stages of a replan, median and 99th percentile",
    "policy-comparison": "Fig. 2b: learned policies beside minimum snap: times, tracking errors, failures, labels",
    "alpha-iteration": "Fig. 4: convergence of the arrival times, and how flight time and tracking error go with alpha",
    "scale-factor": "Fig. 5: tracking error of minimum-snap flights slowed from the rotors' limits",
    "prediction-comparison": "Fig. 6: what the predictors propose, and how far each is from what happens",
    "multi-resolution": "Fig. 3: multi-resolution search beside the finest lattice: time, length",
    "environments": "Fig. 7: the environments and their target trajectories",
    "trajectories": "Fig. 8: the optimised trajectories over time of one episode",
    "tune-knots": "Our choice of the knots' distance and turning: deviation from the path against segments",
    "network-size": "Our choice of the network's size: held-out error against the time of an evaluation",
    "placing": "Waypoints and times by a policy, for vehicles it never flew, beside times alone and an optimiser",
    "faults": "Faults injected into the closed loop: sensors, time, the vehicle, the room",
    "vehicles": "Vehicles of all sizes that nothing was learned for: least times, and plans they follow",
    "reference-times": "An offline optimum of the time to intercept for Table I's episodes, each proved by a flight",
    "foreign-plants": "Interceptions and policy flights in other people's simulators, under rotorpy's own controller",
    "arena": "The arena: fast, evasive and half-seen targets, unknown rooms; who meets them how soon",
    "firmware": "Betaflight's firmware in the loop: references, and interceptions that it flies replanned",
}
"""Here, so that a list of them imports none."""
