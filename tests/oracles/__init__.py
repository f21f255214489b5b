"""Independent single-problem implementations in NumPy, SciPy or mpmath, to hold the library against."""
