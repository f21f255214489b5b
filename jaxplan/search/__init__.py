"""Paths from the defender to all candidates on lattices of several resolutions (host).

Read ``lattice`` (what is searched), ``request`` (unusable goals, the way out of padding), ``routes`` (what the planner
calls), ``multi_resolution`` (the paper's rule, the reference for it), ``start_place``, ``update`` (a world that
changes in flight); ``kernels`` holds what numba compiles.
"""
