"""How the placing policy is made (docs/decisions/0035): without labels, straight through the minimum-snap solve.

``courses`` finds ways through random rooms; ``problems`` makes of them what the policy is asked, from hover and from
anywhere on flights that it has planned itself, for vehicles of all sizes; ``loss`` is the time to the meeting and what
the plan exceeds; ``run`` trains and keeps the best weights.
"""
