"""How policies and classifiers are made, in the order in which a training goes.

1. ``dataset`` (``jaxplan train dataset``): ``worlds`` draws rooms, ``sequences`` draws waypoints and initial states in
   them, ``labels`` finds the optimiser's durations at the vehicle's limits. ``examples`` reads them back, in batches.
2. ``pretrain`` (``jaxplan train pretrain``): a policy imitates the labels; ``imitation`` is its loss.
3. ``mfrl`` (``jaxplan train mfrl``): in turn, ``active`` chooses flights for rollouts, ``classifier`` trains the
   feasibility classifier on them, ``reinforce`` trains the policy with that classifier.
4. ``placing/`` (``jaxplan train courses``, ``jaxplan train placing``): a policy that places waypoints, too.
5. ``evaluate`` scores policy and classifier for their model cards, by the measures of ``scores``.

``gradient`` is what trainings by gradient share; ``tours`` makes the flights that target predictors learn from. A
training is for one vehicle, that of its dataset (``dataset.dataset_vehicle``), but for the placing policy's.
"""
