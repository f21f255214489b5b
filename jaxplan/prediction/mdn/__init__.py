"""A mixture density network (Bishop, 1994) over whole flights of the target, that is shown the room around it.

``view`` is what it is shown, ``network`` what it makes of that, ``curves`` how flights become numbers and back,
``flights`` the predictor, and ``checkpoint`` the file of its weights. It is trained by ``jaxplan.training.flights``.
"""
