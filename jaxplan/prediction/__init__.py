"""Where the target may be: observations from a stream, predictors, and the goal candidates that they propose.

The mixtures that one predictor uses are learned here too: flights are drawn, cut into windows and fitted.
"""
