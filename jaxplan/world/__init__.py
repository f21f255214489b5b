"""A room and what stands in it: records (``obstacles``), files (``load``), distances and occupancy, changes in flight.

Read ``obstacles``, ``clearance`` (distances, pure JAX), ``occupancy`` (lattices), ``voxels`` and ``mesh`` (distances on
grids), ``update``, ``report``; ``formats`` holds the readers of files, ``environments`` the stored rooms.
"""
