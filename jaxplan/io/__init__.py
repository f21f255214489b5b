"""What an interception reads and writes besides its world: targets and recorded flights, and results.

``targets`` and ``target_log`` read how a target moves (``log_columns``: in whatever columns and units), ``output``
keeps a folder of results whole, ``files`` and ``plans`` are the formats that stand in it. ``export`` writes plans for
other programs (``septic``: in the degree that small ones fly).
"""
