"""How the shipped policies are made: random worlds, sequences, labels, pretraining."""
