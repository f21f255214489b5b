"""The pictures of the experiments, one module each: plain arrays and rows come in, and one PNG goes out.

What an experiment is and how it is reported stands in the module of the same name one folder up.
"""
