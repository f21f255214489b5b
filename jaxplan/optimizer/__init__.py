"""The soonest meeting as one problem in waypoints, durations, meeting point and stop point, for any start in flight.

``problem`` says what is optimised, ``margins`` what it must keep to, and ``interior_point`` how. The planner refines
the plans that it has chosen by it, the offline reference (``jaxplan.reference``) starts from nothing.
"""
