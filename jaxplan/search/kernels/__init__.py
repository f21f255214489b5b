"""What numba compiles: the search over a lattice's cells, lines of sight, and the paths that come out of both.

Read ``graph`` (what is walked on), ``astar``, ``line_of_sight``, ``paths`` and ``taut``; the others serve these.
"""
