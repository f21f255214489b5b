"""The soonest meeting with a target whose motion is known: an offline reference for the time to intercept.

``problem`` says what is optimised, ``margins`` what it must keep to, ``interior_point`` how, ``starts`` from where,
``flight`` proves the result in the plant, and ``soonest`` puts them together for one interception.
"""
