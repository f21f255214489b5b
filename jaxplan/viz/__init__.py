"""Pictures of worlds and episodes, drawn with matplotlib into files.

``scene`` draws a world's section, ``world`` a world with its padded map, ``candidates`` samples the trajectories of one
replan cycle, ``episode`` draws a whole interception.
"""
