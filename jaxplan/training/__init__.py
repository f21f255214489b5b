"""How policies and classifiers are made, in the order in which a training goes.

1. ``dataset`` (``jaxplan train dataset``): ``worlds`` draws rooms, ``sequences`` draws waypoints and initial states in
   them, ``labels`` finds the optimiser's durations at the vehicle's limits. ``examples`` reads them back, in batches.
2. ``pretrain`` (``jaxplan train pretrain``): a policy imitates the labels; ``imitation`` is its loss.
3. ``mfrl`` (``jaxplan train mfrl``): in turn, ``active`` chooses flights for rollouts, ``classifier`` trains the
   feasibility classifier on them, ``reinforce`` trains the policy with that classifier.
4. ``evaluate`` scores both for their model cards, by the measures of ``scores``.

``runs`` keeps the folders of runs that go on where they were cut off; ``tours`` makes the flights that target
predictors learn from. A training is for one vehicle, that of its dataset (``dataset.dataset_vehicle``).
"""
