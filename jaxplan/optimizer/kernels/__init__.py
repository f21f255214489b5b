"""The descent compiled for the host: one problem after another, step by step, in float64.

The problem of ``optimizer.problem`` and ``optimizer.margins`` and the method of ``optimizer.interior_point``, which say
where they come from. Those are batches for XLA, which takes longer to start its many small loops than to run them where
there is one problem only (docs/decisions/0041). Here derivatives are written out, and the vehicle, what its rotors
give and what is solid come from the other compiled code (``tracking.kernels``, ``search.kernels``).
"""
