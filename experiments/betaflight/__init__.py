"""Betaflight's software-in-the-loop firmware in lockstep with a simulated vehicle: docs/firmware.md.

``build`` makes it from the package index, ``process`` runs it under a clock of its own (``clock.c``), ``link`` speaks
with it, ``outer_loop`` is what a radio's pilot would do, ``plant`` puts it in the place of our own controller. The
firmware is GPL-3: it is built and run as a program of its own, never linked with and never imported.
"""
