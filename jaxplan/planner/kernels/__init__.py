"""Compiled parts of the comparison of plans (host)."""
