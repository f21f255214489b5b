"""Pictures of worlds and episodes, drawn with matplotlib into files, and episodes to watch again.

``scene`` draws a world's section, ``world`` a world with its padded map, ``candidates`` samples the trajectories of one
replan cycle, ``episode`` draws a whole interception. ``replay`` is the model of an interception to watch, of which
``html`` makes a page, ``animation`` a film, and which ``viewer`` serves; ``surface`` turns worlds into triangles, and
``words`` says what things are called.
"""
