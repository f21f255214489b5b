"""Minimum-snap trajectories and the durations between their waypoints (paper eq. 2 to 6).

``single`` and ``many`` are what users call; both solve a ``quadratic_program`` of knot derivatives, whose normal
equations are ``block_tridiagonal``. ``time_allocation`` optimises the durations with ``bfgs``, and ``minimum_time``
keeps them within a vehicle's limits. ``spline_batch`` holds the solutions, the batch last.
"""
