"""Training scripts: one complete file for every kind of training run."""
