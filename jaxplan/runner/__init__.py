"""What every experiment needs: its items in shards, run here or over dask, resumed, and reported with its origin.

``definition`` says what an experiment is, ``registry`` finds the stored ones, ``run`` runs one. The experiments
themselves are the modules of the top-level folder ``experiments``.
"""
