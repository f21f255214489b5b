"""The planning policy: how long the segments between waypoints take.

``protocol`` says what a policy is; ``constant_speed`` is the paper's baseline; ``speed_profile`` is the closed form
that the planner asks beside the policy. The learned one: ``features`` are what the network sees, ``network`` is the
network, ``neural`` stands between world and network, ``checkpoint`` keeps weights as files, ``weights/`` has those that
are shipped. ``placing`` is the policy that places the waypoints, too, ``placing_checkpoint`` its files. They are made
in ``jaxplan.training``.
"""
