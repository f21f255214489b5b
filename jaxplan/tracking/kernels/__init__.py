"""The simulated vehicle without noise, compiled for the host: one flight after another, in float64.

The same equations as in ``tracking.plant``, ``tracking.indi`` and ``tracking.rotor_commands``, which say where they
come from; here step by step, for the planner, which flies a plan or two in each cycle and cannot wait for a program
that is made for batches (docs/decisions/0040). Vectors are tuples of three numbers.
"""
