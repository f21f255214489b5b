"""Which trajectories the vehicle can follow: a learned, two-fidelity classifier.

``features`` are what it sees of a trajectory, ``gaussian_process`` is the model, ``classifier`` puts both together for
queries, ``checkpoint`` keeps a model as a file, ``weights/`` has the one that is shipped. It is trained in
``jaxplan.training``.
"""
