"""Measurements of single stations against their peers, by ``jaxplan bench``: one module ``bench_<name>.py`` each."""
