"""The soonest meeting with a target whose motion is known: an offline reference for the time to intercept.

``starts`` says from where ``jaxplan.optimizer`` descends, ``flight`` proves the result in the plant, and ``soonest``
puts them together for one interception.
"""
