"""How the network of ``jaxplan.prediction.mdn`` is trained: ``examples`` of flights, and the ``run``."""
