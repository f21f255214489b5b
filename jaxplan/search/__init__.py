"""Paths from the defender to all candidates (host).

Read ``routes`` (what the planner calls), ``roadmap`` (where shortest paths can bend), ``request`` (unusable goals, the
way out of padding). The paper's rule: ``lattice`` (what is searched), ``lattice_routes``, and ``multi_resolution``, the
reference for it. Then ``stops`` and ``meeting_point`` (where paths end), ``update`` (a world that changes in flight),
``components``, ``start_place``. ``kernels`` holds what numba compiles: ``solids`` and ``sight`` (exact clearance),
``places``, ``roads``, ``follow``, ``ways``, ``tighten`` for the roadmap; ``astar`` and what it needs for lattices.
"""
