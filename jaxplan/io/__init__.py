"""What an interception reads and writes besides its world: targets and recorded flights, and results.

``targets`` and ``target_log`` read how a target moves: ``log_columns`` in whatever columns and units, ``ulog`` and
``mcap_log`` out of logs with many topics. ``output`` keeps a folder of results whole, ``files``, ``plans`` and
``cycles`` are the formats that stand in it. ``export`` writes plans for other programs (``septic``: in the degree
that small ones fly; ``sampled``: as samples), ``recording`` a whole episode for Foxglove.
"""
