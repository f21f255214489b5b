"""Readers of maps, one kind of content each; all refuse what they cannot use with ``FileError``, in bounded memory.

``streams`` reads any file a piece at a time; ``numpy_arrays`` and ``ply`` parse what two readers need.
"""
