"""Minimum-snap trajectories and the durations between their waypoints (paper eq. 2 to 6).

``single`` and ``many`` are what users call; both pose a ``quadratic_program`` of knot derivatives, whose normal
equations ``block_tridiagonal`` solves. ``time_allocation`` optimises the durations with ``bfgs``, ``minimum_time`` within
a vehicle's limits. ``spline_batch`` holds the solutions, the batch last.
"""
